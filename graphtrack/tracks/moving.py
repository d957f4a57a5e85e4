"""Rows in the frame of a moving sensor (x forward, y left), turned into the world by its poses.

True positions and angles are those of the world already, and estimates are left as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from graphtrack.geometry.angles import FloatArray, rotated_classes, wrap
from graphtrack.geometry.poses import PosePath
from graphtrack.tracks.display import listed
from graphtrack.tracks.given import position_noise
from graphtrack.tracks.schema import LARGEST_CORRELATION
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import LARGEST_CONCENTRATION

UNDECLARED = (0.1, 0.3)
"""1-σ of positions (m) and velocities (m/s) that declare none: the defaults of `LikelihoodParameters`."""

NO_POSE = "at a time without a pose of the sensor"
EVERY = ""
"""Name of the path of all sensors that have none of their own."""

_ANGLES = ("body", "head", "body_axis")
_CLASSES = ("body_likelihood", "head_likelihood")
_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Turn by 90°: the derivative of a turned vector by the angle."""


def channels_in_world(
    channels: Mapping[str, FloatArray],
    t: FloatArray,
    path: PosePath,
    undeclared: tuple[float, float] = UNDECLARED,
    repeats: FloatArray | None = None,
) -> dict[str, FloatArray]:
    """Return channels of rows in a sensor's frame as they are in the world.

    Positions become R·p + T, with the covariance R·C·Rᵀ + J·Σ·Jᵀ of first order, Σ that of the pose. C is the
    declared noise. Where none is declared and the poses have an uncertainty, it is the default, so that the
    pose's part is not lost; of exact poses it stays undeclared, and can be learned. Angles turn by yaw, and
    declared concentrations become 1/(1/κ + σ²); class likelihoods turn by circular interpolation. Observed
    velocities are rates of change in the sensor's frame: the sensor's velocity and the part of its turning
    are added. A velocity without a position is NaN, since that part is unknown.

    Parameters
    ----------
    channels : `Track` attribute → (n, ...)
    t : (n,) seconds, covered by the path
    path : poses of the sensor
    undeclared : 1-σ of positions (m) and velocities (m/s) without a declared noise
    repeats : (n,) as in `PosePath.at`, of rows that are smoothed
    """
    found = dict(channels)
    pose, spread = path.at(t, repeats)
    yaw = pose[:, 2]
    turn = np.stack([np.cos(yaw), -np.sin(yaw), np.sin(yaw), np.cos(yaw)], axis=1).reshape(-1, 2, 2)
    arm = covariance = None
    if "position" in channels:
        arm = _applied(turn, channels["position"])
        found["position"] = arm + pose[:, :2]
        own = _declared(channels, len(t), None if path.is_exact else undeclared[0])
        covariance = turn @ own @ _transposed(turn)
        added = _propagated(arm, spread)
        if added.any() or "position_covariance" in channels:
            found["position_covariance"] = definite(covariance + added)
            found.pop("position_std", None)
    for name in _ANGLES:
        if name in channels:
            found[name] = wrap(channels[name] + yaw)
            if (kappa := channels.get(f"{name}_kappa")) is not None:
                found[f"{name}_kappa"] = _blurred(kappa, spread[:, 2, 2])
    for name in _CLASSES:
        if name in channels:
            found[name] = rotated_classes(channels[name], yaw)
    if "observed_velocity" in channels:
        if arm is None or covariance is None:
            arm, covariance = np.full((len(t), 2), np.nan), np.full((len(t), 2, 2), np.nan)
        rates, rate_spread = path.rates(t)
        relative = _applied(turn, channels["observed_velocity"])
        turning = rates[:, 2:] * (arm @ _QUARTER.T)
        found["observed_velocity"] = relative + turning + rates[:, :2]
        own = _of_velocity(channels, len(t), None if path.is_exact else undeclared[1])
        own = turn @ own @ _transposed(turn)
        carried = rates[:, 2, None, None] ** 2 * (_QUARTER @ np.nan_to_num(covariance) @ _QUARTER.T)
        sideways = (relative + turning) @ _QUARTER.T
        of_yaw = spread[:, 2, 2, None, None] * sideways[:, :, None] * sideways[:, None, :]
        total = own + carried + of_yaw + _propagated(arm, rate_spread)
        found["observed_velocity_covariance"] = definite(total)
    return found


