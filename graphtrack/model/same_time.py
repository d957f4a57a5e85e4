"""Observations of one person at one time: their likelihoods are multiplied.

White-noise acceleration ties the positions of two frames with the information 12/(q·Δt³). Where frames are
close, it hides the information of observations, 1/σ², from the 16 digits of a double (`motion.rounding`).
So rows nearer than `SAME_TIME` are one frame of the model. Within that time a pedestrian moves by 1 mm.

Where the product is none of the model's likelihoods, the later observation is a frame `APART` later:
positions or angles that contradict each other, where gross errors are expected; two pixels that are judged in
the image; an angle and class likelihoods; classes that exclude each other; two values of an input.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.observation import CHANNELS, Observation, observation_at
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.model.terms.conversation import GROUP
from graphtrack.model.terms.walls import WALL_INPUT
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import APPEARANCE, LARGEST_CONCENTRATION, SHAPES

SAME_TIME = 5e-4
"""Seconds. Rows of one person that are nearer are observations of one time.

With q from 0.01 to 10 m²/s³ and σ from 5 mm to 1 m, the worst rounding error of estimates of frames that are
this far apart is 2 % of their σ, and of their variance 0.06 %. Both grow with Δt⁻³."""

APART = 2.0 * SAME_TIME
"""Seconds from one time to the frame of an observation that has no product with those of that time."""

MOVED = f"contradicts the row of its time, and counts {1000.0 * APART:g} ms later"
"""Of such an observation."""

_MEASURED = (
    ("position", "position_std", "position_covariance"),
    ("pixel",),
    ("observed_velocity", "observed_velocity_covariance"),
    ("body", "body_kappa"),
    ("body_axis", "body_axis_kappa"),
    ("head", "head_kappa"),
    ("body_likelihood",),
    ("head_likelihood",),
)
"""The channels of each measurement, with its noise."""

_OF_ENGINES = (WALL_INPUT, GROUP, APPEARANCE)
"""Inputs that an engine sets for each row, or that no term reads: of one time the first is kept."""

_Orientation = Literal["body", "head"]
_Channels = dict[str, Any] | None
"""Some channels of a product; None: it is none of the model's likelihoods."""


def seconds_apart(first: float, second: float) -> float:
    """Return the seconds from one time to another, 0 for times that count as one."""
    apart = second - first
    return 0.0 if abs(apart) < SAME_TIME else apart


def news(known: Sequence[Observation], new: Observation) -> Observation | None:
    """Return an observation without what is known already of its time; None if nothing is left.

    A sensor with a name measures a thing once at a time: what an observation of it with exactly that time has
    is a duplicate. Without a name, a measurement is one if it has the same value and noise.
    """
    left: dict[str, Any] = {}
    again = [one for one in known if one.t == new.t and one.sensor == new.sensor]
    for names in _MEASURED:
        value = [getattr(new, name) for name in names]
        measured = [[getattr(one, name) for name in names] for one in again]
        of_sensor = new.sensor and any(one[0] is not None for one in measured)
        if value[0] is None or of_sensor or value in measured:
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
) -> Observation | None:
    """Return one observation with the product of the likelihoods of some, at the time of the first.

    Positions and velocities have the mean weighted by their information; von Mises densities have the sum of
    κ·e^{iθ}, of axes that of κ·e^{2iθ}; class likelihoods are multiplied. Losses and outlier shares apply to
    the product. None: it is none of the model's likelihoods.
    """
    if len(parts) == 1:
        return parts[0]
    changed: dict[str, Any] = {"inputs": {}}
    changed["score"] = next((one.score for one in parts if one.score is not None), None)
    for one in parts:
        for name, value in one.inputs.items():
            if not _agree(name, changed["inputs"].setdefault(name, value), value):
                return None
    for found in (
        _position(parts, likelihood, camera),
        _velocity(parts, likelihood),
        _axis(parts, likelihood),
        _orientation(parts, "body", likelihood),
        _orientation(parts, "head", likelihood),
    ):
        if found is None:
            return None
        changed |= found
    return replace(parts[0], **changed)


