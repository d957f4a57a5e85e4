"""Person tracker on motion, colour and shape, combined by a Sigma-Pi network (Yan, Weber & Wermter 2011)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.particle_kernels import generator, resample
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image
from perception.trackers.cue_tracker import SIZE_STD, SUPPORT, CueTracker
from perception.trackers.sigma_pi_cues import ViewCue
from perception.trackers.sigma_pi_network import (
    CUES,
    TERM_NAMES,
    TERMS,
    SigmaPiParameters,
    adapted,
    output,
)
from perception.trackers.tracker import Box, BoxEstimate, Cloud, Proposal, predict

_SHARPNESS = 4.0
"""Exponent of eq. 4 in the particle weights with views; 1 in the paper."""


class SigmaPiTracker(CueTracker):
    """Track one person by particles; without a first box, the first that moves.

    Parameters
    ----------
    background : images without the person (furniture), for the shape cue
    particles : overrides the number in the parameters

    Raises
    ------
    InputError
        If an image of the background or the seed cannot be used.
    """

    name: ClassVar[str] = "sigma-pi"

    def __init__(
        self,
        parameters: SigmaPiParameters = SigmaPiParameters(),
        *,
        background: Sequence[Image] = (),
        particles: int | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        super().__init__(parameters, background)
        self.parameters = parameters if particles is None else replace(parameters, particles=particles)
        self._rng = generator(seed)
        used = np.array([all(self._used[c] for c in term) for term in TERMS])
        self._first = used.astype(float)
        self._offset = parameters.offset * used
        self.reliabilities = self._first

    def start(self, image: Image, box: Box | None = None) -> BoxEstimate:
        """Start with or without the person's box; an empty frame is not an error. See `Tracker.start`."""
        self.reliabilities = self._first
        return super().start(image, box)

    def _begin(self, state: FloatArray | None, *, entering: bool = False) -> FloatArray:
        p = self.parameters
        self._sharpness = _SHARPNESS if isinstance(self._form, ViewCue) else 1.0
        # Motion may be anywhere if the box is too small, so reinitialised particles stay near.
        fixed = (*p.fixed, "motion") if self._small else p.fixed
        self._fixed = np.array([len(term) == 1 and CUES[term[0]] in fixed for term in TERMS])
        states = self._anywhere(p.particles) if state is None else np.tile(state, (p.particles, 1))
        if state is not None and entering:
            states[:, 2:] += self._rng.random((p.particles, 1)) * (self._reference - states[:, 2:])
        self._cloud = Cloud(states, states, np.full(p.particles, 1.0 / p.particles))
        return self._best()

    def step(self, image: Image, proposal: Proposal | None = None) -> BoxEstimate:
        """Process the next frame; see `Tracker.step`. Requires `start`."""
        estimate = super().step(image, proposal)
        if self.parameters.weigh_before_move:
            self._draw_again(self._resample())
        return estimate

    def _search(self, proposal: Proposal | None) -> FloatArray:
        again = np.zeros(self.parameters.particles, bool)
        if self.parameters.weigh_before_move:
            self._weigh(again)
            self._move(proposal)
        else:
            ancestors = self._resample()
            self._move(proposal)
            again = self._draw_again(ancestors)
            self._weigh(again)
        return self._best()

    def _estimate(self, best: FloatArray) -> BoxEstimate:
        self._support = self._activities(self._cloud.boxes).max(axis=1)
        return super()._estimate(best)

    def _spread(self) -> FloatArray:
        return self._cloud.mean()[1]

    def _trust(self) -> FloatArray:
        return self.reliabilities[: len(CUES)]

    def _reliabilities(self) -> dict[str, float]:
        values = zip(TERM_NAMES, self.reliabilities.tolist(), strict=True)
        return {f"reliability {name}": value for name, value in values}

    def _adapt(self) -> None:
        p = self.parameters
        learned = adapted(self.reliabilities, self._active, p.learning_rate, p.offset) * (self._offset > 0.0)
        self.reliabilities = np.where(self._fixed, self.reliabilities, learned)

    def _weigh(self, again: NDArray[np.bool_]) -> None:
        """Weight the particles by eq. 4; ``again`` (n,) masks the reinitialised particles."""
        p = self.parameters
        weights = output(self._activities(self._cloud.boxes), self.reliabilities) ** self._sharpness
        if self._found:
            weights[again] *= p.random_weight
        total = weights.sum()
        weights = weights / total if total > 0.0 else np.full(p.particles, 1.0 / p.particles)
        self._cloud = replace(self._cloud, weights=weights)

    def _resample(self) -> NDArray[np.int64]:
        """Resample by weight; return the ancestors (n,)."""
        ancestors = resample(self._cloud.weights, self._rng)
        self._cloud = self._cloud.chosen(ancestors)
        return ancestors

    def _move(self, proposal: Proposal | None) -> None:
        """Draw the next states of all particles; they keep their weights."""
        moved = predict(self._cloud, self._reference, self.parameters.dynamics, self._rng, proposal)
        self._cloud = replace(moved, now=self._limited(moved.now))

    def _draw_again(self, ancestors: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Reinitialise some particles at random positions; return their mask (n,)."""
        p = self.parameters
        share = np.full(p.particles, p.random_share)
        if not self._found:
            share[self._support[ancestors] < SUPPORT] = p.lost_share
        again = self._rng.random(p.particles) < share
        drawn = self._anywhere(p.particles)
        if self._small:
            drawn[:, :2] = self._near(drawn[:, :2])
        now = np.where(again[:, None], self._limited(drawn), self._cloud.now)
        before = np.where(again[:, None], drawn, self._cloud.before)
        self._cloud = replace(self._cloud, now=now, before=before)
        return again

    def _anywhere(self, count: int) -> FloatArray:
        """Draw states (count, 4) anywhere in the frame, of about the expected size."""
        centre = self._rng.random((count, 2)) * self._shape
        size = self._reference + SIZE_STD * self._rng.standard_normal((count, 2))
        return np.hstack([centre, size])

    def _near(self, centre: FloatArray) -> FloatArray:
        """Clip centres (n, 2) to within two windows of the last place of the person."""
        away = 2.0 * centre / self._shape - 1.0
        return np.asarray(self._last[:2] + 2.0 * np.exp(self._last[2:]) * away)

    def _best(self) -> FloatArray:
        """Return the mean state (4,) of all particles, or of their heaviest cluster."""
        now, weights = self._cloud.now, self._cloud.weights
        if self.parameters.estimate == "mean":
            return np.asarray(weights @ now)
        apart = (now[:, None, :2] - now[None, :, :2]) / np.exp(self._reference)
        near = (apart**2).sum(axis=2) < 0.5
        chosen = weights * near[np.argmax(near @ weights)]
        return np.asarray(chosen @ now / chosen.sum())
