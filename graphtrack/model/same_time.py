"""Observations of one person at one time: their likelihoods are multiplied.

White-noise acceleration ties the positions of two frames with the information 12/(q·Δt³). Where frames are
close, it hides the information of observations, 1/σ², from the 16 digits of a double (`motion.rounding`).
So rows nearer than `SAME_TIME` are one frame of the model. Within that time a pedestrian moves by 1 mm.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.observation import CHANNELS, Observation, observation_at
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.model.terms.conversation import GROUP
from graphtrack.model.terms.position import robust_weights
from graphtrack.model.terms.walls import WALL_INPUT
from graphtrack.tracks.track import Track
from graphtrack.tracks.validation import APPEARANCE, LARGEST_CONCENTRATION, SHAPES

SAME_TIME = 5e-4
"""Seconds. Rows of one person that are nearer are observations of one time.

With q from 0.01 to 10 m²/s³ and σ from 5 mm to 1 m, the worst rounding error of estimates of frames that are
this far apart is 2 % of their σ, and of their variance 0.06 %. Both grow with Δt⁻³."""

_MEASURED = (
    ("position", "position_std"),
    ("pixel",),
    ("body", "body_kappa"),
    ("head", "head_kappa"),
    ("body_likelihood",),
    ("head_likelihood",),
)
"""The channels of each measurement, with its noise."""

_OF_ENGINES = (WALL_INPUT, GROUP, APPEARANCE)
"""Inputs that an engine sets for each row, or that no term reads: of one time the first is kept."""

_REWEIGHTED = 50
"""Steps of iteratively reweighted least squares."""

_Orientation = Literal["body", "head"]


def seconds_apart(first: float, second: float) -> float:
    """Return the seconds from one time to another, 0 for times that count as one."""
    apart = second - first
    return 0.0 if abs(apart) < SAME_TIME else apart


def news(known: Sequence[Observation], new: Observation) -> Observation | None:
    """Return an observation without what is known already of its time; None if nothing is left.

    A measurement is known if an observation with exactly that time has it with the same value and noise: it
    was sent twice. Another value is a second measurement.
    """
    left: dict[str, Any] = {}
    again = [one for one in known if one.t == new.t]
    for names in _MEASURED:
        value = [getattr(new, name) for name in names]
        if value[0] is None or any(value == [getattr(one, name) for name in names] for one in again):
            left |= dict.fromkeys(names)
    inputs = {
        name: value
        for name, value in new.inputs.items()
        if all(name not in one.inputs or not _agree(name, one.inputs[name], value) for one in known)
    }
    found = replace(new, inputs=inputs, **left)
    has_measurement = any(getattr(found, names[0]) is not None for names in _MEASURED)
    return found if has_measurement or inputs else None


def _agree(name: str, known: object, new: object) -> bool:
    return name in _OF_ENGINES or known == new


def merged(
    parts: Sequence[Observation], likelihood: LikelihoodParameters, camera: GroundCamera | None
) -> Observation:
    """Return one observation with the product of the likelihoods of some, at the time of the first.

    Positions have the mean weighted by 1/σ² or, with a robust loss, the M-estimate; von Mises densities have
    the sum of κ·e^{iθ}; class likelihoods are multiplied. Losses and outlier shares apply to the product.

    Raises
    ------
    InputError
        Naming what has no product in the model: two pixels that are judged in the image, an angle and class
        likelihoods, classes that exclude each other, two values of an input.
    """
    if len(parts) == 1:
        return parts[0]
    changed: dict[str, Any] = _position(parts, likelihood, camera)
    changed |= _orientation(parts, "body", likelihood) | _orientation(parts, "head", likelihood)
    changed["score"] = next((one.score for one in parts if one.score is not None), None)
    return replace(parts[0], inputs=_inputs(parts), **changed)


def _refused(parts: Sequence[Observation], what: str, expected: str) -> InputError:
    return InputError(f"{what} within {SAME_TIME:g} s at t = {parts[0].t:.12g}", expected)


def _position(
    parts: Sequence[Observation], likelihood: LikelihoodParameters, camera: GroundCamera | None
) -> dict[str, Any]:
    in_image = [one for one in parts if one.pixel is not None]
    if likelihood.image_frame and camera is not None and in_image:
        if sum(one.pixel is not None or one.position is not None for one in parts) > 1:
            expected = "one of them, or positions that are judged in metres (likelihood.image_frame = false)"
            raise _refused(parts, "a pixel next to another pixel or position", expected)
        (one,) = in_image
        return {name: getattr(one, name) for name in ("position", "position_std", "pixel")}
    pixel = in_image[0].pixel if len(in_image) == 1 else None
    placed = [one for one in parts if one.position is not None]
    if len(placed) < 2:
        given = placed[0] if placed else parts[0]
        return {"position": given.position, "position_std": given.position_std, "pixel": pixel}
    std = np.array([likelihood.position_stds(one.position_std, 1).item() for one in placed])
    mean, spread = _m_estimate(np.array([one.position for one in placed]), std, likelihood)
    declared = spread / likelihood.position_scale
    return {"position": tuple(mean.tolist()), "position_std": declared, "pixel": pixel}


def _m_estimate(
    position: FloatArray, std: FloatArray, likelihood: LikelihoodParameters
) -> tuple[FloatArray, float]:
    """Return the mode (2,) of the product of position likelihoods, and its 1-σ by the weights there."""
    weight = inliers = np.square(std.min() / std)
    for _ in range(_REWEIGHTED if likelihood.robust != "none" else 1):
        mean = weight @ position / weight.sum()
        distance = np.hypot(*(position - mean).T) / std
        weight = inliers * robust_weights(distance, likelihood)
    return mean, float(std.min() / np.sqrt(weight.sum()))


def _orientation(
    parts: Sequence[Observation], name: _Orientation, likelihood: LikelihoodParameters
) -> dict[str, Any]:
    """Return the channels of body or head; an angle in a row with class likelihoods is not read."""
    kappa_of, classes_of = f"{name}_kappa", f"{name}_likelihood"
    classes = [one for one in parts if getattr(one, classes_of) is not None]
    angles = [one for one in parts if getattr(one, name) is not None and one not in classes]
    if angles and classes:
        raise _refused(parts, f"an angle and class likelihoods of the {name}", "one of the two")
    if len(classes) > 1:
        product = np.ones(len(getattr(classes[0], classes_of)))
        for one in classes:
            heights = np.array(getattr(one, classes_of))
            # Zeros throughout are uninformative.
            product *= heights / heights.max() if heights.any() else 1.0
        if not product.any():
            raise _refused(parts, f"classes of the {name} that exclude each other", "a class that all allow")
        return {classes_of: tuple((product / product.sum()).tolist()), name: None, kappa_of: None}
    if len(angles) > 1:
        theta = np.array([getattr(one, name) for one in angles])
        kappa = [likelihood.kappas(name, getattr(one, kappa_of), 1).item() for one in angles]
        east, north = float(kappa @ np.cos(theta)), float(kappa @ np.sin(theta))
        declared = math.hypot(east, north) * getattr(likelihood, f"{name}_scale") ** 2
        return {name: math.atan2(north, east), kappa_of: min(declared, LARGEST_CONCENTRATION)}
    given = next(iter(classes or angles), parts[0])
    return {channel: getattr(given, channel) for channel in (name, kappa_of, classes_of)}


def _inputs(parts: Sequence[Observation]) -> dict[str, float | tuple[float, ...]]:
    found: dict[str, float | tuple[float, ...]] = {}
    for one in parts:
        for name, value in one.inputs.items():
            if not _agree(name, found.setdefault(name, value), value):
                raise _refused(parts, f"two values of the input {name!r}", "one value")
    return found


def merged_rows(
    track: Track, likelihood: LikelihoodParameters, camera: GroundCamera | None
) -> tuple[Track, NDArray[np.int64]] | None:
    """Return a track with one frame for the rows of one time, and the frame of each row (n,); None: as it is.

    Rows count as one time with the first row that they are less than `SAME_TIME` after. Raise InputError as
    `merged`.
    """
    t = track.t
    if not (np.diff(t) < SAME_TIME).any():
        return None
    first = [0]
    for k in range(1, len(t)):
        if seconds_apart(t[first[-1]], t[k]) > 0.0:
            first.append(k)
    starts, rows = np.array(first), np.arange(len(t))
    frame = np.searchsorted(starts, rows, side="right") - 1
    given = {name: value for name in CHANNELS if (value := getattr(track, name)) is not None}
    channels: dict[str, FloatArray] = {name: value[starts] for name, value in given.items()}
    inputs = {name: value[starts] for name, value in track.inputs.items()}
    for k in np.flatnonzero(np.bincount(frame) > 1).tolist():
        same = rows[frame == k].tolist()
        parts = [observation_at(i, float(t[i]), int(track.frame[i]), given, track.inputs) for i in same]
        one = merged(parts, likelihood, camera)
        for name in CHANNELS:
            value = getattr(one, name)
            if value is not None and name not in channels:  # a noise that no row declares
                channels[name] = np.full((len(starts), *SHAPES[name]), np.nan)
            if name in channels:
                channels[name][k] = np.nan if value is None else value
        for name, values in inputs.items():
            values[k] = one.inputs.get(name, np.nan)
    changed: dict[str, Any] = {**channels, "inputs": inputs}
    return replace(track[starts], **changed), frame


def with_merged_rows(
    tracks: Iterable[Track], likelihood: LikelihoodParameters, camera: GroundCamera | None
) -> list[Track]:
    """Return tracks with one frame for the rows of one time; InputError as `merged`."""
    found = ((track, merged_rows(track, likelihood, camera)) for track in tracks)
    return [track if one is None else one[0] for track, one in found]


def of_every_row(estimates: Track, track: Track, frame: NDArray[np.int64]) -> Track:
    """Return the estimates of frames of `merged_rows` as those of each row of the track."""
    optional = {
        name: values[frame] for name in ("body", "head") if (values := getattr(estimates, name)) is not None
    }
    assert estimates.velocity is not None and estimates.covariance is not None
    return track.with_estimates(
        position=estimates.position[frame],
        velocity=estimates.velocity[frame],
        covariance=estimates.covariance[frame],
        **optional,
    )