def rows_in_world(rows: Rows, paths: Mapping[str, PosePath]) -> Rows:
    """Return rows with those of moving sensors turned into the world.

    Rows at times without a pose are left out and counted. Rows of sensors without a path stay as they are;
    notes report what was done.

    Parameters
    ----------
    rows : with times and positions
    paths : name of a sensor, or `EVERY`, → its poses, in the time of the rows
    """
    names = np.full(len(rows), "") if rows.sensor is None else rows.sensor
    place = {name: paths.get(name) or paths.get(EVERY) for name in np.unique(names).tolist()}
    t = rows.channels["t"]
    known = np.ones(len(rows), dtype=bool)
    for name, path in place.items():
        if path is not None:
            known[names == name] = path.covers(t[names == name])
    rows, names, t_known = rows.keep(known, NO_POSE), names[known], t[known]
    moving = [name for name, path in place.items() if path is not None]
    moves = np.isin(names, moving)
    channels = dict(rows.channels)
    noise = position_noise(channels.get("position_std"), channels.get("covariance"))
    if noise is not None:
        channels["position_std"] = noise
    undeclared = 0
    for name in moving:
        own = np.flatnonzero(names == name)
        path = place[name]
        assert path is not None
        given = {key: values[own] for key, values in channels.items()}
        of_path = np.isin(names, [one for one in moving if place[one] is path])
        repeats = nearby(np.unique(t_known[of_path]), given["t"], path.correlation_time)
        if not path.is_exact and "position" in given:
            there = np.isfinite(given["position"]).all(axis=1)
            undeclared += int((there & np.isnan(_declared(given, len(own), None)[:, 0, 0])).sum())
        for key, values in channels_in_world(given, given["t"], path, repeats=repeats).items():
            if key not in channels:
                channels[key] = np.full((len(rows), *values.shape[1:]), np.nan)
            elif channels[key] is rows.channels.get(key):
                channels[key] = channels[key].copy()
            channels[key][own] = values
        if "position_covariance" in channels and "position_std" in channels:
            known_now = np.isfinite(channels["position_covariance"]).all(axis=(1, 2))
            channels["position_std"] = np.where(known_now, np.nan, channels["position_std"])
    notes = [f"rows{_of(moving)} were turned into the world by the sensor's poses"] if moves.any() else []
    static = [name for name in place if name not in moving]
    if moves.any() and static:
        notes.append(f"rows{_of(static)} have no poses and are taken as in the world")
    if undeclared:
        notes.append(
            f"{undeclared} rows declare no noise of positions: {UNDECLARED[0]:g} m and the uncertainty of "
            "the pose were taken (a column pos_std declares it, --trust learn corrects it)"
        )
    if "pixel" in channels and moves.any():
        channels["pixel"] = np.where(moves[:, None], np.nan, channels["pixel"])
        notes.append("pixels of moving sensors are not used further")
    camera = None if moves.all() else rows.camera
    return replace(rows, channels=channels, camera=camera).with_notes(*notes)


def nearby(times: FloatArray, t: FloatArray, window: float) -> FloatArray:
    """Return the number of ascending times within a window about each of some times (n,), 1 at least."""
    half = 0.5 * window
    first = np.searchsorted(times, t - half, side="right")
    return np.maximum(np.searchsorted(times, t + half, side="left") - first, 1).astype(float)


def _of(names: list[str]) -> str:
    if names == [EVERY]:
        return ""
    return f" of {listed(repr(name) if name else 'no sensor' for name in names)}"


def _applied(turn: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.einsum("nij,nj->ni", turn, vectors)


def _transposed(turn: FloatArray) -> FloatArray:
    return turn.transpose(0, 2, 1)


def _propagated(arm: FloatArray, spread: FloatArray) -> FloatArray:
    """Return J·Σ·Jᵀ (n, 2, 2) of covariances (n, 3, 3) by J = (1, the quarter turn of ``arm`` (n, 2))."""
    jacobian = np.concatenate(
        [np.broadcast_to(np.eye(2), (len(arm), 2, 2)), (arm @ _QUARTER.T)[:, :, None]], axis=2
    )
    with np.errstate(invalid="ignore"):
        return np.asarray(jacobian @ spread @ _transposed(jacobian))


def _declared(channels: Mapping[str, FloatArray], n: int, default: float | None) -> FloatArray:
    """Return declared covariances (n, 2, 2) of positions; others that of the default, or NaN without one."""
    std = np.full(n, np.nan) if channels.get("position_std") is None else channels["position_std"]
    if default is not None:
        std = np.where(np.isnan(std), default, std)
    own = std[:, None, None] ** 2 * np.eye(2)
    return _filled(channels.get("position_covariance"), own)


def _of_velocity(channels: Mapping[str, FloatArray], n: int, default: float | None) -> FloatArray:
    own = np.full((n, 2, 2), np.nan) if default is None else np.tile(default**2 * np.eye(2), (n, 1, 1))
    return _filled(channels.get("observed_velocity_covariance"), own)


def _filled(given: FloatArray | None, other: FloatArray) -> FloatArray:
    return other if given is None else np.where(np.isnan(given), other, given)


def definite(covariance: FloatArray) -> FloatArray:
    """Return symmetric covariances (n, 2, 2) whose correlation is small enough for an inverse."""
    found = 0.5 * (covariance + _transposed(covariance))
    largest = (1.0 - 2.0 * (1.0 - LARGEST_CORRELATION)) * np.sqrt(found[:, 0, 0] * found[:, 1, 1])
    found[:, 0, 1] = found[:, 1, 0] = np.clip(found[:, 0, 1], -largest, largest)
    found[np.isnan(found).any(axis=(1, 2))] = np.nan
    return found


def _blurred(kappa: FloatArray, variance: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore"):
        return np.minimum(1.0 / (1.0 / kappa + variance), LARGEST_CONCENTRATION)
