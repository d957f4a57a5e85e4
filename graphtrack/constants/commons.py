"""The population of a scene, online: from those who left and those who are present."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from graphtrack.constants.online import Learner
from graphtrack.constants.personal import Constants, is_learned, population_of
from graphtrack.constants.population import Population
from graphtrack.model import Model
from graphtrack.model.same_time import SAME_TIME
from graphtrack.saved import real

_PERIOD = 1.0
"""Seconds of the scene between two estimates of what people have in common."""

_MOST_PRESENT = 100
"""Present people, the first by their numbers, whose observations count: bounds the work."""


def commons_of(constants: Constants | None, model: Model) -> Commons | None:
    """Return the learner of a scene's population; None if constants are not learned."""
    if not is_learned(constants, model):
        return None
    known = None if constants is None else population_of(constants)
    return Commons(Population() if known is None else known)


class Commons:
    """The population of a scene, the prior of its people's constants, from the past alone.

    Attributes
    ----------
    population : the present estimate
    """

    def __init__(self, population: Population) -> None:
        self.population = self._left = population
        self._next = -math.inf

    def inform(self, learner: Learner | None) -> None:
        """Give a person the present estimate as the prior."""
        if learner is not None and learner.prior is not self.population:
            learner.prior = self.population

    def leave(self, learner: Learner | None) -> None:
        """Count a person among those who left."""
        if learner is not None:
            self._left = self._left.with_people([learner.evidence()], self.population)

    def is_due(self, t: float) -> bool:
        """Return whether the estimate is to be renewed at a time, seconds."""
        # A time far before is that of a stream that began again.
        return t >= self._next - SAME_TIME or t < self._next - 2.0 * _PERIOD

    def refresh(self, t: float, present: Mapping[int, Learner | None]) -> None:
        """Estimate what people have in common at a time, seconds, from those who left and who are present."""
        self._next = t + _PERIOD
        learners = [learner for _, learner in sorted(present.items()) if learner is not None]
        evidence = [learner.evidence() for learner in learners[:_MOST_PRESENT]]
        self.population = self._left.with_people(evidence, self.population)

    def state(self) -> dict[str, Any]:
        """The state without the people, as JSON-able data."""
        waits = self._next if math.isfinite(self._next) else None
        return {"left": self._left.to_dict(), "population": self.population.to_dict(), "next": waits}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`; an error of `saved.DAMAGES` for other data."""
        self._left = Population.from_dict(state["left"])
        self.population = Population.from_dict(state["population"])
        self._next = -math.inf if state["next"] is None else real(state["next"])
