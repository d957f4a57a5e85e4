"""What the offline engines are asked and what they answer."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import Literal

import numpy as np

from graphtrack.display import counted, html_pairs, line_of_track
from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.model.parameters import Parameters
from graphtrack.model.sway import head_lag, lagging, newest_lag, sway_variances, swaying
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


def stated(covariance: FloatArray, parameters: Parameters, ends: FloatArray | float = 0.0) -> FloatArray:
    """Covariances (..., 6, 6) as estimates state them, from the inverse curvature of the cost; in place.

    Of angles, an inverse curvature P is that of a von Mises density with concentration 1/P, whose root mean
    square is stated: the wider it is the more it differs from √P, and it ends at that of the uniform density,
    `UNIFORM_STD`. Beside, what estimates do not follow: the sway of steps, accelerations and turns that last
    (`graphtrack.model.sway`).

    Parameters
    ----------
    covariance : NaN where the model has no such state
    ends : seconds from each frame (...) to the nearer end of its track, 0 of the newest online
    """
    lagging(covariance, parameters.motion, ends)
    swaying(covariance, parameters.motion)
    variance = np.einsum("...ii->...i", covariance)[..., 4:]
    with np.errstate(invalid="ignore", divide="ignore"):
        widest = UNIFORM_STD / np.sqrt(variance)
        shrink = np.minimum(np.interp(variance / (1.0 + variance), _SHARES, SHRINK), widest)
    covariance[..., 4:, :] *= shrink[..., :, None]
    covariance[..., :, 4:] *= shrink[..., None, :]
    head = variance[..., 1]
    head += head_lag(head, parameters.orientation, ends)
    np.minimum(head, UNIFORM_STD**2, out=head)
    return covariance


def stated_newest(covariance: FloatArray, parameters: Parameters) -> FloatArray:
    """As `stated`, to the last bit, of the newest frame's covariance (6, 6), which is left as it is.

    Online that is asked for with every row, and NumPy takes several times as long for so few numbers.
    """
    rows: list[list[float]] = covariance.tolist()
    if not min(rows[k][k] for k in range(4)) > 0.0 or rows[4][4] <= 0.0 or rows[5][5] <= 0.0:
        return stated(covariance.copy(), parameters)
    motion, orientation = parameters.motion, parameters.orientation
    if motion.lasting_std != 0.0:
        own = 0.5 * (rows[2][2] + rows[3][3])
        seconds = 0.5 * (rows[0][2] + rows[1][3]) / own
        lag = newest_lag(own, motion.acceleration_density, motion.lasting_std, motion.lasting_time)
        for axis in (0, 1):
            position, velocity = rows[axis], rows[2 + axis]
            position[axis] += lag * seconds**2
            position[2 + axis] += lag * seconds
            velocity[axis] += lag * seconds
            velocity[2 + axis] += lag
    for place, variance in enumerate(sway_variances(motion)):
        rows[place][place] += variance
    body, head = _newest_shrink(rows[4][4]), _newest_shrink(rows[5][5])
    rows[4], rows[5] = [one * body for one in rows[4]], [one * head for one in rows[5]]
    for row in rows:
        row[4] *= body
        row[5] *= head
    turns = orientation.head_diffusion, orientation.head_turn_rate, orientation.head_turn_time
    rows[5][5] = min(rows[5][5] + newest_lag(rows[5][5], *turns), UNIFORM_STD**2)
    return np.array(rows)


def _newest_shrink(variance: float) -> float:
    """What √P of an angle is to be multiplied with."""
    share = variance / (1.0 + variance)
    k = bisect_right(_KNOTS, share) - 1
    found = _HEIGHTS[-1] if k == len(_SLOPES) else _SLOPES[k] * (share - _KNOTS[k]) + _HEIGHTS[k]
    return min(found, UNIFORM_STD / math.sqrt(variance))


def seconds_to_ends(t: FloatArray) -> FloatArray:
    """Seconds (n,) from the frames of a track at the times (n,) to its nearer end."""
    return np.asarray(np.minimum(t - t[0], t[-1] - t))


def _von_mises_shrink(variance: FloatArray) -> FloatArray:
    """Root mean square of von Mises densities of concentration 1/``variance``, over √``variance``."""
    # In units of the standard deviation, so that narrow ones are resolved too.
    reach = np.minimum(np.pi, 12.0 * np.sqrt(variance))
    angle = reach[:, None] * (np.arange(1000) + 0.5) / 1000.0
    density = np.exp((np.cos(angle) - 1.0) / variance[:, None])
    return np.asarray(np.sqrt((density * angle**2).sum(axis=1) / density.sum(axis=1) / variance))


WIDEST_SHARE = 1e3 / (1.0 + 1e3)
_SHARES = np.linspace(0.0, WIDEST_SHARE, 400)
"""P/(1 + P) of the table of what √P is to be multiplied with."""
SHRINK = np.append(1.0, _von_mises_shrink(_SHARES[1:] / (1.0 - _SHARES[1:])))
"""That table, evenly spaced from 0 to `WIDEST_SHARE`."""
_KNOTS, _HEIGHTS, _SLOPES = _SHARES.tolist(), SHRINK.tolist(), (np.diff(SHRINK) / np.diff(_SHARES)).tolist()
"""The same for one angle at a time."""


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
