"""Observed angles against the direction of motion: a rotation, a mirror, and the convention that fits.

An observed angle is s·θ + ω + noise, with θ the direction of motion, s = −1 of mirrored angles and ω common
to all people. Stretches of `STRETCH` seconds have an offset from a von Mises density about ω or, for some,
from a uniform density; s and ω are of maximum likelihood. Where all people walk along one line, a mirror is a
rotation too, and the more usual convention is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, difference, unit, von_mises_log_density, wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import COMPASS, IMAGE, NATIVE, AngleConvention, Sense, converted
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet, observed_angle

BASE = 1.0  # Seconds over which the direction of motion is measured

MOVING = 0.5  # m/s over that time from which the direction is defined

STRETCH = 2.0  # Seconds of a person in motion that give one offset, since gaze persists

FEWEST_TRACKS, FEWEST_OBSERVATIONS = 8, 8
"""Fewest tracks, and observations in motion of each, to separate a rotation from people's gaits."""

FEWEST_GROSS = 2  # Fewest tracks for a rotation by more than `GROSS`, which no gait has

MOST_TRACKS, MOST_STRETCHES, MOST_OFFSETS = 400, 16, 640
"""Most tracks, stretches of each, and stretches of all."""

SHARED, NEAR = 0.7, math.radians(45.0)
"""Smallest share of the stretches whose offsets are near the common one."""

BIASED, SURELY_BIASED = math.radians(10.0), math.radians(4.0)
"""A rotation is reported from the first on, if it is above the second with 99.9 % probability."""

GROSS = math.radians(45.0)

DECIDED = 8.0
"""Logarithm of the likelihood ratio that decides between a mirror and a rotation."""

_UNUSUAL = 0.02
"""Cosine by which each further convention in the order of `_USUAL` has to fit better."""

_USUAL: Sequence[tuple[str, Sense]] = (
    *(("right", "ccw"), ("up", "cw"), ("right", "cw"), ("up", "ccw")),
    *(("down", "cw"), ("left", "cw"), ("down", "ccw"), ("left", "ccw")),
)
_OF_COMPASS = dict(zip(IMAGE, COMPASS, strict=True))  # right: east …


@dataclass(frozen=True)
class AngleFit:
    """Relation of observed angles to the direction of motion, or to other angles.

    Attributes
    ----------
    is_mirrored : whether observed angles decrease where true ones increase
    value, low, high : ω in radians, and its 99.9 % interval
    share : share of the stretches that agree on it
    tracks : number of people
    convention : convention of the file in which the angles would be right
    current : convention in which they were read
    """

    is_mirrored: bool
    value: float
    low: float
    high: float
    share: float
    tracks: int
    convention: AngleConvention = NATIVE
    current: AngleConvention = NATIVE

    @property
    def is_wrong(self) -> bool:
        """Return whether the angles surely are mirrored or rotated."""
        if self.share < SHARED or self.high - self.low > 2.0 * NEAR:
            return False
        if self.is_mirrored:
            return True
        fewest = FEWEST_GROSS if self.is_gross else FEWEST_TRACKS
        sure = min(abs(self.low), abs(self.high)) > SURELY_BIASED and self.low * self.high > 0.0
        return self.tracks >= fewest and abs(self.value) >= BIASED and sure

    @property
    def is_gross(self) -> bool:
        """Return whether this is another convention rather than an error of a detector."""
        return self.is_mirrored or abs(self.value) > GROSS

    def corrected(self, track: Track, name: str, camera: GroundCamera | None) -> dict[str, FloatArray]:
        """Return the angles and class likelihoods "body" or "head" of a track in the fitting convention."""
        names = (name, f"{name}_likelihood")
        given = {one: value for one in names if (value := getattr(track, one)) is not None}
        places = {"position": track.position, "pixel": track.pixel}
        return _read_again(places, given, self.current, self.convention, camera) if given else {}

    @property
    def relation(self) -> str:
        """Words for a mirror or a rotation."""
        side = "clockwise" if self.value < 0.0 else "counter-clockwise"
        return "mirrored" if self.is_mirrored else f"turned by {abs(math.degrees(self.value)):.0f}° {side}"

    def described(self) -> str:
        """Return the finding as a phrase."""
        degrees = math.degrees(self.value)
        if not self.is_gross:
            side = "left" if degrees > 0.0 else "right"
            return f"people are seen turned {abs(degrees):.0f}° to the {side} of where they go"
        people = "one person" if self.tracks == 1 else f"{self.tracks} people"
        found = f"the angles are {self.relation} against the motion of {people}"
        if self.is_mirrored or isinstance(self.convention.zero, str):
            return f"{found}: they fit --angles '{self.convention}', and were read {self.current}"
        return f"{found}: these people go sideways, or fit --angles '{self.convention}', which is unusual"


