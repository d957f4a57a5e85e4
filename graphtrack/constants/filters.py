"""Evidence of constants of motion and of turning: predictions of each person's observations, one step ahead.

A filter goes through the observations of a person with each of some candidates; the likelihood of its
innovations is the evidence of a candidate. Positions follow white-noise acceleration in a Kalman filter,
angles rotational diffusion in a filter of von Mises densities.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.constant_velocity import compiled_noise, compiled_spread
from graphtrack.constants.ellipses import filter_ellipses, make_ellipses_ready
from graphtrack.geometry.angles import (
    FloatArray,
    unit,
)
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.covariance import limit_angles
from graphtrack.kernels.arithmetic import log_i0e
from graphtrack.kernels.compilation import TRACK, Rehearsal, allocating, compiled, inner
from graphtrack.kernels.layout import N
from graphtrack.model.given import covariances_of, observed_direction
from graphtrack.model.parameters import Parameters
from graphtrack.tracks.track import Track


class Persistent(NamedTuple):
    """Errors of positions that persist.

    Attributes
    ----------
    along, across : 1-σ in metres, along and across the camera's ray; equal without a camera
    """

    along: float = 0.0
    across: float = 0.0

    @property
    def is_any(self) -> bool:
        """Return whether there are such errors."""
        return self.along > 0.0 or self.across > 0.0


def motion_evidence(
    tracks: Sequence[Track],
    parameters: Parameters,
    densities: FloatArray,
    camera: GroundCamera | None = None,
    persistent: Persistent | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the log evidence (m, q) of spectral densities of white-noise acceleration, m²/s³.

    And the gross errors (m, q) among the positions that each expects. ``camera``: of positions in the image
    """
    variance = np.concatenate([position_variance(track, parameters, camera) for track in tracks])
    found, densities = np.zeros((2, len(tracks), len(densities))), np.array(densities)  # writable: one type
    given, speed_variance = _times(tracks), parameters.motion.initial_speed_std**2
    if persistent is None or not persistent.is_any:
        position = np.concatenate([track.position - _origin(track) for track in tracks])
        if any(track.position_covariance is not None for track in tracks):
            make_ellipses_ready()
            likelihood = parameters.likelihood
            noise = np.concatenate([covariances_of(track, likelihood) for track in tracks])
            filter_ellipses(*given, position, noise, speed_variance, densities, (OUTLIERS, ASTRAY), found)
            return found[0], found[1]
        memory = np.zeros(ROW_OF_PATH)
        filter_positions(*given, position, variance, speed_variance, densities, memory, found)
        return found[0], found[1]
    position = np.concatenate([_along_and_across(track, camera) for track in tracks])
    # Without a camera both axes are alike.
    parts = [(position, persistent.along)]
    if camera is not None:
        parts = [(position[:, :1], persistent.along), (position[:, 1:], persistent.across)]
    for value, std in parts:
        value = np.ascontiguousarray(value)
        filter_persistent(*given, value, variance, std**2, speed_variance, densities, found)
    return found[0], found[1]


def _along_and_across(track: Track, camera: GroundCamera | None) -> FloatArray:
    """Return positions (n, 2) from the first one, along and across the camera's ray to their mean."""
    position = track.position - _origin(track)
    placed = np.isfinite(track.position).all(axis=1)
    if camera is None or not placed.any():
        return position
    bearing = float(camera.ray_bearing(track.position[placed].mean(axis=0)))
    return position @ np.column_stack([unit(bearing), unit(bearing + 0.5 * math.pi)])


def is_in_image(track: Track, parameters: Parameters, camera: GroundCamera | None) -> bool:
    """Return whether a track's positions are judged in the image."""
    return camera is not None and track.pixel is not None and parameters.likelihood.image_frame


def position_variance(track: Track, parameters: Parameters, camera: GroundCamera | None) -> FloatArray:
    """Return the variances (n,) of positions, m², the mean of both axes."""
    likelihood = parameters.likelihood
    variance = likelihood.position_stds(track.axis_std, len(track)) ** 2
    if camera is not None and track.pixel is not None and is_in_image(track, parameters, camera):
        squares = np.square(camera.ground_jacobian(track.pixel)).sum(axis=(1, 2))
        in_image = np.isfinite(squares)
        variance[in_image] = 0.5 * likelihood.pixel_std**2 * squares[in_image]
    return variance


