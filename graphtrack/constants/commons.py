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

_KEY = "commons"
"""Key of the state among those of a scene."""

_PERIOD = 1.0
"""Seconds of the scene between two estimates of what people have in common."""

_MOST_PRESENT = 100
"""Present people, the first by their numbers, whose observations count: bounds the work."""


def commons_of(constants: Constants | None, model: Model) -> Commons:
    """Return the learner of a scene's population, which learns nothing if constants are not learned."""
    if not is_learned(constants, model):
        return Commons(Population(), learns=False)
    return Commons(population_of(constants) or Population())


class Commons:
    """The population of a scene, the prior of its people's constants, from the past alone.

    Attributes
    ----------
    population : the present estimate
    """

    def __init__(self, population: Population, learns: bool = True) -> None:
        self.population, self._learns = population, learns
        self._left = population
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
        return self._learns and not self._next - 2.0 * _PERIOD <= t < self._next - SAME_TIME

    def refresh(self, t: float, present: Mapping[int, Learner | None]) -> None:
        """Estimate what people have in common at a time, seconds, from those who left and who are present."""
        self._next = t + _PERIOD
        learners = [learner for _, learner in sorted(present.items()) if learner is not None]
        evidence = [learner.evidence() for learner in learners[:_MOST_PRESENT]]
        self.population = self._left.with_people(evidence, self.population)

    def state(self) -> dict[str, Any]:
        """The state without the people, as JSON-able data; nothing if nothing is learned."""
        if not self._learns:
            return {}
        waits = self._next if math.isfinite(self._next) else None
        found = {"left": self._left.to_dict(), "population": self.population.to_dict(), "next": waits}
        return {_KEY: found}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`, among other keys; an error of `saved.DAMAGES` for other data."""
        if not self._learns:
            return
        saved = state[_KEY]
        self._left = Population.from_dict(saved["left"])
        self.population = Population.from_dict(saved["population"])
        self._next = -math.inf if saved["next"] is None else real(saved["next"])