def angle_fit(tracks: TrackSet, name: str) -> AngleFit | None:
    """Compare "body" or "head" with the direction of motion; None for too few people in motion."""
    observed = _stretches(tracks.tracks, name, direction_of_motion)
    found = None if observed is None else observed.fit()
    return _named(found, observed.people, tracks) if observed and found and found.is_wrong else found


def proposed_convention(tracks: TrackSet) -> tuple[AngleConvention | None, tuple[str, ...]]:
    """Return the convention that all angles of a file fit, if it is another one, and remarks."""
    found = {name: angle_fit(tracks, name) for name in ("body", "head")}
    wrong = {name: one for name, one in found.items() if one is not None and one.is_wrong and one.is_gross}
    remarks = tuple(f"{name}: {one.described()}" for name, one in wrong.items())
    right = [name for name, one in found.items() if one is not None and name not in wrong]
    conventions = {one.convention for one in wrong.values()}
    if len(conventions) == 1 and not right:
        return conventions.pop(), remarks
    if wrong:
        remarks += ("body and head differ: --angles is for both; --trust learn corrects each by itself",)
    return None, remarks


def relation_of(tracks: TrackSet) -> AngleFit | None:
    """Compare heads with the bodies of the same frames; None for too few."""
    observed = _stretches(tracks.tracks, "head", lambda track: observed_angle(track, "body"))
    return None if observed is None else observed.fit()


def direction_of_motion(track: Track) -> FloatArray:
    """Return the direction of motion (n,) in radians; NaN where a person stands, or where it is unknown."""
    found = np.full(len(track), np.nan)
    place = np.flatnonzero(np.isfinite(track.position).all(axis=1))
    if len(place) < 3:
        return found
    t, position = track.t[place], track.position[place]
    before = np.clip(np.searchsorted(t, track.t - 0.5 * BASE - TIME_TOLERANCE), 0, len(t) - 1)
    after = np.clip(np.searchsorted(t, track.t + 0.5 * BASE - TIME_TOLERANCE), 0, len(t) - 1)
    # The interval is centred on the frame, so that turns within it average out.
    apart, seconds = position[after] - position[before], t[after] - t[before]
    off_centre = np.abs(0.5 * (t[after] + t[before]) - track.t)
    moves = (np.linalg.norm(apart, axis=1) > MOVING * seconds) & (seconds >= 0.5 * BASE - TIME_TOLERANCE)
    moves &= off_centre <= 0.25 * np.maximum(seconds, BASE) + TIME_TOLERANCE
    found[moves] = np.arctan2(apart[moves, 1], apart[moves, 0])
    return found