def _position(
    parts: Sequence[Observation], likelihood: LikelihoodParameters, camera: GroundCamera | None
) -> _Channels:
    pixels = [one.pixel for one in parts if one.pixel is not None]
    placed = [one for one in parts if one.position is not None]
    if likelihood.image_frame and camera is not None and pixels:
        if sum(one.pixel is not None or one.position is not None for one in parts) > 1:
            return None
        return {name: getattr(placed[0], name) for name in _MEASURED[0]} | {"pixel": pixels[0]}
    pixel = {"pixel": pixels[0] if len(pixels) == 1 else None}
    if len(placed) < 2:
        given = placed[0] if placed else parts[0]
        return {name: getattr(given, name) for name in _MEASURED[0]} | pixel
    std = np.array([likelihood.position_stds(one.position_std, 1).item() for one in placed])
    declared = [one.position_covariance for one in placed]
    covariance = likelihood.position_scale**2 * np.array(
        [np.eye(2) if one is None else one for one in declared]
    )
    round_ = np.array([one is None for one in declared])
    covariance[round_] = std[round_, None, None] ** 2 * np.eye(2)
    values = np.array([one.position for one in placed])
    mean, spread, furthest = _product(values, covariance)
    if likelihood.robust != "none" and furthest > likelihood.robust_threshold:
        return None
    spread = spread / likelihood.position_scale**2
    noise: dict[str, Any]
    if round_.all():
        noise = {"position_std": math.sqrt(spread[0, 0]), "position_covariance": None}
    else:
        noise = {"position_std": None, "position_covariance": _as_tuples(spread)}
    return {"position": tuple(mean.tolist()), **noise, **pixel}