def turning_evidence(
    tracks: Sequence[Track], name: str, parameters: Parameters, diffusions: FloatArray
) -> FloatArray:
    """Return the log evidence (m, d) of rotational diffusions of "body" or "head", rad²/s."""
    observed = [observed_direction(track, name, parameters) for track in tracks]
    angle, kappa = (np.concatenate(part) for part in zip(*observed, strict=True))
    found = np.zeros((len(tracks), len(diffusions)))
    if kappa.any():
        outliers = float(parameters.likelihood.outliers(name))
        state = np.zeros((len(diffusions), 2))
        filter_angles(*_times(tracks), np.nan_to_num(angle), kappa, outliers, diffusions, state, found)
    return found


def _origin(track: Track) -> FloatArray:
    """Return the first position (2,), so that coordinates are small."""
    placed = np.flatnonzero(np.isfinite(track.position).all(axis=1))
    return track.position[placed[0]] if len(placed) else np.zeros(2)


def _times(tracks: Sequence[Track]) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the tracks' first frames and the end (m + 1,), and the seconds since the frame before (N,)."""
    offsets = np.concatenate([[0], np.cumsum([len(track) for track in tracks])])
    return offsets.astype(np.int64), np.concatenate([track.dt for track in tracks])


ROW_OF_PATH, ROW_OF_ANGLE, ROW_OF_COUPLING = 9, 3, 5
"""Numbers of a filter: x, y, vx, vy, variances of position, of both and of velocity, the log evidence, and
the expected gross errors; a vector and the evidence; the vectors of body and head and the evidence."""

PERSISTENCE = 0.5
"""Correlation time of persistent errors of positions, seconds. Slower ones are like people's ways."""

OUTLIERS, ASTRAY = 0.01, 100.0
"""Share of positions that may be gross errors, and their variance in m² on each axis. At σ = 0.1 m a position
is as likely one as not at five standard deviations."""


@inner
def predict_path(row: Any, dt: float, density: float) -> None:
    """Move a filter of positions ahead, in place."""
    row[0] += dt * row[2]
    row[1] += dt * row[3]
    row[4], row[5], row[6] = compiled_spread(row[4], row[5], row[6], dt, density)


@inner
def with_gross_errors(square: float, spread: float, axes: int) -> tuple[float, float]:
    """Return the log density of an innovation, and the probability that it is no gross error.

    ``square`` of its length, m², ``spread`` its variance on each of its ``axes``
    """
    wide, half = spread + ASTRAY, 0.5 * axes
    inlier = math.log(1.0 - OUTLIERS) - 0.5 * square / spread - half * math.log(2.0 * math.pi * spread)
    outlier = math.log(OUTLIERS) - 0.5 * square / wide - half * math.log(2.0 * math.pi * wide)
    top = max(inlier, outlier)
    total = math.exp(inlier - top) + math.exp(outlier - top)
    return top + math.log(total), math.exp(inlier - top) / total


@inner
def observe_path(row: Any, x: float, y: float, variance: float) -> None:
    """Take a position into a filter, in place, by the probability that it is no gross error."""
    dx, dy, spread = x - row[0], y - row[1], row[4] + variance
    density, share = with_gross_errors(dx * dx + dy * dy, spread, 2)
    row[7] += density
    row[8] += 1.0 - share
    spread = row[4] + variance / max(share, 1e-12)
    gain_p, gain_v = row[4] / spread, row[5] / spread
    row[0] += gain_p * dx
    row[1] += gain_p * dy
    row[2] += gain_v * dx
    row[3] += gain_v * dy
    row[6] -= gain_v * row[5]
    row[5] -= gain_v * row[4]
    row[4] -= gain_p * row[4]


@inner
def diffused(x: float, y: float, variance: float) -> tuple[float, float]:
    """Return the vector of a von Mises density once a variance is added: 1/κ is a concentrated one's."""
    kept = 1.0 / (1.0 + math.sqrt(x * x + y * y) * variance)
    return kept * x, kept * y


@inner
def von_mises_of(angle: float, kappa: float) -> tuple[float, float, float]:
    """Return the vector of an observed angle, and the log of its density at the mean, relative to uniform."""
    return kappa * math.cos(angle), kappa * math.sin(angle), -log_i0e(kappa) - kappa


@inner
def observed_angle(
    x: float, y: float, given: tuple[float, float, float], outliers: float
) -> tuple[float, float, float]:
    """Return the vector of a von Mises density after an observation (`von_mises_of`), and its log density."""
    size = math.sqrt(x * x + y * y)
    if size <= 0.0:
        return given[0], given[1], 0.0
    ox, oy, peak = given
    both = math.sqrt((x + ox) * (x + ox) + (y + oy) * (y + oy))
    density = log_i0e(both) + both - log_i0e(size) - size + peak
    if outliers > 0.0:
        inlier = (1.0 - outliers) * math.exp(density)
        density = math.log(inlier + outliers)
        share = inlier / (inlier + outliers)
        ox, oy = share * ox, share * oy
    return x + ox, y + oy, density - math.log(2.0 * math.pi)


