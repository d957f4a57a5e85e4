"""Metrics of forecasts: errors, density and coverage, against constant velocity and the Kalman filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.kalman import filter_states
from graphtrack.constant_velocity import axis_of, predict_spread, white_noise_acceleration
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.parameters import Parameters
from graphtrack.packages import spatial
from graphtrack.tracks.gaps import positions_at
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet

SAMPLES = 20
"""Number of sampled paths for best-of-K errors."""

MISS = 2.0
"""Error in metres at the last time ahead above which a forecast is a miss (Argoverse; Chang et al. 2019)."""

COLLISION = 0.2
"""Distance in metres between two people below which they collide (TrajNet++; Kothari et al. 2021)."""

LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Nominal probabilities of the circles of the reliability curve."""


@dataclass(frozen=True)
class MethodScore:
    """Metrics of one method's forecasts; NaN: not predicted.

    Attributes
    ----------
    ade, fde : mean error over all times ahead, and at the last, m
    min_ade, min_fde : errors of the best of `SAMPLES` paths of each forecast, m
    miss_rate : share of forecasts with an error above `MISS` at the last time ahead; of the best of
        `SAMPLES` paths if there are samples
    collision_rate : share of forecasts, among those for two people or more, whose mean path comes within
        `COLLISION` of another person's at the same time
    log_likelihood : mean over forecasts and times, nats: the logarithm of a density per m²
    inside_50, inside_90 : shares of true positions in the circles of 50 and 90 % nominal probability
    """

    ade: float
    fde: float
    min_ade: float = float("nan")
    min_fde: float = float("nan")
    miss_rate: float = float("nan")
    collision_rate: float = float("nan")
    log_likelihood: float = float("nan")
    inside_50: float = float("nan")
    inside_90: float = float("nan")