def _product(values: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return mean (2,) and covariance (2, 2) of the product of Gaussian densities, m of them.

    And the largest distance of a value from that mean, in its standard deviations
    """
    information = np.linalg.inv(covariance)
    spread = np.linalg.inv(information.sum(axis=0))
    # From the first value: coordinates may be large.
    away = values - values[0]
    mean = spread @ np.einsum("mij,mj->i", information, away)
    left = away - mean
    furthest = math.sqrt(np.einsum("mi,mij,mj->m", left, information, left).max())
    return values[0] + mean, spread, furthest


def _as_tuples(covariance: FloatArray) -> tuple[tuple[float, float], ...]:
    return tuple(tuple(row) for row in (0.5 * (covariance + covariance.T)).tolist())


def _velocity(parts: Sequence[Observation], likelihood: LikelihoodParameters) -> _Channels:
    given = [one for one in parts if one.observed_velocity is not None]
    if len(given) < 2:
        return {name: getattr((given or parts)[0], name) for name in _MEASURED[2]}
    round_ = likelihood.velocity_std**2 * np.eye(2)
    declared = [one.observed_velocity_covariance for one in given]
    covariance = np.array([round_ if one is None else one for one in declared])
    mean, spread, _ = _product(np.array([one.observed_velocity for one in given]), covariance)
    return {
        "observed_velocity": tuple(mean.tolist()),
        "observed_velocity_covariance": _as_tuples(spread),
    }


def _axis(parts: Sequence[Observation], likelihood: LikelihoodParameters) -> _Channels:
    given = [one for one in parts if one.body_axis is not None]
    if len(given) < 2:
        return {name: getattr((given or parts)[0], name) for name in _MEASURED[4]}
    angles = np.array([one.body_axis for one in given])
    kappas = [likelihood.kappas("body", one.body_axis_kappa, 1).item() for one in given]
    angle, kappa, _ = _resultant(2.0 * angles, np.array(kappas))
    declared = min(kappa * likelihood.body_scale**2, LARGEST_CONCENTRATION)
    return {"body_axis": 0.5 * angle, "body_axis_kappa": declared}


def _resultant(angles: FloatArray, kappas: FloatArray) -> tuple[float, float, float]:
    """Return mean and concentration of the product of von Mises densities.

    And the largest distance of an angle from that mean, in its standard deviations
    """
    east, north = float(kappas @ np.cos(angles)), float(kappas @ np.sin(angles))
    mean = math.atan2(north, east)
    furthest = float(np.sqrt(2.0 * kappas * (1.0 - np.cos(angles - mean))).max())
    return mean, math.hypot(east, north), furthest


def _orientation(
    parts: Sequence[Observation], name: _Orientation, likelihood: LikelihoodParameters
) -> _Channels:
    """Return the channels of body or head; an angle in a row with class likelihoods is not read."""
    kappa_of, classes_of = f"{name}_kappa", f"{name}_likelihood"
    classes = [one for one in parts if getattr(one, classes_of) is not None]
    angles = [one for one in parts if getattr(one, name) is not None and one not in classes]
    if angles and classes:
        return None
    if len(classes) > 1:
        product = np.ones(len(getattr(classes[0], classes_of)))
        for one in classes:
            heights = np.array(getattr(one, classes_of))
            # Zeros throughout are uninformative.
            product *= heights / heights.max() if heights.any() else 1.0
        if not product.any():
            return None
        return {classes_of: tuple((product / product.sum()).tolist()), name: None, kappa_of: None}
    if len(angles) > 1:
        kappas = [likelihood.kappas(name, getattr(one, kappa_of), 1).item() for one in angles]
        given = np.array([getattr(one, name) for one in angles])
        angle, kappa, furthest = _resultant(given, np.array(kappas))
        if likelihood.outliers(name) > 0.0 and furthest > likelihood.robust_threshold:
            return None
        declared = kappa * getattr(likelihood, f"{name}_scale") ** 2
        return {name: angle, kappa_of: min(declared, LARGEST_CONCENTRATION)}
    only = next(iter(classes or angles), parts[0])
    return {channel: getattr(only, channel) for channel in (name, kappa_of, classes_of)}


def merged_rows(
    track: Track, likelihood: LikelihoodParameters, camera: GroundCamera | None
) -> tuple[Track, NDArray[np.int64]] | None:
    """Return a track with one frame for the rows of one time, and the frame of each row (n,); None: as it is.

    Rows count as one time with the first row that they are less than `SAME_TIME` after; those whose product
    is none of the model's likelihoods are frames `APART` later.
    """
    t = track.t
    if not (np.diff(t) < SAME_TIME).any():
        return None
    given = {name: value for name in CHANNELS if (value := getattr(track, name)) is not None}
    frames: list[tuple[float, list[int], Observation | None]] = []  # time, rows, product of several
    for row, time in enumerate(t.tolist()):
        if frames and time - frames[-1][0] < SAME_TIME:
            since, rows, _ = frames[-1]
            parts = [
                observation_at(k, float(t[k]), int(track.frame[k]), given, track.inputs) for k in (*rows, row)
            ]
            product = merged(parts, likelihood, camera)
            if product is not None:
                frames[-1] = (since, [*rows, row], product)
                continue
            time = since + APART
        frames.append((time, [row], None))
    starts = np.array([rows[0] for _, rows, _ in frames])
    channels: dict[str, FloatArray] = {name: value[starts] for name, value in given.items()}
    inputs = {name: value[starts] for name, value in track.inputs.items()}
    for k, (_, _, product) in enumerate(frames):
        if product is None:
            continue
        for name in CHANNELS:
            value = getattr(product, name)
            if value is not None and name not in channels:  # a noise that no row declares
                channels[name] = np.full((len(starts), *SHAPES[name]), np.nan)
            if name in channels:
                channels[name][k] = np.nan if value is None else value
        for name, values in inputs.items():
            values[k] = product.inputs.get(name, np.nan)
    changed: dict[str, Any] = {**channels, "inputs": inputs, "t": np.array([time for time, _, _ in frames])}
    frame = np.repeat(np.arange(len(frames)), [len(rows) for _, rows, _ in frames])
    number = track.frame[starts] if track.sensor is None else np.arange(len(frames))
    return replace(track[starts], sensor=None, frame=number, **changed), frame


def with_merged_rows(
    tracks: TrackSet, likelihood: LikelihoodParameters
) -> tuple[TrackSet, dict[int, NDArray[np.int64]]]:
    """Return tracks with one frame for the rows of one time, and track id → frames as `merged_rows`."""
    found: list[Track] = []
    frames: dict[int, NDArray[np.int64]] = {}
    for track in tracks:
        one = merged_rows(track, likelihood, tracks.camera)
        if one is not None:
            track, frames[track.track_id] = one
        found.append(track)
    return tracks.with_tracks(found), frames


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
