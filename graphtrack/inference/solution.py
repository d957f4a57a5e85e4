"""What the offline engines are asked and what they answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import check_count
from graphtrack.display import counted, html_pairs
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
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

    def __post_init__(self) -> None:
        check_count("max_iterations", self.max_iterations)
        for name in ("relative_tolerance", "step_tolerance"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < math.inf:
                raise InputError(f"{name} = {value!r}", "a finite number that is not negative")


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
        return html_pairs(f"Solution: {self.track!r}", self._outcome())

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


def seconds_to_ends(t: FloatArray) -> FloatArray:
    """Seconds (n,) from the frames of a track at the times (n,) to its nearer end."""
    return np.asarray(np.minimum(t - t[0], t[-1] - t))


def estimated_tracks(
    tracks: Sequence[Track],
    offsets: NDArray[np.int64],
    states: FloatArray,
    covariance: FloatArray,
    modes: FloatArray,
) -> list[Track]:
    """Tracks with estimates, (n, 6) states and (n, 6, 6) covariances, in place of their observations.

    Those of track m are in the rows from ``offsets`` (m + 1,) on. Angles are wrapped. Orientations and
    ``modes`` (n, 3), as in `chain.result.Result`, are absent where they begin with NaN, since they are
    found in all frames of a track or in none. All tracks share the arrays, ``covariance`` the caller's: to
    copy them for each takes as long as to smooth positions.
    """
    position, velocity = states[:, :2].copy(), states[:, 2:4].copy()
    others = {
        "body": states[:, 4],
        "head": states[:, 5],
        "aligned_p": modes[:, 0],
        "gait_offset": modes[:, 1],
        "glance_p": modes[:, 2],
    }
    has = {name: np.isfinite(other[offsets[:-1]]) for name, other in others.items()}
    others = {name: other.copy() for name, other in others.items() if has[name].any()}
    there = [(name, other, has[name].tolist()) for name, other in others.items()]
    starts, found = offsets.tolist(), []
    for m, track in enumerate(tracks):
        rows = slice(starts[m], starts[m + 1])
        channels = {name: other[rows] for name, other, is_there in there if is_there[m]}
        found.append(
            track.with_estimates(
                position=position[rows], velocity=velocity[rows], covariance=covariance[rows], **channels
            )
        )
    return found
