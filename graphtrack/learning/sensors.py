"""Errors of sensors, learned from the people that they observe: shifts, rotations, biases and clock offsets.

They are variables that the factors of all people share. The compiled engine solves the people for given
errors; the gradient of their cost with respect to the errors is that of the observations' factors alone
(envelope theorem), and Newton's method in the errors with it reaches the optimum of the joint graph, which
`graphs.graph_of` makes for GTSAM. The inverse of the curvature is the errors' covariance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.associate import rows_of, with_identities, with_repaired_identities
from graphtrack.constants.filters import REHEARSAL
from graphtrack.constants.personal import parameters_of, solve_learned
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, rotated
from graphtrack.inference.engines import Solution, engine_of, make_solver_ready
from graphtrack.inference.offline import solve_each
from graphtrack.io.options import FileReading
from graphtrack.io.sensors import SensorScene, SensorsLike
from graphtrack.learning.alignment import aligned, joined, ways_of
from graphtrack.learning.sensor_rates import identities_of, noise_scales, with_rates
from graphtrack.model import Model
from graphtrack.model.given import covariances_of, observed_direction, velocity_covariances_of
from graphtrack.model.observation import OWN
from graphtrack.model.terms.position import robust_weights
from graphtrack.tracks.given import with_position_noise
from graphtrack.tracks.scene import GivenScene
from graphtrack.tracks.sensor_errors import (
    BIAS,
    CLOCK,
    ERRORS,
    PRIOR_STD,
    ROTATION,
    X,
    Y,
    errors_of,
    with_errors,
)
from graphtrack.tracks.sensors import Sensor, Sensors, corrected
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import TrackSet

if TYPE_CHECKING:
    from graphtrack.association.associate import Detected

MOST_ROWS = 20_000
"""Rows that errors are learned from: of the people whom most sensors observe."""

_ROUNDS = 12
"""Times that rows are corrected, people smoothed, and errors learned, at most."""

_ROW = "input_row"
"""Channel with the number of a row before it was selected."""

_ASSOCIATIONS = 2
"""Times that people are joined across sensors."""

_SETTLED = 0.02
"""Change of an error over its 1-σ at which it is learned."""

_NEWTON_STEPS = 3
"""Steps with one curvature, before rows are corrected again."""

_STEPS = (1e-3, 1e-3, 1e-4, 1e-3, 1e-3)
"""Differences of the errors by which curvatures are computed, in the units of `ERRORS`."""


Identities = Literal["shared", "own", "none"]
"""Identities of rows of several sensors: of people, of each sensor's own tracker, or none."""


def learn_sensors(
    detections: Detected | Rows,
    known: SensorsLike | None = None,
    model: Model | str | Path | None = None,
    *,
    identities: Identities | None = None,
    scene: GivenScene = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    **reading: Unpack[FileReading],
) -> SensorScene:
    """Learn the errors of sensors with their standard deviations, from the people whom they observe.

    Their detection probabilities, densities of false detections and scales of declared noise are learned too.
    Errors are relative to the first sensor that is described, else to that of the first row: its own are what
    they are known to be, or 0.

    Parameters
    ----------
    detections : rows of several sensors on the ground, as in `associate`, and not corrected
    known : descriptions, or their file; what they have is not learned
    model : as in `solve`; by default "joint"
    identities : "shared", of people; "own", of the tracker of each sensor; "none". By default "shared" where
        rows have identities
    scene : known parameters of the scene, where identities are not shared
    progress : called with rounds done and at most
    **reading : options of `read`, where ``detections`` is a path or a table

    Returns
    -------
    SensorScene
        The descriptions, with what was learned

    Raises
    ------
    InputError
        For rows of fewer than two sensors, or if no two sensors observe one person.
    """
    rows = detections if isinstance(detections, Rows) else rows_of(detections, **reading)
    if rows.sensor is None or len(names := list(dict.fromkeys(rows.sensor.tolist()))) < 2:
        raise InputError("rows of one sensor", "a column sensor with the names of several", path=rows.path)
    described = dict({} if known is None else SensorScene.of(known))
    names = [name for name in described if name in names] + [n for n in names if n not in described]
    learning = _Learning(rows, names, described, Model.named(model))
    given = identities or ("shared" if rows.has_identity else "none")
    if given == "shared":
        learning.run(rows, progress)
        return SensorScene(described | with_rates(rows, identities_of(rows), learning.found()))
    own = rows.track_id if given == "own" else own_identities(rows, scene)
    here = np.flatnonzero(own >= 0)
    alone = replace(rows, track_id=own, has_identity=True, labels={}).taken(here)
    learning.align(alone)
    identity = own
    for _ in range(_ASSOCIATIONS):
        found = learning.found()
        joined_rows = with_repaired_identities(corrected(_with_index(alone), found), scene, found)
        index = joined_rows.channels[_ROW].astype(int)
        learning.run(replace(alone.taken(index), track_id=joined_rows.track_id, labels={}), progress)
        identity = np.full(len(rows), -1)
        identity[here[index]] = joined_rows.track_id
    return SensorScene(described | with_rates(rows, identity, learning.found()))