@compiled
def filter_positions(
    offsets: NDArray[np.int64],
    dt: FloatArray,
    position: FloatArray,
    variance: FloatArray,
    speed_variance: float,
    densities: FloatArray,
    row: FloatArray,
    found: FloatArray,
) -> None:
    """Write the log density of the positions (N, 2) of each track into ``found`` (2, m, q), and gross errors.

    ``variance`` (N,) of a position on each axis, ``speed_variance`` of the first velocity; ``row`` is memory
    """
    for track in range(len(offsets) - 1):
        for candidate in range(len(densities)):
            begun = False
            row[:] = 0.0
            for k in range(offsets[track], offsets[track + 1]):
                if begun:
                    predict_path(row, dt[k], densities[candidate])
                x, y = position[k, 0], position[k, 1]
                if not (math.isfinite(x) and math.isfinite(y)):
                    continue
                if begun:
                    observe_path(row, x, y, variance[k])
                else:
                    row[0], row[1], row[4], row[6], begun = x, y, variance[k], speed_variance, True
            found[0, track, candidate], found[1, track, candidate] = row[7], row[8]


@allocating
def filter_persistent(
    offsets: NDArray[np.int64],
    dt: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    persistent: float,
    speed_variance: float,
    densities: FloatArray,
    found: FloatArray,
) -> None:
    """Add the log density of positions (N, a) on one axis or both to ``found`` (2, m, q), and gross errors.

    As `filter_positions`, with errors of a variance ``persistent`` that persist. The state is the position,
    the velocity, the error and its rate of change, a Gaussian process of the Matérn covariance
    (1 + λr)·e^(−λr) (Hartikainen and Särkkä 2010), whose integral over r > 0 is `PERSISTENCE`.
    """
    rate = 2.0 / PERSISTENCE
    slope = persistent * rate * rate
    axes = value.shape[1]
    mean, of_place = np.zeros((4, axes)), np.zeros(4)
    spread, moved, step = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    step[0, 0] = step[1, 1] = 1.0
    for track in range(len(offsets) - 1):
        for candidate in range(len(densities)):
            begun, density = False, densities[candidate]
            for k in range(offsets[track], offsets[track + 1]):
                if begun:
                    h = dt[k]
                    kept = math.exp(-rate * h)
                    step[0, 1], step[2, 2], step[2, 3] = h, kept * (1.0 + rate * h), kept * h
                    step[3, 2], step[3, 3] = -kept * rate * rate * h, kept * (1.0 - rate * h)
                    for axis in range(axes):
                        error, change = mean[2, axis], mean[3, axis]
                        mean[0, axis] += h * mean[1, axis]
                        mean[2, axis] = step[2, 2] * error + step[2, 3] * change
                        mean[3, axis] = step[3, 2] * error + step[3, 3] * change
                    multiply(step, spread, moved)
                    multiply(moved, step.T, spread)
                    place, cross, speed = compiled_noise(h, density)
                    spread[0, 0] += place
                    spread[0, 1] += cross
                    spread[1, 0] += cross
                    spread[1, 1] += speed
                    # The process is stationary.
                    spread[2, 2] += persistent - step[2, 2] ** 2 * persistent - step[2, 3] ** 2 * slope
                    both = step[2, 2] * step[3, 2] * persistent + step[2, 3] * step[3, 3] * slope
                    spread[2, 3] -= both
                    spread[3, 2] -= both
                    spread[3, 3] += slope - step[3, 2] ** 2 * persistent - step[3, 3] ** 2 * slope
                total = 0.0
                for axis in range(axes):
                    total += value[k, axis]
                if not math.isfinite(total):
                    continue
                if not begun:
                    # Assigning to slices does the same, but takes seconds to compile.
                    begun = True
                    for i in range(4):
                        for axis in range(axes):
                            mean[i, axis] = value[k, axis] if i == 0 else 0.0
                        for j in range(4):
                            spread[i, j] = 0.0
                    spread[0, 0], spread[1, 1] = variance[k] + persistent, speed_variance
                    spread[0, 2], spread[2, 0], spread[2, 2] = -persistent, -persistent, persistent
                    spread[3, 3] = slope
                    continue
                square = 0.0
                for axis in range(axes):
                    square += (value[k, axis] - mean[0, axis] - mean[2, axis]) ** 2
                for i in range(4):
                    of_place[i] = spread[i, 0] + spread[i, 2]
                expected = of_place[0] + of_place[2]
                one, share = with_gross_errors(square, expected + variance[k], axes)
                found[0, track, candidate] += one
                found[1, track, candidate] += 0.5 * axes * (1.0 - share)
                total = expected + variance[k] / max(share, 1e-12)
                for axis in range(axes):
                    error = (value[k, axis] - mean[0, axis] - mean[2, axis]) / total
                    for i in range(4):
                        mean[i, axis] += of_place[i] * error
                for i in range(4):
                    for j in range(4):
                        spread[i, j] -= of_place[i] / total * of_place[j]