@dataclass(frozen=True)
class ForecastScore:
    """Scores of the forecasts of one recording.

    Attributes
    ----------
    forecasts : number of scored forecasts
    left_out : number of forecasts without truth at all times ahead and one step before
    methods : "forecast", "constant velocity", "Kalman filter"; if the truth has true in addition to observed
        positions, "constant velocity, true last step" too
    by_ahead : a row for each time ahead
    reliability : nominal coverage → observed coverage
    drawn : True if the best-of-`SAMPLES` paths were drawn from the table's Gaussian, as it has no samples
    """

    forecasts: int
    left_out: int
    methods: Mapping[str, MethodScore]
    by_ahead: tuple[Mapping[str, float], ...]
    reliability: Mapping[float, float]
    drawn: bool

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def judge_forecasts(table: Mapping[str, FloatArray], truth: TrackSet) -> ForecastScore:
    """Score a table of forecasts.

    Constant velocity extrapolates the last step before the forecast, whose length is the table's first time
    ahead. It and the Kalman filter, with default parameters, use the positions of the forecast: the observed
    positions of the truth table, if it also has true positions. The true last step is scored separately.

    Parameters
    ----------
    table : columns (rows,) as `graphtrack.forecasting.recorded.read_forecasts` gives them
    truth : table whose true positions, or else positions, are the truth

    Raises
    ------
    InputError
        If forecasts differ in their times ahead, or none can be scored.
    """
    order = np.lexsort((table["ahead"], table["track_id"], table["t"]))
    ahead = np.unique(table["ahead"])
    shape = (len(order) // len(ahead), len(ahead))
    grid = {name: values[order] for name, values in table.items()}
    if len(order) % len(ahead) or (grid["ahead"].reshape(shape) != ahead).any():
        raise InputError("forecasts for differing times ahead", "the same times in all forecasts")
    grid = {name: values.reshape(shape) for name, values in grid.items()}
    people, made = grid["track_id"][:, 0].astype(int), grid["t"][:, 0]
    true, straight, informed, filtered = _references(truth, people, made, ahead)
    known = np.asarray(np.isfinite(np.stack([true, straight, informed])).all(axis=(0, 2, 3)))
    if not known.any():
        raise InputError(
            f"{len(known)} forecasts, none with known outcome", "truth of the same people and times"
        )
    grid = {name: values[known] for name, values in grid.items()}
    true, straight, informed, filtered = true[known], straight[known], informed[known], filtered[known]
    mean = np.stack([grid["x"], grid["y"]], axis=2)
    off = true - mean
    error = np.linalg.norm(off, axis=2)
    spread = np.empty((*error.shape, 2, 2))
    spread[..., 0, 0], spread[..., 1, 1] = grid["x_std"] ** 2, grid["y_std"] ** 2
    spread[..., 0, 1] = spread[..., 1, 0] = grid["xy_cov"]
    if (np.linalg.det(spread) <= 0.0).any():
        raise InputError("a covariance that is not positive definite", "valid x_std, y_std and xy_cov")
    paths, drawn = _paths(grid, mean, spread)
    best = np.linalg.norm(paths - true[:, None], axis=3)
    inside = {f"inside_{share}": error <= grid[f"radius_{share}"] for share in (50, 90)}
    made = grid["t"][:, 0]
    own = MethodScore(
        *_errors(error),
        min_ade=float(best.mean(axis=2).min(axis=1).mean()),
        min_fde=float(best[:, :, -1].min(axis=1).mean()),
        miss_rate=float((best[:, :, -1].min(axis=1) > MISS).mean()),
        collision_rate=_collision_rate(mean, made),
        log_likelihood=_log_likelihood(off, spread),
        **{name: float(held.mean()) for name, held in inside.items()},
    )
    other = np.linalg.norm(straight - true, axis=2)
    off_filter, variance = true - filtered[..., :2], filtered[..., 2]
    of_filter = np.linalg.norm(off_filter, axis=2)
    kalman = MethodScore(
        *_errors(of_filter),
        miss_rate=float((of_filter[:, -1] > MISS).mean()),
        collision_rate=_collision_rate(filtered[..., :2], made),
        log_likelihood=_log_likelihood(off_filter, variance[..., None, None] * np.eye(2)),
        **{
            f"inside_{share}": float((of_filter**2 <= -2.0 * np.log1p(-share / 100.0) * variance).mean())
            for share in (50, 90)
        },
    )
    columns = {"error": error, "constant velocity": other, **inside}
    rows = tuple(
        {"ahead": seconds, **{name: float(values[:, k].mean()) for name, values in columns.items()}}
        for k, seconds in enumerate(ahead.tolist())
    )
    methods = {
        "forecast": own,
        "constant velocity": MethodScore(
            *_errors(other),
            miss_rate=float((other[:, -1] > MISS).mean()),
            collision_rate=_collision_rate(straight, made),
        ),
        "Kalman filter": kalman,
    }
    if any(track.has_truth for track in truth):
        errors = _errors(np.linalg.norm(informed - true, axis=2))
        methods["constant velocity, true last step"] = MethodScore(*errors)
    shares = _shares_within(error, grid["radius_50"], grid["radius_90"])
    curve = {level: float((shares <= level).mean()) for level in LEVELS}
    return ForecastScore(int(known.sum()), int((~known).sum()), methods, rows, curve, drawn)


def _errors(error: FloatArray) -> tuple[float, float]:
    return float(error.mean()), float(error[:, -1].mean())


def _collision_rate(path: FloatArray, made: FloatArray) -> float:
    """Return the share of paths (n, A, 2) from times (n,) that collide with another path, or NaN."""
    collides: list[NDArray[np.bool_]] = []
    for rows in np.split(np.argsort(made, kind="stable"), np.unique(np.sort(made), return_index=True)[1][1:]):
        if len(rows) > 1:
            near = np.zeros(len(rows), dtype=bool)
            for points in path[rows].swapaxes(0, 1):
                near[spatial.cKDTree(points).query_pairs(COLLISION, output_type="ndarray").ravel()] = True
            collides.append(near)
    return float(np.concatenate(collides).mean()) if collides else float("nan")


def _shares_within(error: FloatArray, inner: FloatArray, outer: FloatArray) -> FloatArray:
    """Return the probability within each error of the Weibull distribution through the two radii.

    A power of 2 is a Gaussian's; smaller powers have heavier tails.
    """
    power = np.log(np.log(10.0) / np.log(2.0)) / np.log(np.maximum(outer / inner, 1.0 + 1e-9))
    shares: FloatArray = -np.expm1(-np.log(2.0) * (error / inner) ** power)
    return shares


def _log_likelihood(off: FloatArray, spread: FloatArray) -> float:
    distance = np.einsum("nai,nai->na", off, np.linalg.solve(spread, off[..., None])[..., 0])
    return float((-0.5 * distance - 0.5 * np.log(np.linalg.det(spread)) - np.log(2.0 * np.pi)).mean())


def _paths(grid: Mapping[str, FloatArray], mean: FloatArray, spread: FloatArray) -> tuple[FloatArray, bool]:
    """Return `SAMPLES` paths (n, S, A, 2) of each forecast, and True if they were drawn."""
    if all(f"sample_{k}_{axis}" in grid for k in range(SAMPLES) for axis in "xy"):
        axes = [np.stack([grid[f"sample_{k}_{axis}"] for k in range(SAMPLES)], axis=1) for axis in "xy"]
        return np.stack(axes, axis=3), False
    random = np.random.default_rng(0)
    # Errors along a path are correlated: one draw for the whole path.
    draws = random.standard_normal((len(mean), SAMPLES, 2))
    found: FloatArray = mean[:, None] + np.einsum("naij,nsj->nsai", np.linalg.cholesky(spread), draws)
    return found, True


def _references(
    truth: TrackSet, people: NDArray[np.int64], made: FloatArray, ahead: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return true positions (n, A, 2), and predictions of the filter (n, A, 3).

    Between the two are constant-velocity positions, from the last observed and the last true step.
    """
    shape = (len(people), len(ahead))
    true, straight, informed = (np.full((*shape, 2), np.nan) for _ in range(3))
    filtered = np.full((*shape, 3), np.nan)
    tracks = {track.track_id: track for track in truth}
    parameters = Parameters()
    density = parameters.motion.acceleration_density
    for one in np.unique(people).tolist():
        rows = np.flatnonzero(people == one)
        track = tracks.get(one)
        if track is None:
            continue
        position = track.true_position if track.has_truth else track.position
        assert position is not None
        has_position = np.isfinite(track.position).all(axis=1)
        if has_position.sum() < 2:
            continue
        true[rows] = positions_at(track.t, position, made[rows, None] + ahead)
        informed[rows] = _straight_on(track.t, position, made[rows], ahead)
        t, position = track.t[has_position], track.position[has_position]
        straight[rows] = _straight_on(t, position, made[rows], ahead)
        alone = Track(one, np.flatnonzero(has_position), t, position)
        states, _ = filter_states(alone, parameters)
        last = np.clip(np.searchsorted(t, made[rows] + TIME_TOLERANCE) - 1, 0, len(t) - 1)
        mean, spread = states.mean[last], states.covariance[last]
        since = (made[rows] - t[last])[:, None] + ahead
        filtered[rows, :, :2] = mean[:, None, :2] + since[..., None] * mean[:, None, 2:]
        step = white_noise_acceleration(since, density)
        filtered[rows, :, 2] = predict_spread(axis_of(spread)[:, None], step)["pp"]
    return true, straight, informed, filtered


def _straight_on(t: FloatArray, position: FloatArray, made: FloatArray, ahead: FloatArray) -> FloatArray:
    """Extrapolate positions (n, A, 2) with the velocity of the last step."""
    now, before = positions_at(t, position, made), positions_at(t, position, made - ahead[0])
    velocity = (now - before) / ahead[0]
    return np.asarray(now[:, None] + velocity[:, None] * ahead[:, None])