def own_identities(rows: Rows, scene: GivenScene = None) -> NDArray[np.int64]:
    """Return the identity (n,) of each row among the people of its own sensor; −1: a false detection."""
    assert rows.sensor is not None
    found, index = np.full(len(rows), -1), _with_index(rows)
    for name in dict.fromkeys(rows.sensor.tolist()):
        here = np.flatnonzero(rows.sensor == name)
        alone = with_identities(replace(index.taken(here), sensor=None), scene)
        found[alone.channels[_ROW].astype(int)] = alone.track_id
    found[found >= 0] += 1
    return found


def _with_index(rows: Rows) -> Rows:
    return rows.with_channels(**{_ROW: np.arange(len(rows), dtype=float)})


def _chosen(rows: Rows) -> Rows:
    """Return the rows of the people whom several sensors observe, up to `MOST_ROWS`."""
    assert rows.sensor is not None
    people, person = np.unique(rows.track_id, return_inverse=True)
    pairs = np.unique(np.column_stack([person, np.unique(rows.sensor, return_inverse=True)[1]]), axis=0)
    several = np.bincount(pairs[:, 0], minlength=len(people))
    if several.max(initial=0) < 2:
        raise InputError(
            "no person whom two sensors observe",
            "identities that sensors share (--associate always, or repair)",
            path=rows.path,
        )
    lengths = np.bincount(person, minlength=len(people))
    order = np.lexsort((lengths, -several))
    order = order[several[order] > 1]
    fits = np.cumsum(lengths[order]) <= max(MOST_ROWS, lengths[order[0]])
    return rows.taken(np.flatnonzero(np.isin(person, order[fits])))


@dataclass(frozen=True, eq=False)
class _People:
    """The people for some errors, whose constants are fixed."""

    model: Model
    personal: dict[str, FloatArray]


