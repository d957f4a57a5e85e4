"""Diagnosis of the declared noise: its maximum-likelihood multiple, and a bias of angles.

Stretches of tracks are filtered under white-noise acceleration and rotational diffusion, each observation an
outlier with some probability, all stretches and candidates at once. An angle to the motion common to all
people is attributed to the detector: each track has an offset from a von Mises density about the bias or, for
some, from a uniform density.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import (
    BoolArray,
    FloatArray,
    concentration_from_resultant,
    mean_resultant_length,
    unit,
    von_mises_log_density,
    wrap,
)
from graphtrack.model.given import notes_on
from graphtrack.model.parameters import Parameters, range_of
from graphtrack.packages import special
from graphtrack.tracks.given import with_position_noise
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet, observed_angle

if TYPE_CHECKING:
    from graphtrack.model import Model


LONGEST = 60  # Frames of a piece at most: that many steps are taken, one after another

MOST = 2500  # Frames of all pieces together, about

FEWEST = 4  # Observations of a piece at least

Channel = Callable[[Track], tuple[FloatArray | None, FloatArray | None]]
"""Observation of each frame, and its declared spread."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """P stretches of tracks of up to T frames, each a column.

    Attributes
    ----------
    dt : (T, P) seconds since the frame before
    value : (T, P, k) observations, from the first of its piece; NaN if missing, and past the end
    spread : (T, P) declared spread; NaN: none
    track : (P,) index of its track
    """

    dt: FloatArray
    value: FloatArray
    spread: FloatArray
    track: NDArray[np.int64]

    @property
    def observed(self) -> BoolArray:
        """(T, P) mask of observations."""
        return np.asarray(np.isfinite(self.value[..., 0]))

    def part(self, count: int) -> Pieces:
        """Return the first pieces."""
        return Pieces(self.dt[:, :count], self.value[:, :count], self.spread[:, :count], self.track[:count])


def pieces_of(tracks: Sequence[Track], channel: Channel, rng: np.random.Generator) -> Pieces | None:
    """Choose at random pieces of tracks with observations of a channel; None if there are none."""
    pieces = [(m, a) for m, track in enumerate(tracks) for a in range(0, len(track), LONGEST)]
    chosen: list[tuple[int, FloatArray, FloatArray, FloatArray]] = []
    frames = 0
    for i in rng.permutation(len(pieces)).tolist():
        m, a = pieces[i]
        track, part = tracks[m], slice(a, a + LONGEST)
        values, declared = channel(track)
        if values is None:
            continue
        value = values[part].reshape(len(track.t[part]), -1)
        observed = np.flatnonzero(np.isfinite(value).all(axis=1))
        if len(observed) < FEWEST:
            continue
        spread = np.full(len(value), np.nan) if declared is None else declared[part]
        dt = np.diff(track.t[part], prepend=track.t[a])
        chosen.append((m, dt, value, spread))
        frames += len(value)
        if frames >= MOST:
            break
    if not chosen:
        return None
    longest = max(len(dt) for _, dt, _, _ in chosen)
    width = chosen[0][2].shape[1]
    dt, spread = np.zeros((longest, len(chosen))), np.full((longest, len(chosen)), np.nan)
    value = np.full((longest, len(chosen), width), np.nan)
    for p, (_, steps, values, declared) in enumerate(chosen):
        n = len(steps)
        dt[:n, p], value[:n, p], spread[:n, p] = steps, values, declared
    return Pieces(dt, value, spread, np.array([m for m, *_ in chosen]))


WIDER = 10.0  # Of a position that is an outlier, the standard deviation over that of the others

TWO_PI = 2.0 * math.pi


def position_log_density(
    pieces: Pieces,
    default: float,
    speed_std: float,
    scale: FloatArray,
    wander: FloatArray,
    outliers: FloatArray,
) -> FloatArray:
    """Log density (G, P) of the positions (T, P, 2) of pieces, by each of G candidates.

    Parameters
    ----------
    default : σ in metres, where none is declared
    speed_std : m/s, 1-σ of each axis of the velocity where a piece begins
    scale : (G,) multiples of the declared σ
    wander : (G,) q in m²/s³
    outliers : (G,) probability of an outlier
    """
    shape = (len(scale), pieces.dt.shape[1])
    x, y, vx, vy, pp, pv, vv, total = np.zeros((8, *shape))
    begun = np.zeros(shape[1], bool)
    q, rate = wander[:, None], outliers[:, None]
    declared = np.where(np.isfinite(pieces.spread), pieces.spread, default)
    observed = pieces.observed
    for k in range(len(pieces.dt)):
        dt = pieces.dt[k]
        x, y = x + dt * vx, y + dt * vy
        pp = pp + dt * (2.0 * pv + dt * vv) + q * dt**3 / 3.0
        pv = pv + dt * vv + 0.5 * q * dt**2
        vv = vv + q * dt
        noise = (scale[:, None] * declared[k]) ** 2
        here, first = observed[k] & begun, observed[k] & ~begun
        zx, zy = np.where(observed[k], pieces.value[k].T, 0.0)
        dx, dy = zx - x, zy - y
        square, spread = dx * dx + dy * dy, pp + noise
        wide = pp + WIDER**2 * noise
        inlier = (1.0 - rate) * np.exp(-0.5 * square / spread) / (TWO_PI * spread)
        outlier = rate * np.exp(-0.5 * square / wide) / (TWO_PI * wide) + 1e-300
        share = np.where(here, inlier / (inlier + outlier), 0.0)
        total += np.where(here, np.log(inlier + outlier), 0.0)
        # An outlier leaves the prior unchanged; the mixture is moment-matched.
        gain_p, gain_v = share * pp / spread, share * pv / spread
        doubt = 0.5 * share * (1.0 - share) * square / spread**2
        x, y, vx, vy = x + gain_p * dx, y + gain_p * dy, vx + gain_v * dx, vy + gain_v * dy
        pp, pv, vv = (
            pp - gain_p * pp + doubt * pp * pp,
            pv - gain_p * pv + doubt * pp * pv,
            vv - gain_v * pv + doubt * pv * pv,
        )
        if first.any():
            x, y = np.where(first, zx, x), np.where(first, zy, y)
            vx, vy = np.where(first, 0.0, vx), np.where(first, 0.0, vy)
            pp, pv, vv = (
                np.where(first, noise, pp),
                np.where(first, 0.0, pv),
                np.where(first, speed_std**2, vv),
            )
            begun = begun | first
    return total


def angle_log_density(
    pieces: Pieces, default: float, scale: FloatArray, wander: FloatArray, outliers: FloatArray
) -> FloatArray:
    """Log density (G, P) of the angles (T, P, 1) of pieces, by each of G candidates.

    A mixture is approximated by the von Mises density of the same mean resultant.

    Parameters
    ----------
    default : κ where none is declared
    scale : (G,) multiples of the declared 1-σ; κ is divided by their square
    wander : (G,) diffusion in rad²/s
    outliers : (G,) probability of an outlier
    """
    shape = (len(scale), pieces.dt.shape[1])
    # Mean resultant vectors.
    along, across, total = np.zeros((3, *shape))
    declared = np.where(np.isfinite(pieces.spread), pieces.spread, default)
    rate, observed = outliers[:, None], pieces.observed & (declared > 0.0)
    for k in range(len(pieces.dt)):
        kept = np.exp(-0.5 * wander[:, None] * pieces.dt[k])
        along, across = kept * along, kept * across
        here = observed[k]
        if not here.any():
            continue
        angle = np.where(here, pieces.value[k, :, 0], 0.0)
        cos, sin = np.cos(angle), np.sin(angle)
        noise = np.where(here, declared[k], 0.0) / scale[:, None] ** 2
        length = np.hypot(along, across) + 1e-12
        known = concentration_from_resultant(length)
        one, two = known * along / length + noise * cos, known * across / length + noise * sin
        both = np.hypot(one, two) + 1e-12
        inlier = special.i0e(both) / (special.i0e(known) * special.i0e(noise)) * np.exp(both - known - noise)
        density = (1.0 - rate) * inlier + rate
        total += np.where(here, np.log(density / TWO_PI), 0.0)
        share = np.where(here, (1.0 - rate) * inlier / density, 0.0)
        after = mean_resultant_length(both) / both
        along, across = (
            share * after * one + (1.0 - share) * along,
            share * after * two + (1.0 - share) * across,
        )
    return total


Density = Callable[[Pieces, FloatArray, FloatArray, FloatArray], FloatArray]
"""Pieces, (G,) multiples of the noise and of the model's wander, probabilities of an outlier → (G, P)."""

