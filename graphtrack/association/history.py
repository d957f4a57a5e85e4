"""The newest final decisions of online association, from which the scene's parameters are learned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from graphtrack.association.chains import Chains, IntArray, Scene, link_by, unlinked
from graphtrack.association.duplicates import learn_duplicates
from graphtrack.association.facing import learn_orientation
from graphtrack.association.kernels import refresh
from graphtrack.association.learning import learn_scene
from graphtrack.association.looks import widened
from graphtrack.association.looks_online import Looks, looks_of_tracks
from graphtrack.association.notes import NOBODY, Notes
from graphtrack.association.packing import pack_tree, unpack_tree
from graphtrack.association.places import Places, learn_places
from graphtrack.scene import Known, SceneParameters

LEARNED_AT = (50, 200, 800, 1600, 3200, 6400, 12800)
"""Detections after which the scene's parameters are learned; then after as many more as the last."""

REMEMBERED = 3200
"""Detections, decided upon, that parameters are learned from."""

GUESS_SECONDS = 10.0
"""Time that the first guess of how people turn counts for: at first they all may walk straight."""

_TURNS = {"acceleration_density": 1, "body_turn": 2, "head_turn": 2}
"""Parameters of turning, and the power of each that is a variance."""


class History:
    """The newest detections that were decided upon, for parameters to be learned from."""

    def __init__(self) -> None:
        self.t, self.std, self.score = np.zeros(0), np.zeros(0), np.zeros(0)
        self.position, self.facing, self.descriptor = np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 0))
        self.frame, self.owner = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self.count, self.times = 0, 0
        self.since: float | None = None

    def add(self, chains: Chains, notes: Notes, owner: IntArray, first: int, end: int) -> None:
        """Remember the detections ``first`` up to ``end``, and forget as many where there are too many."""
        new = {
            "t": chains.t,
            "std": notes.std,
            "score": notes.score,
            "descriptor": notes.descriptor,
            "position": chains.position,
            "facing": chains.facing,
            "frame": chains.frame,
            "owner": owner,
        }
        self.descriptor = widened(self.descriptor, notes.descriptor.shape[1])
        for name, values in new.items():
            setattr(self, name, np.concatenate([getattr(self, name), values[first:end]])[-REMEMBERED:])
        self.count += end - first
        self.since = float(chains.t[first]) if self.since is None else self.since

    def state(self) -> dict[str, Any]:
        """As JSON-able data."""
        return pack_tree(vars(self))

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> History:
        """The inverse of `state`."""
        found = cls()
        vars(found).update(unpack_tree(state))
        return found

    def is_due(self) -> bool:
        """Return whether parameters are to be learned."""
        known = len(LEARNED_AT)
        due = LEARNED_AT[self.times] if self.times < known else LEARNED_AT[-1] * (self.times - known + 2)
        return self.count >= due

    def learned(
        self, scene: SceneParameters, step_seconds: float, known: Known
    ) -> tuple[SceneParameters, Places, Looks]:
        """Learn from the remembered tracks.

        Returns the parameters that they speak for but those known, where people come and go, and what looks
        and scores are worth.
        """
        self.times += 1
        chains = unlinked(self.t, self.frame - self.frame[0], self.position, self.facing)
        chains.gain[:] = 0.0
        chains.variance[:] = np.where(np.isnan(self.std), scene.position_std, self.std) ** 2
        _, owner = np.unique(self.owner, return_inverse=True)
        identity = np.where(self.owner == NOBODY, NOBODY, owner - int((self.owner == NOBODY).any()))
        link_by(chains, identity)
        scene = learn_duplicates(chains.frame, self.position, identity, scene, known)
        scene = learn_scene(chains, identity, scene, self.std, step_seconds, known)
        scene = learn_orientation(chains, scene, step_seconds, known)
        scene = self._with_guess(scene, known)
        shown = looks_of_tracks(chains, identity, self.descriptor, self.score)
        refresh(chains, 0, len(self.t), Scene(*scene.packed(step_seconds)))
        return scene, learn_places(chains, identity), shown

    def _with_guess(self, scene: SceneParameters, known: Known) -> SceneParameters:
        """With turns as the mean, over time, of the first guess and of what was found."""
        watched = 0.0 if self.since is None else float(self.t[-1]) - self.since
        share, guess = GUESS_SECONDS / (GUESS_SECONDS + watched), SceneParameters()
        mean = {}
        for name, power in _TURNS.items():
            first, found = getattr(guess, name) ** power, getattr(scene, name) ** power
            mean[name] = (share * first + (1.0 - share) * found) ** (1.0 / power)
        return replace(scene, **mean | dict(known))