class _Learning:
    """The errors so far.

    Attributes
    ----------
    errors, std : (s, 5) in the units of `ERRORS`; 1-σ is 0 of those that are not learned
    """

    def __init__(self, rows: Rows, names: list[str], known: Sensors, model: Model) -> None:
        self._names, self._model = names, model
        sensor = self._numbers(rows)
        self._sensors: dict[str, Sensor] = {}
        has_angles = any(name in rows.channels for name in ("body", "head", "body_axis"))
        self._free = np.zeros((len(names), len(ERRORS)), bool)
        for k, name in enumerate(names):
            given = known.get(name, Sensor())
            is_known = np.isfinite(errors_of(given))
            self._free[k] = ~is_known & (k > 0)
            middle = rows.channels["position"][sensor == k]
            if not is_known[:3].any():
                given = replace(given, pivot=tuple(np.nanmean(middle, axis=0).tolist()))
            self._sensors[name] = with_errors(given, np.nan_to_num(errors_of(given)))
        self._free[:, BIAS] &= has_angles
        self.errors = np.array([errors_of(self._sensors[name]) for name in names])
        self.std = np.zeros(self.errors.shape)
        self._unscaled = {name for name, one in self._sensors.items() if one.position_scale is None}

    def found(self) -> dict[str, Sensor]:
        """Return the descriptions with the errors, and their 1-σ where they were learned."""
        found = {}
        for k, name in enumerate(self._names):
            std = np.where(self._free[k], self.std[k], np.nan)
            found[name] = with_errors(self._sensors[name], self.errors[k], std)
        return found

    def _numbers(self, rows: Rows) -> NDArray[np.int64]:
        """Return the number (n,) of each row's sensor."""
        assert rows.sensor is not None
        return np.array([self._names.index(name) for name in rows.sensor.tolist()])

    def align(self, rows: Rows) -> None:
        """Guess the errors from rows whose sensors have identities of their own; sensor after sensor."""
        sensor = self._numbers(rows)
        ways = [ways_of(rows.taken(np.flatnonzero(sensor == k))) for k in range(len(self._names))]
        pivots = [np.array(one.pivot) for one in self._sensors.values()]
        done = [0]
        while len(done) < len(ways):
            reference = joined([ways[k].moved(self.errors[k], pivots[k]) for k in done])
            free = self._free.copy()
            free[:, BIAS] = False
            left = [k for k in range(len(ways)) if k not in done]
            tried = [aligned(ways[k], reference, self.errors[k], free[k], pivots[k]) for k in left]
            best = int(np.argmax([agreeing for _, agreeing in tried]))
            self.errors[left[best]] = tried[best][0]
            done.append(left[best])

    def run(self, rows: Rows, progress: Callable[[int, int], None]) -> None:
        """Learn the errors from rows with the people's identities."""
        self._rows = _chosen(rows)
        self._sensor = self._numbers(self._rows)
        for done in range(_ROUNDS):
            progress(done, _ROUNDS)
            if self.step():
                break
        progress(_ROUNDS, _ROUNDS)
        self._learn_noise()

    def _learn_noise(self) -> None:
        """Learn the scales of declared noise that are unknown, and the errors once more with them."""
        tracks, found = self._smoothed(corrected(self._rows, self._described()))
        pairs = [
            (track, one.track) for track, one in zip(tracks, found, strict=True) if isinstance(one, Solution)
        ]
        scales = noise_scales(*zip(*pairs, strict=True)) if pairs else {}
        unscaled = self._unscaled & scales.keys()
        for name in unscaled:
            one = self._sensors[name]
            self._sensors[name] = replace(one, position_scale=scales[name] * (one.position_scale or 1.0))
        if unscaled:
            self.step()

    def step(self) -> bool:
        """Correct the rows, smooth the people, and learn the errors again; return whether they settled."""
        described = self._described()
        # Clocks move rows among those of other sensors.
        assert self._rows.sensor is not None
        times = corrected(self._rows, described).channels["t"]
        order = np.lexsort((self._rows.sensor, times, self._rows.track_id))
        raw = self._rows.taken(order)
        people = self._people_of(corrected(raw, described))
        problem = _Problem(raw, self._sensor[order], people, described)
        free = np.flatnonzero(self._free)
        weight = np.tile(PRIOR_STD, (len(self._names), 1)) ** -2.0

        def gradient(change: FloatArray) -> FloatArray:
            of_rows = problem.gradient(self._described(change), change)
            return np.asarray((of_rows + weight * (self.errors + change)).ravel()[free])

        change = np.zeros(self.errors.shape)
        base = gradient(change)
        curvature = np.zeros((len(free), len(free)))
        for k, place in enumerate(free.tolist()):
            moved = change.copy()
            moved.flat[place] = _STEPS[place % len(ERRORS)]
            curvature[k] = (gradient(moved) - base) / _STEPS[place % len(ERRORS)]
        scale = np.array(PRIOR_STD)[free % len(ERRORS)]
        values, axes = np.linalg.eigh(0.5 * (curvature + curvature.T) * np.outer(scale, scale))
        # What observations do not determine has the curvature of the prior.
        inverse = (axes / np.maximum(values, 1.0)) @ axes.T * np.outer(scale, scale)
        for _ in range(_NEWTON_STEPS):
            change.flat[free] -= inverse @ base
            base = gradient(change)
        self.errors = self.errors + change
        self.std.flat[free] = np.sqrt(np.diag(inverse))
        return bool((np.abs(change.flat[free]) < _SETTLED * self.std.flat[free]).all())

    def _described(self, change: FloatArray | None = None) -> dict[str, Sensor]:
        """Return the descriptions with the errors; those of ``change`` (s, 5) are added, but for clocks."""
        errors = self.errors.copy()
        if change is not None:
            errors[:, :CLOCK] += change[:, :CLOCK]
        return {name: with_errors(self._sensors[name], errors[k]) for k, name in enumerate(self._names)}

    def _smoothed(self, rows: Rows) -> tuple[TrackSet, list[Any]]:
        """Return tracks, and their solutions with constants that are learned from them."""
        tracks = TrackSet.from_rows(rows).map(with_position_noise)
        engine = engine_of(self._model, "auto")
        make_solver_ready(self._model, engine, None, REHEARSAL)

        def solve(some: TrackSet, model: Model, own: Any, done: Any) -> list[Any]:
            return solve_each(some, model, engine, personal=own)

        return tracks, solve_learned(tracks, self._model, solve)[0]

    def _people_of(self, rows: Rows) -> _People:
        """Return the model with the noise, and the people's constants, as learned from corrected rows."""
        _, found = self._smoothed(rows)
        solved = [one for one in found if isinstance(one, Solution) and one.constants is not None]
        if not solved:
            raise InputError("no person who can be smoothed", "rows with positions", path=rows.path)
        usual = solved[0].constants
        own = [
            parameters_of(constants, self._model)
            for one in found
            if (constants := (one.constants if isinstance(one, Solution) else usual)) is not None
        ]
        noise = {name: value for name, value in own[0].items() if name.startswith("likelihood.")}
        model = self._model.with_parameters(self._model.parameters.with_values(noise))
        return _People(model, {name: np.array([one[name] for one in own]) for name in OWN})