SURE = 0.999  # Probability of the intervals against which a declaration is tested

FEWEST_PIECES, FEWEST_OBSERVED = 4, 100

_PRIOR_MEAN = np.array([0.0, 0.0, np.log(0.02 / 0.98)])
_PRIOR_STD = np.array([3.0, 2.0, 1.5])
"""Prior of the logarithms of the multiples, and of the log odds of an outlier: broad."""

_STEP, _FAR = 0.1, 1.0
_WIDEST = 10.0
_LIMITS = np.array([np.log(50.0), 10.0, 10.0])
"""Of what is tried, on the same scales: the noise of observations without any has no other."""
_COARSE = [np.log(10.0) * np.linspace(-1.0, 1.0, 9), np.linspace(-4.0, 4.0, 5)]


@dataclass(frozen=True)
class Multiplier:
    """Factor for a declared 1-σ, and its interval of probability `SURE`.

    It is based on ``observed`` observations in ``pieces`` stretches.
    """

    value: float
    low: float
    high: float
    observed: int
    pieces: int


def multiplier_of(pieces: Pieces, density: Density) -> Multiplier | None:
    """Estimate the multiplier of the declared noise jointly with the motion noise; None for too few data."""
    count, observed = len(pieces.track), int(pieces.observed.sum())
    if count < FEWEST_PIECES or observed < FEWEST_OBSERVED:
        return None

    def values(points: FloatArray, some: Pieces) -> FloatArray:
        scale, wander = np.exp(points[:, 0]), np.exp(points[:, 1])
        return density(some, scale, wander, 1.0 / (1.0 + np.exp(-points[:, 2])))

    def penalty(points: FloatArray) -> FloatArray:
        return np.asarray(0.5 * np.sum(((points - _PRIOR_MEAN) / _PRIOR_STD) ** 2, axis=1))

    grid = np.stack(np.meshgrid(*_COARSE, _PRIOR_MEAN[2:], indexing="ij"), axis=-1).reshape(-1, 3)
    few = pieces.part(max(FEWEST_PIECES, count // 6))
    best = grid[np.argmax(values(grid, few).sum(axis=1) - penalty(grid))]
    for _ in range(8):
        points = best + _STEP * _STENCIL
        found = values(points, pieces)
        costs = penalty(points) - found.sum(axis=1)
        slope = (costs[1:4] - costs[4:7]) / (2.0 * _STEP)
        hessian = _hessian(costs)
        step = np.clip(-np.linalg.solve(hessian, slope), -_FAR, _FAR)
        best = np.clip(best + step, -_LIMITS, _LIMITS)
        if np.abs(step).max() < 0.02:
            break
    slopes = _by_track((found[1:4] - found[4:7]).T / (2.0 * _STEP), pieces.track)
    blocks = len(slopes)
    inverse = np.linalg.inv(hessian)
    scatter = (slopes - slopes.mean(axis=0)).T @ (slopes - slopes.mean(axis=0)) * blocks / (blocks - 1)
    # Use the larger variance: the sandwich if tracks differ, the curvature if they are few.
    variance = max((inverse @ scatter @ inverse)[0, 0], inverse[0, 0])
    half = min(float(special.stdtrit(blocks - 1, 0.5 + 0.5 * SURE) * np.sqrt(variance)), _WIDEST)
    low, value, high = np.exp(best[0] + np.array([-half, 0.0, half])).tolist()
    return Multiplier(value, low, high, observed, count)


_STENCIL = np.vstack([np.zeros((1, 3)), np.eye(3), -np.eye(3), 1.0 - np.eye(3)])
"""Stencil: the centre, one step up and down each axis, and up two axes at a time."""


def _hessian(costs: FloatArray) -> FloatArray:
    """Return the (3, 3) Hessian from the costs at the stencil, positive definite."""
    middle, up, down = costs[0], costs[1:4], costs[4:7]
    hessian = np.diag(up + down - 2.0 * middle)
    for left_out in range(3):
        i, j = (axis for axis in range(3) if axis != left_out)
        hessian[i, j] = hessian[j, i] = costs[7 + left_out] - up[i] - up[j] + middle
    sizes, axes = np.linalg.eigh(hessian / _STEP**2)
    return np.asarray((axes * np.maximum(sizes, _PRIOR_STD.max() ** -2)) @ axes.T)


def _by_track(slopes: FloatArray, track: NDArray[np.int64]) -> FloatArray:
    """Sum the slopes (P, 3) of each track; return those of pieces if there are too few tracks."""
    names, place = np.unique(track, return_inverse=True)
    if len(names) < 10:
        return slopes
    found = np.zeros((len(names), slopes.shape[1]))
    np.add.at(found, place, slopes)
    return found


BASE = 1.0  # Seconds over which the direction of motion is measured

MOVING = 0.5  # m/s over that time from which the direction is defined

FEWEST_TRACKS, FEWEST_FOR_BIAS = 8, 8
"""Fewest tracks, and observations in motion of each, to separate a bias from people's gaits."""

MOST_TRACKS = 400

SHARED = 0.7  # Smallest share of the tracks with a common bias


@dataclass(frozen=True)
class Bias:
    """Rotation in radians of observed from true angles, and its 99.9 % interval.

    ``share`` of the ``tracks`` agree on it.
    """

    value: float
    low: float
    high: float
    share: float
    tracks: int


def bias_of(tracks: Sequence[Track], name: str, rng: np.random.Generator) -> Bias | None:
    """Estimate the common bias of "body" or "head"; None for too few tracks."""
    offsets: list[float] = []
    for m in rng.permutation(len(tracks)).tolist():
        offset = offset_of(tracks[m], name)
        if math.isfinite(offset):
            offsets.append(offset)
        if len(offsets) == MOST_TRACKS:
            break
    return None if len(offsets) < FEWEST_TRACKS else shared_offset(np.array(offsets))


def shared_offset(offsets: FloatArray) -> Bias:
    """Return the mode of the offsets (m,) of tracks, in radians."""
    grid = np.radians(np.arange(-180.0, 180.0, 2.0))
    sharp, share = np.array([3.0, 8.0, 20.0, 60.0, 200.0]), np.array([0.3, 0.5, 0.7, 0.85, 0.95, 0.99])
    about = von_mises_log_density(offsets, grid[:, None, None], sharp[:, None])
    mixed = share[:, None] * np.exp(about)[:, :, None, :] + (1.0 - share[:, None]) / (2.0 * math.pi)
    total = np.log(mixed).sum(axis=-1)
    b, k, s = np.unravel_index(np.argmax(total), total.shape)
    inside = mixed[b, k, s] - (1.0 - share[s]) / (2.0 * math.pi)
    weight = inside / mixed[b, k, s]
    # The weighted mean, and its scatter as that of independent tracks.
    mean = unit(offsets).T @ weight
    value = math.atan2(mean[1], mean[0])
    apart = np.sin(offsets - value) * weight
    error = math.sqrt(float(apart @ apart)) / max(float(np.cos(offsets - value) @ weight), 1e-9)
    half = 3.3 * error * math.sqrt(len(offsets) / (len(offsets) - 1.0))
    return Bias(value, value - half, value + half, float(weight.mean()), len(offsets))


def offset_of(track: Track, name: str) -> float:
    """Return the circular mean of an observed orientation minus the direction of motion; NaN for few data."""
    angle = observed_angle(track, name)
    observed = np.isfinite(angle)
    place = np.flatnonzero(np.isfinite(track.position).all(axis=1))
    if not observed.any() or len(place) < 3:
        return math.nan
    t, position = track.t[place], track.position[place]
    at = track.t[observed]
    before = np.clip(np.searchsorted(t, at - 0.5 * BASE - TIME_TOLERANCE), 0, len(t) - 1)
    after = np.clip(np.searchsorted(t, at + 0.5 * BASE - TIME_TOLERANCE), 0, len(t) - 1)
    # The interval is centred on the frame, so that turns within it average out.
    apart, seconds = position[after] - position[before], t[after] - t[before]
    off_centre = np.abs(0.5 * (t[after] + t[before]) - at)
    moves = (np.linalg.norm(apart, axis=1) > MOVING * seconds) & (seconds >= 0.5 * BASE - TIME_TOLERANCE)
    moves &= off_centre <= 0.25 * np.maximum(seconds, BASE) + TIME_TOLERANCE
    if moves.sum() < FEWEST_FOR_BIAS:
        return math.nan
    offsets = angle[observed][moves] - np.arctan2(apart[moves, 1], apart[moves, 0])
    mean = unit(offsets).mean(axis=0)
    return math.atan2(mean[1], mean[0])


def turned(track: Track, name: str, by: float) -> dict[str, FloatArray]:
    """Rotate the channels of an orientation by radians; classes are interpolated between neighbours."""
    angle, classes = getattr(track, name), getattr(track, f"{name}_likelihood")
    changes: dict[str, FloatArray] = {}
    if angle is not None:
        changes[name] = wrap(angle + by)
    if classes is not None:
        shift = by / (2.0 * math.pi) * classes.shape[1]
        full_steps = math.floor(shift)
        part = shift - full_steps
        one, next_one = np.roll(classes, full_steps, axis=1), np.roll(classes, full_steps + 1, axis=1)
        changes[f"{name}_likelihood"] = (1.0 - part) * one + part * next_one
    return changes


Trust = Literal["declared", "check", "learn"]
"""Use of the declared noise: unchanged; checked, with reports of contradictions; or corrected there."""

TOO_FAR, SURELY = 1.25, 1.1
"""A declared σ is contradicted if wrong by the first factor, and by the second with 99.9 % probability."""

BIASED, SURELY_BIASED = math.radians(10.0), math.radians(4.0)  # Likewise for a bias


@dataclass(frozen=True)
class ChannelNoise:
    """The evidence about the declared noise of a channel.

    Attributes
    ----------
    name : "position", "body" or "head"
    multiplier : factor of the declared 1-σ; None: too few observations
    bias : bias of angles; None: too few people in motion
    column : the file's column that declares the noise, else the model's parameter
    """

    name: str
    multiplier: Multiplier | None
    bias: Bias | None
    column: str

    @property
    def scale(self) -> float:
        """Factor for the declared σ: 1 if it is not contradicted."""
        found = self.multiplier
        if found is None or 1.0 / TOO_FAR < found.value < TOO_FAR:
            return 1.0
        return found.value if found.low > SURELY or found.high < 1.0 / SURELY else 1.0

    @property
    def turn(self) -> float:
        """Common rotation of the observed angles in radians; 0 if the data do not show one."""
        found = self.bias
        if found is None or abs(found.value) < BIASED or found.share < SHARED:
            return 0.0
        sure = min(abs(found.low), abs(found.high)) > SURELY_BIASED and found.low * found.high > 0.0
        return found.value if sure else 0.0

    def line(self, corrected: bool) -> str | None:
        """Return a report in one line; None if there is nothing to report."""
        lines: list[str] = []
        if self.scale != 1.0 and self.multiplier is not None:
            found = self.multiplier
            lines.append(
                f"the noise is {found.value:.2g} times ({found.low:.2g} to {found.high:.2g}) what "
                f"{self.column} says" + ("" if self.name == "position" else " (as a 1-σ)")
            )
        if self.turn and self.bias is not None:
            degrees = math.degrees(self.turn)
            side = "left" if degrees > 0.0 else "right"
            lines.append(f"people are seen turned {abs(degrees):.0f}° to the {side} of where they go")
        if not lines:
            return None
        end = "corrected" if corrected else "graphtrack smooth --trust learn corrects it"
        return f"{self.name}: {' and '.join(lines)}; {end}"


@dataclass(frozen=True)
class Noise:
    """Evidence about the declared noise of all channels that a model reads."""

    channels: tuple[ChannelNoise, ...]

    def lines(self, corrected: bool = False) -> list[str]:
        """Return contradictions of the declarations, a line for each channel."""
        return [line for one in self.channels if (line := one.line(corrected)) is not None]

    def corrected(self, tracks: TrackSet, model: Model) -> tuple[TrackSet, Model]:
        """Return tracks without biases, and the model with noise consistent with the data."""
        likelihood, changes = model.parameters.likelihood, {}
        for one in self.channels:
            if one.scale != 1.0:
                default, power = _DECLARED[one.name]
                for name, factor in ((f"{one.name}_scale", one.scale), (default, one.scale**power)):
                    low, high = range_of(likelihood, name) or (0.0, math.inf)
                    changes[name] = min(max(getattr(likelihood, name) * factor, low), high)
        if changes:
            parameters = replace(model.parameters, likelihood=replace(likelihood, **changes))
            model = model.with_parameters(parameters)
        turns = [one for one in self.channels if one.turn]

        def corrected(track: Track) -> Track:
            changes: dict[str, Any] = {}
            for one in turns:
                changes |= turned(track, one.name, -one.turn)
            return replace(track, **changes)

        return (tracks.map(corrected) if turns else tracks), model


def trusted(tracks: TrackSet, model: Model, trust: Trust) -> tuple[TrackSet, Model, list[str]]:
    """Return tracks and model to solve, and notes on the noise and on channels that the model does not use.

    Raise InputError for an unknown `Trust`.
    """
    if trust not in ("declared", "check", "learn"):
        raise InputError(f"trust {trust!r}", "declared, check or learn")
    notes = notes_on(tracks.tracks, model, tracks.camera)
    tracks = tracks.map(with_position_noise)
    if trust == "declared":
        return tracks, model, notes
    noise = declared_noise(tracks.tracks, model)
    if trust == "check":
        return tracks, model, [*notes, *noise.lines()]
    return *noise.corrected(tracks, model), [*notes, *noise.lines(corrected=True)]


_DECLARED = {"position": ("position_std", 1.0), "body": ("body_kappa", -2.0), "head": ("head_kappa", -2.0)}
"""Channel and parameter of the noise, and its power of a multiple of σ."""


def declared_noise(tracks: Sequence[Track], model: Model) -> Noise:
    """Test the noise that a file, or else the model, declares against the data.

    Multipliers maximise the one-step predictive likelihood, always on the same stretches. A bias is a common
    angle of all people to their motion. Positions observed in the image, and class likelihoods except for
    their bias, are left out.
    """
    found, parameters = [], model.parameters
    for name in ("position", "body", "head"):
        if name != "position" and not getattr(model, f"has_{name}"):
            continue
        rng = np.random.default_rng(0)
        multiplier = _multiplier(tracks, name, parameters, rng)
        bias = None if name == "position" else bias_of(tracks, name, rng)
        if multiplier is None and bias is None:
            continue
        key, _ = _DECLARED[name]
        given = any(getattr(track, key) is not None for track in tracks)
        column = {"position_std": "pos_std"}.get(key, key) if given else f"likelihood.{key}"
        found.append(ChannelNoise(name, multiplier, bias, column))
    return Noise(tuple(found))


def _multiplier(
    tracks: Sequence[Track], name: str, parameters: Parameters, rng: np.random.Generator
) -> Multiplier | None:
    key, _ = _DECLARED[name]
    likelihood = parameters.likelihood
    default, current = float(getattr(likelihood, key)), float(getattr(likelihood, f"{name}_scale"))

    def channel(track: Track) -> tuple[FloatArray | None, FloatArray | None]:
        in_image = name == "position" and likelihood.image_frame and track.pixel is not None
        given = getattr(track, key)
        spread = None if given is None else given * current ** _DECLARED[name][1]
        return None if in_image else getattr(track, name), spread

    def density(some: Pieces, scale: FloatArray, wander: FloatArray, outliers: FloatArray) -> FloatArray:
        if name == "position":
            motion = parameters.motion
            q = motion.acceleration_density * wander
            return position_log_density(some, default, motion.initial_speed_std, scale, q, outliers)
        diffusion = getattr(parameters.orientation, f"{name}_diffusion")
        return angle_log_density(some, default, scale, diffusion * wander, outliers)

    pieces = pieces_of(tracks, channel, rng)
    return None if pieces is None else multiplier_of(pieces, density)
