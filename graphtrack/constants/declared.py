"""Diagnosis of the declared noise: its maximum-likelihood multiple, and a bias of angles.

An angle to the motion common to all people is attributed to the detector: each track has an offset from a
von Mises density about the bias or, for some, from a uniform density.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from graphtrack.constants.noise import (
    SPREADS,
    NoiseEvidence,
    any_in_image,
    noise_evidence,
    scaled,
    undeclared,
)
from graphtrack.constants.personal import Constants, is_learned
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, unit, von_mises_log_density, wrap
from graphtrack.model.given import notes_on
from graphtrack.packages import special
from graphtrack.tracks.given import with_position_noise
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet, observed_angle

if TYPE_CHECKING:
    from graphtrack.model import Model


SURE = 0.999  # Probability of the intervals against which a declaration is tested

BLOCKS = 20
"""Blocks of people that the jackknife leaves out, one at a time."""


_WIDEST = 10.0
"""Largest half width of an interval, in the logarithm of the multiplier."""


@dataclass(frozen=True)
class Multiplier:
    """Factor for a declared 1-σ, and its interval of probability `SURE`.

    Attributes
    ----------
    value, low, high : of independent errors
    persistent : 1-σ of errors that persist, metres; 0: none
    """

    value: float
    low: float
    high: float
    persistent: float = 0.0


def multiplier_of(found: NoiseEvidence) -> Multiplier:
    """Return the multiplier of the declared noise.

    The variance is the larger one of the jackknife's, if people differ, and the curvature's, if they are few.
    """
    names, own = np.unique(found.tracks, return_inverse=True)
    block = (own if len(names) >= FEWEST_TRACKS else np.arange(len(own))) % BLOCKS
    known = np.unique(block).tolist()
    left_out = np.array([found.peak((block != one).astype(float))[0] for one in known])
    value, variance = found.peak()
    jackknife = float(np.sum((left_out - left_out.mean()) ** 2)) * (len(known) - 1) / len(known)
    reach = float(special.stdtrit(len(known) - 1, 0.5 + 0.5 * SURE))
    half = min(reach * math.sqrt(max(jackknife, variance)), _WIDEST)
    low, high = math.exp(value - half), math.exp(value + half)
    return Multiplier(math.exp(value), low, high, max(found.persistent.along, found.persistent.across))


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


def bias_of(tracks: Sequence[Track], name: str) -> Bias | None:
    """Estimate the common bias of "body" or "head"; None for too few tracks."""
    ordered = sorted(tracks, key=lambda track: track.track_id)
    every = max(1, len(ordered) // MOST_TRACKS)
    offsets = [offset for track in ordered[::every] if math.isfinite(offset := offset_of(track, name))]
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
            if found.persistent:
                lines.append(f"errors of {found.persistent:.2g} m persist")
        if self.turn and self.bias is not None:
            degrees = math.degrees(self.turn)
            side = "left" if degrees > 0.0 else "right"
            lines.append(f"people are seen turned {abs(degrees):.0f}° to the {side} of where they go")
        if not lines:
            return None
        end = "corrected" if corrected else "graphtrack smooth --trust learn corrects it"
        return f"{self.name}: {' and '.join(lines)}; {end}"


@dataclass(frozen=True)
class DeclaredNoise:
    """Evidence about the declared noise of all channels that a model reads."""

    channels: tuple[ChannelNoise, ...]

    def lines(self, corrected: bool = False) -> list[str]:
        """Return contradictions of the declarations, a line for each channel."""
        return [line for one in self.channels if (line := one.line(corrected)) is not None]

    def corrected(self, tracks: TrackSet, model: Model) -> tuple[TrackSet, Model]:
        """Return tracks without biases, and the model with noise consistent with the data."""
        parameters = model.parameters
        for one in self.channels:
            if one.scale != 1.0:
                parameters = scaled(parameters, one.name, one.scale)
        if parameters is not model.parameters:
            model = model.with_parameters(parameters)
        turns = [one for one in self.channels if one.turn]

        def corrected(track: Track) -> Track:
            changes: dict[str, Any] = {}
            for one in turns:
                changes |= turned(track, one.name, -one.turn)
            return replace(track, **changes)

        return (tracks.map(corrected) if turns else tracks), model


def trusted(
    tracks: TrackSet, model: Model, trust: Trust, constants: Constants | None = None
) -> tuple[TrackSet, Model, list[str]]:
    """Return tracks and model to solve, and notes on the noise and on channels that the model does not use.

    Raise InputError for an unknown `Trust`.

    Parameters
    ----------
    constants : where they are learned, noise that is not declared is learned too, and not checked
    """
    if trust not in ("declared", "check", "learn"):
        raise InputError(f"trust {trust!r}", "declared, check or learn")
    notes = notes_on(tracks.tracks, model, tracks.camera)
    tracks = tracks.map(with_position_noise)
    if trust == "declared":
        return tracks, model, notes
    left_out = undeclared(tracks, model) if is_learned(constants, model) else ()
    noise = declared_noise(tracks, model, left_out)
    if trust == "check":
        return tracks, model, [*notes, *noise.lines()]
    return *noise.corrected(tracks, model), [*notes, *noise.lines(corrected=True)]


def declared_noise(tracks: TrackSet, model: Model, left_out: Sequence[str] = ()) -> DeclaredNoise:
    """Test the noise that a file, or else the model, declares against the data.

    Multipliers maximise the one-step predictive likelihood, always on the same stretches. A bias is a common
    angle of all people to their motion. The noise of class likelihoods is not tested, but their bias.

    Parameters
    ----------
    left_out : channels whose noise is not tested
    """
    found = []
    for name, spread in SPREADS.items():
        if name != "position" and not getattr(model, f"has_{name}"):
            continue
        evidence = None
        classes = any(getattr(track, f"{name}_likelihood", None) is not None for track in tracks)
        if name not in left_out and not classes:
            evidence = noise_evidence(tracks.tracks, name, model.parameters, tracks.camera)
        bias = None if name == "position" else bias_of(tracks.tracks, name)
        if evidence is None and bias is None:
            continue
        given = any(getattr(track, spread) is not None for track in tracks)
        column = {"position_std": "pos_std"}.get(spread, spread) if given else f"likelihood.{spread}"
        if name == "position" and any_in_image(tracks, model.parameters):
            column = "likelihood.pixel_std"
        multiplier = None if evidence is None else multiplier_of(evidence)
        found.append(ChannelNoise(name, multiplier, bias, column))
    return DeclaredNoise(tuple(found))