class _Problem:
    """The cost of the people as a function of changes of the errors.

    Clocks are linear in the change: rows keep their times, and their positions move with the velocities of
    the people at no change.

    Parameters
    ----------
    rows : as they were read, in the order that they have once corrected
    sensor : (n,) number of the sensor
    people : for the errors at no change
    sensors : descriptions with these errors
    """

    def __init__(self, rows: Rows, sensor: NDArray[np.int64], people: _People, sensors: Sensors) -> None:
        self._rows, self._sensor, self.people = rows, sensor, people
        states, _ = self._solved(corrected(rows, sensors))
        self._velocity = np.nan_to_num(states[:, 2:4])

    def _solved(self, rows: Rows) -> tuple[FloatArray, TrackSet]:
        """Return the states (n, 6) of the people in each row, NaN where unknown, and their tracks."""
        tracks = TrackSet.from_rows(rows).map(with_position_noise)
        model = self.people.model
        found = solve_each(tracks, model, engine_of(model, "auto"), personal=self.people.personal)
        parts = []
        for one, track in zip(found, tracks, strict=True):
            states = np.full((len(track), 6), np.nan)
            if isinstance(one, Solution):
                states[:, :2], states[:, 2:4] = one.track.position, one.track.velocity
                for place, name in enumerate(("body", "head"), 4):
                    angle = getattr(one.track, name)
                    states[:, place] = np.nan if angle is None else angle
            parts.append(states)
        return np.concatenate(parts), tracks

    def gradient(self, sensors: Sensors, change: FloatArray) -> FloatArray:
        """Return the gradient (s, 5) of the cost at changed errors.

        Parameters
        ----------
        sensors : descriptions with the changed errors, but with the clocks before
        change : (s, 5)
        """
        rows, sensor = corrected(self._rows, sensors), self._sensor
        shift = self._velocity * change[sensor, CLOCK, None]
        rows = rows.with_channels(position=rows.channels["position"] + shift)
        states, tracks = self._solved(rows)
        described = list(sensors.values())
        pivot = np.array([one.pivot for one in described])[sensor]
        rotation = np.array([one.rotation for one in described], float)[sensor]
        found = np.zeros((len(rows), len(ERRORS)))
        force = _force(rows.channels["position"] - states[:, :2], tracks, self.people.model)
        place = states[:, :2] - shift - pivot
        found[:, [X, Y]] = -rotated(force, rotation)
        found[:, ROTATION] = force[:, 0] * place[:, 1] - force[:, 1] * place[:, 0]
        found[:, CLOCK] = (self._velocity * force).sum(axis=1)
        found[:, BIAS] = _torque(states[:, 4:], tracks, self.people.model)
        found[:, ROTATION] += found[:, BIAS] + _torque_of_velocity(states[:, 2:4], tracks, self.people.model)
        total = np.zeros((len(sensors), len(ERRORS)))
        np.add.at(total, sensor, np.nan_to_num(found))
        return total