@inner
def multiply(left: Any, right: Any, product: Any) -> None:
    """Write the product of two 4 × 4 matrices."""
    for i in range(4):
        for j in range(4):
            product[i, j] = 0.0
            for k in range(4):
                product[i, j] += left[i, k] * right[k, j]


@compiled
def filter_angles(
    offsets: NDArray[np.int64],
    dt: FloatArray,
    angle: FloatArray,
    kappa: FloatArray,
    outliers: float,
    diffusions: FloatArray,
    state: FloatArray,
    found: FloatArray,
) -> None:
    """Write the log density of the angles (N,) of each track into ``found`` (m, d).

    The state is a von Mises density, in its natural parameters: a vector whose length is the concentration.
    ``kappa`` (N,) of the observations, 0 without; a share of ``outliers`` is uniform; ``state`` (d, 2) is
    memory
    """
    for track in range(len(offsets) - 1):
        state[:], found[track] = 0.0, 0.0
        for k in range(offsets[track], offsets[track + 1]):
            one = von_mises_of(angle[k], kappa[k])
            for candidate in range(len(diffusions)):
                x, y = diffused(state[candidate, 0], state[candidate, 1], diffusions[candidate] * dt[k])
                if kappa[k] > 0.0:
                    x, y, density = observed_angle(x, y, one, outliers)
                    found[track, candidate] += density
                state[candidate, 0], state[candidate, 1] = x, y


class FilterRules(NamedTuple):
    """Candidates and priors of the filters of one person online.

    Attributes
    ----------
    densities, diffusions : (q,) and (d,) the candidates
    couplings : (c, 2) κ₁ and κ₂ of each alternative
    path, body, head, coupling : (q,), (d,), (d,) and (c,) log prior of each
    speed_variance : of the first velocity, m²/s²
    speed_threshold : m/s; correlation_time : s, of the couplings
    outliers : (2,) share of the observed angles of body and of head
    """

    densities: FloatArray
    diffusions: FloatArray
    couplings: FloatArray
    path: FloatArray
    body: FloatArray
    head: FloatArray
    coupling: FloatArray
    speed_variance: float
    speed_threshold: float
    correlation_time: float
    outliers: FloatArray


class Filters(NamedTuple):
    """The filters of one person online, a row for each candidate, and what they say.

    Attributes
    ----------
    path, body, head, coupled : rows of numbers, of the sizes `ROW_OF_PATH` and so on
    begun : (1,) 1 after a position
    shares : (c,) probabilities of the couplings
    means : (3,) posterior means of the density of acceleration and of both diffusions
    """

    path: FloatArray
    body: FloatArray
    head: FloatArray
    coupled: FloatArray
    begun: FloatArray
    shares: FloatArray
    means: FloatArray

    @classmethod
    def of(cls, rules: FilterRules) -> tuple[Filters, FloatArray]:
        """Return the filters of a person before an observation, and their memory, all numbers in a row."""
        q, d, c = len(rules.densities), len(rules.diffusions), len(rules.couplings)
        turns = (d, ROW_OF_ANGLE)
        shapes = ((q, ROW_OF_PATH), turns, turns, (c, ROW_OF_COUPLING), (1,), (c,), (3,))
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        memory = np.zeros(ends[-1])
        parts = np.split(memory, ends[:-1])
        return cls(*(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True))), memory


@inner
def set_posterior(rows: Any, place: int, prior: Any, found: Any) -> None:
    """Write the probabilities of candidates, by the log evidence in their rows, into ``found``."""
    top, total = -math.inf, 0.0
    for k in range(len(prior)):
        found[k] = rows[k, place] + prior[k]
        top = max(top, found[k])
    for k in range(len(prior)):
        found[k] = math.exp(found[k] - top)
        total += found[k]
    for k in range(len(prior)):
        found[k] /= total


@inner
def mean_of(values: Any, shares: Any) -> float:
    """Return the mean of values by shares."""
    total = 0.0
    for k in range(len(values)):
        total += values[k] * shares[k]
    return total