@dataclass(frozen=True, eq=False)
class _Person:
    """Angles (n,) of a person in radians, those to which they are compared, and position and pixel (n, 2)."""

    angle: FloatArray
    reference: FloatArray
    places: Mapping[str, FloatArray | None]


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Offsets of m stretches.

    Attributes
    ----------
    track : (m,) index of the person
    offsets : (2, m) radians, circular means of the angle minus, and plus, the reference
    people : observations of each person
    """

    track: NDArray[np.int64]
    offsets: FloatArray
    people: Sequence[_Person]

    def fit(self) -> AngleFit:
        """Return the fit of maximum likelihood, or the rotation where a mirror is no more likely."""
        tracks = len(np.unique(self.track))
        # With few people their scatter is unknown, and stretches are taken as independent.
        groups = self.track if tracks >= FEWEST_TRACKS else np.arange(len(self.track))
        plain, mirrored = (shared_offset(one, groups) for one in self.offsets)
        is_mirrored = mirrored.likelihood > plain.likelihood + DECIDED
        one = mirrored if is_mirrored else plain
        return AngleFit(is_mirrored, one.value, one.low, one.high, one.share, tracks)


def _stretches(
    tracks: Sequence[Track], name: str, reference_of: Callable[[Track], FloatArray]
) -> _Stretches | None:
    ordered = sorted(tracks, key=lambda track: track.track_id)
    every = max(1, len(ordered) // MOST_TRACKS)
    index: list[NDArray[np.int64]] = []
    offsets: list[FloatArray] = []
    people: list[_Person] = []
    chosen = ordered[::every]
    most = max(1, min(MOST_STRETCHES, MOST_OFFSETS // max(1, len(chosen))))
    for track in chosen:
        angle = observed_angle(track, name)
        if not np.isfinite(angle).any():
            continue
        reference = reference_of(track)
        usable = np.flatnonzero(np.isfinite(angle) & np.isfinite(reference))
        if len(usable) < FEWEST_OBSERVATIONS:
            continue
        _, stretch = np.unique(np.floor((track.t[usable] - track.t[0]) / STRETCH), return_inverse=True)
        pixel = None if track.pixel is None else track.pixel[usable]
        places = {"position": track.position[usable], "pixel": pixel}
        one = _Person(angle[usable], reference[usable], places)
        both = np.stack([one.angle - one.reference, one.angle + one.reference])
        count = int(stretch.max()) + 1
        means = np.stack([_circular_means(offset, stretch, count) for offset in both])
        means = means[:, np.linspace(0, count - 1, min(most, count)).round().astype(int)]
        index.append(np.full(means.shape[1], len(people)))
        offsets.append(means)
        people.append(one)
    if not people:
        return None
    return _Stretches(np.concatenate(index), np.concatenate(offsets, axis=1), people)


def _circular_means(angles: FloatArray, group: NDArray[np.int64], count: int) -> FloatArray:
    east, north = (np.bincount(group, one, count) for one in unit(angles).T)
    return np.arctan2(north, east)


@dataclass(frozen=True)
class CommonOffset:
    """Mode of offsets in radians, its 99.9 % interval, the share near it, and the log likelihood."""

    value: float
    low: float
    high: float
    share: float
    likelihood: float


def shared_offset(offsets: FloatArray, groups: NDArray[np.int64] | None = None) -> CommonOffset:
    """Return the mode of offsets (m,) in radians, and its interval for independent ``groups`` (m,)."""
    grid = np.radians(np.arange(-180.0, 180.0, 2.0))
    sharp, share = np.array([3.0, 8.0, 20.0, 60.0, 200.0]), np.array([0.3, 0.5, 0.7, 0.85, 0.95, 0.99])
    about = von_mises_log_density(offsets, grid[:, None, None], sharp[:, None])
    mixed = share[:, None] * np.exp(about)[:, :, None, :] + (1.0 - share[:, None]) / (2.0 * math.pi)
    total = np.log(mixed).sum(axis=-1)
    b, k, s = np.unravel_index(np.argmax(total), total.shape)
    inside = mixed[b, k, s] - (1.0 - share[s]) / (2.0 * math.pi)
    weight = inside / mixed[b, k, s]
    # The weighted mean, and its scatter as that of independent groups.
    mean = unit(offsets).T @ weight
    value = math.atan2(mean[1], mean[0])
    _, group = np.unique(np.arange(len(offsets)) if groups is None else groups, return_inverse=True)
    apart = np.bincount(group, np.sin(offsets - value) * weight)
    error = math.sqrt(float(apart @ apart)) / max(float(np.cos(offsets - value) @ weight), 1e-9)
    half = 3.3 * error * math.sqrt(len(apart) / (len(apart) - 1.0)) if len(apart) > 1 else math.inf
    near = float((np.cos(offsets - value) > math.cos(NEAR)).mean())
    return CommonOffset(value, value - half, value + half, near, float(total[b, k, s]))


def _read_again(
    places: Mapping[str, FloatArray | None],
    given: Mapping[str, FloatArray],
    current: AngleConvention,
    convention: AngleConvention,
    camera: GroundCamera | None,
) -> dict[str, FloatArray]:
    """Return channels that were read in one convention as if they had been read in another."""
    in_file = converted({**places, **given}, current, camera, back=True)
    return converted({**places, **in_file}, convention, camera)


def _named(found: AngleFit, people: Sequence[_Person], tracks: TrackSet) -> AngleFit:
    """Return the fit with the convention that fits: a named one, unless its zero is another."""
    as_read = tracks.as_read
    current = NATIVE if as_read is None or as_read.angles is None else as_read.angles
    names = dict(zip(IMAGE, IMAGE, strict=True)) if as_read is None or as_read.plane is None else _OF_COMPASS
    best, cosine, residual = current, -math.inf, math.inf
    for rank, (zero, sense) in enumerate(_USUAL if found.is_gross else ()):
        candidate = AngleConvention(names[zero], sense, current.unit)
        offsets = np.concatenate(
            [
                difference(
                    _read_again(one.places, {"head": one.angle}, current, candidate, tracks.camera)["head"],
                    one.reference,
                )
                for one in people
            ]
        )
        offsets = offsets[np.isfinite(offsets)]
        mean = unit(offsets).mean(axis=0)
        if mean[0] - rank * _UNUSUAL > cosine:
            best, cosine = candidate, mean[0] - rank * _UNUSUAL
            middle = math.atan2(mean[1], mean[0])
            residual = abs(middle + float(np.median(difference(offsets, middle))))
    tolerance = max(BIASED, 0.5 * (found.high - found.low))
    through_camera = current.is_in_image and tracks.camera is not None and not tracks.camera.is_scale
    if residual < tolerance or (through_camera and found.is_gross):
        return replace(found, convention=best, current=current)
    sign = -1.0 if found.is_mirrored else 1.0
    degrees = round(math.degrees(float(wrap(sign * (current.origin - found.value)))))
    turned = AngleConvention(degrees, "ccw" if sign * current.sign > 0.0 else "cw", current.unit)
    return replace(found, convention=turned, current=current)