def _force(error: FloatArray, tracks: TrackSet, model: Model) -> FloatArray:
    """Return the derivatives (n, 2) of the costs of positions with respect to the observed ones."""
    likelihood = model.parameters.likelihood
    covariance = np.concatenate([covariances_of(track, likelihood) for track in tracks])
    force = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    distance = np.sqrt(np.maximum((force * error).sum(axis=1), 0.0))
    return force * robust_weights(distance, likelihood)[:, None]


def _torque(angles: FloatArray, tracks: TrackSet, model: Model) -> FloatArray:
    """Return the derivatives (n,) of the costs of observed angles with respect to a bias of them."""
    total = np.zeros(len(angles))
    for column, name in enumerate(("body", "head")):
        both = [observed_direction(track, name, model.parameters) for track in tracks]
        angle, kappa = (np.concatenate(part) for part in zip(*both, strict=True))
        total -= np.nan_to_num(kappa * np.sin(angle - angles[:, column]))
    axis = _channel(tracks, "body_axis", ())
    declared = _channel(tracks, "body_axis_kappa", ())
    kappa = model.parameters.likelihood.kappas("body", declared, len(axis))
    return total - np.nan_to_num(0.5 * kappa * np.sin(2.0 * (axis - angles[:, 0])))


def _torque_of_velocity(velocity: FloatArray, tracks: TrackSet, model: Model) -> FloatArray:
    """Return the derivatives (n,) of the costs of observed velocities with respect to a rotation."""
    observed = _channel(tracks, "observed_velocity", (2,))
    likelihood = model.parameters.likelihood
    covariance = np.concatenate([velocity_covariances_of(track, likelihood) for track in tracks])
    force = np.linalg.solve(covariance, (observed - velocity)[:, :, None])[:, :, 0]
    return np.nan_to_num(force[:, 0] * velocity[:, 1] - force[:, 1] * velocity[:, 0])


def _channel(tracks: TrackSet, name: str, shape: tuple[int, ...]) -> FloatArray:
    """Return a channel of all tracks end to end, NaN where it is missing."""
    parts = [
        np.full((len(track), *shape), np.nan) if (value := getattr(track, name)) is None else value
        for track in tracks
    ]
    return np.concatenate(parts).copy()