@compiled
def observe(filters: Filters, rules: FilterRules, row: Any, memory: Any) -> None:
    """Take an observation into the filters of a person.

    ``row`` (10,) is the time since the previous in seconds, x, y, variance, and for body and for head the
    angle, its κ, and 1 if it is evidence of couplings; NaN or 0 without. ``memory`` (candidates,) is
    overwritten.
    """
    shares, found = filters.shares, filters.means
    dt, x, y, variance, body_row, head_row = row[0], row[1], row[2], row[3], row[4:7], row[7:10]
    is_placed = math.isfinite(x) and math.isfinite(y)
    for k in range(len(rules.densities)):
        path = filters.path[k]
        if filters.begun[0] > 0.0:
            predict_path(path, dt, rules.densities[k])
            if is_placed:
                observe_path(path, x, y, variance)
        elif is_placed:
            path[0], path[1], path[4], path[6] = x, y, variance, rules.speed_variance
    if is_placed:
        filters.begun[0] = 1.0
    q, d = len(rules.densities), len(rules.diffusions)
    set_posterior(filters.path, 7, rules.path, memory[:q])
    vx = vy = spread = 0.0
    for k in range(q):
        vx += memory[k] * filters.path[k, 2]
        vy += memory[k] * filters.path[k, 3]
        spread += memory[k] * filters.path[k, 6]
    found[0] = mean_of(rules.densities, memory[:q])
    for n, (bank, prior) in enumerate(((filters.body, rules.body), (filters.head, rules.head))):
        kappa = row[5 + 3 * n]
        one = von_mises_of(row[4 + 3 * n], kappa)
        for k in range(d):
            bank[k, 0], bank[k, 1] = diffused(bank[k, 0], bank[k, 1], rules.diffusions[k] * dt)
            if kappa > 0.0:
                x, y, density = observed_angle(bank[k, 0], bank[k, 1], one, rules.outliers[n])
                bank[k, 0], bank[k, 1] = x, y
                bank[k, 2] += density
        set_posterior(bank, 2, prior, memory[:d])
        found[1 + n] = mean_of(rules.diffusions, memory[:d])
    speed = math.sqrt(vx * vx + vy * vy)
    excess = max(0.0, speed - rules.speed_threshold)
    weight = 1.0
    if 0.0 < dt < rules.correlation_time:
        weight = dt / rules.correlation_time
    body, head = von_mises_of(body_row[0], body_row[1]), von_mises_of(head_row[0], head_row[1])
    for k in range(len(rules.couplings)):
        own = filters.coupled[k]
        bx, by = diffused(own[0], own[1], found[1] * dt)
        follows = weight * rules.couplings[k, 0] * excess * excess
        if follows > 0.0:
            # The direction of an uncertain velocity.
            follows = 1.0 / (1.0 / follows + spread / (speed * speed))
            bx, by = bx + follows * vx / speed, by + follows * vy / speed
        if body_row[1] > 0.0:
            bx, by, density = observed_angle(bx, by, body, rules.outliers[0])
            own[4] += body_row[2] * density
        hx, hy = diffused(own[2], own[3], found[2] * dt)
        follows, size = weight * rules.couplings[k, 1], math.sqrt(bx * bx + by * by)
        if follows > 0.0 and size > 0.0:
            follows = 1.0 / (1.0 / follows + 1.0 / size)
            hx, hy = hx + follows * bx / size, hy + follows * by / size
        if head_row[1] > 0.0:
            hx, hy, density = observed_angle(hx, hy, head, rules.outliers[1])
            own[4] += head_row[2] * density
        own[0], own[1], own[2], own[3] = bx, by, hx, hy
    set_posterior(filters.coupled, 4, rules.coupling, shares)


def _rehearse() -> None:
    track = replace(TRACK, head=np.zeros(len(TRACK)))
    motion_evidence([track], Parameters(), np.ones(1))
    motion_evidence([track], Parameters(), np.ones(1), persistent=Persistent(0.1, 0.1))
    turning_evidence([track], "head", Parameters(), np.ones(1))
    limit_angles(np.zeros((1, N, N)))


REHEARSAL = Rehearsal("learned constants", _rehearse, 3.5)


def _rehearse_online() -> None:
    one = np.ones(1)
    rules = FilterRules(one, one, np.ones((1, 2)), one, one, one, one, 1.0, 0.1, 0.4, np.zeros(2))
    observe(Filters.of(rules)[0], rules, np.ones(10), np.zeros(1))
    limit_angles(np.zeros((1, N, N)))


ONLINE_REHEARSAL = Rehearsal("learned constants online", _rehearse_online, 4.0)
