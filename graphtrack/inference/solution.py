"""What the offline engines are asked and what they answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from graphtrack.display import counted, html_pairs, line_of_track
from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.tracks import Track

OfflineEngine = Literal["chain", "gtsam"]


@dataclass(frozen=True)
class SolverOptions:
    """When the iterations end.

    Attributes
    ----------
    max_iterations : steps
    relative_tolerance : of the cost. GTSAM stops when a step brought less; the chain engine, whose steps
        converge quadratically, when the next one promises less than a thousandth of it.
    step_tolerance : norm of the whole step (metres, m/s, radians), for GTSAM
    restart : where observations contradict each other, a grid of orientations is searched for a better basin,
        and the descent starts anew from there (with GTSAM too, where every term has compiled kernels)
    """

    max_iterations: int = 100
    relative_tolerance: float = 1e-9
    step_tolerance: float = 1e-6
    restart: bool = True


@dataclass(frozen=True, eq=False)
class Solution:
    """What the smoother found for one track.

    Attributes
    ----------
    track : the estimates, with ``velocity`` and ``covariance``
    initial_cost, cost : negative log density at the start and at the end
    iterations : steps taken
    converged : whether a tolerance was met
    engine : "chain" or "gtsam"
    """

    track: Track
    initial_cost: float
    cost: float
    iterations: int
    converged: bool
    engine: OfflineEngine

    def __repr__(self) -> str:
        parts = [f"track {self.track.track_id}", counted(len(self.track), "frame"), *self._outcome().values()]
        return f"Solution({', '.join(parts)})"

    def _repr_html_(self) -> str:
        return html_pairs(f"Solution: {line_of_track(self.track)}", self._outcome())

    def _outcome(self) -> dict[str, str]:
        return {
            "cost": f"cost {self.initial_cost:.6g} → {self.cost:.6g}",
            "steps": counted(self.iterations, "step"),
            "end": "converged" if self.converged else "not converged",
            "engine": self.engine,
        }


@dataclass(frozen=True, eq=False)
class Failure:
    """A track that could not be smoothed, and why."""

    track_id: int
    reason: str


def bounded(covariance: FloatArray) -> FloatArray:
    """Covariances (..., 6, 6) with no angle less certain than the uniform density on the circle."""
    if covariance.ndim == 2:  # of one state, at every observation
        if not (covariance[4, 4] > UNIFORM_STD**2 or covariance[5, 5] > UNIFORM_STD**2):
            return covariance
    elif not (covariance[..., (4, 5), (4, 5)] > UNIFORM_STD**2).any():
        return covariance
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    shrink = np.ones_like(variance)
    with np.errstate(invalid="ignore"):
        shrink[..., 4:] = np.minimum(1.0, UNIFORM_STD / np.sqrt(variance[..., 4:]))
    shrink = np.where(np.isfinite(shrink), shrink, 1.0)
    return covariance * shrink[..., :, None] * shrink[..., None, :]


def estimated_track(
    track: Track, states: FloatArray, covariance: FloatArray, modes: FloatArray | None = None
) -> Track:
    """The track with estimates, (n, 6) states and (n, 6, 6) covariances, in place of its observations.

    Angles are wrapped. Orientations and ``modes`` (n, 2), as in `problem.Result`, are absent where they begin
    with NaN, since they are found in all frames of a track or in none. The covariances stay in the caller's
    array, which may be that of many tracks: to copy them takes as long as to smooth positions.
    """
    has_modes = modes is not None and not np.isnan(modes[0, 0])
    return track.with_estimates(
        position=states[:, :2].copy(),
        velocity=states[:, 2:4].copy(),
        body=None if np.isnan(states[0, 4]) else states[:, 4].copy(),
        head=None if np.isnan(states[0, 5]) else states[:, 5].copy(),
        covariance=covariance,
        aligned_p=modes[:, 0].copy() if modes is not None and has_modes else None,
        gait_offset=modes[:, 1].copy() if modes is not None and has_modes else None,
    )
