"""Simulated sensors: what each of several described sensors observes of the same people."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray, unit, wrap
from graphtrack.io.formats.native import open_table
from graphtrack.io.read_write import tracks_given
from graphtrack.io.sensors import SensorScene
from graphtrack.simulation.degrade import motion
from graphtrack.simulation.detector import FALSE, as_truth, interpolated
from graphtrack.tracks.cells import labels, numbers
from graphtrack.tracks.display import counted
from graphtrack.tracks.schema import COLUMNS, TRUE_ID, in_order
from graphtrack.tracks.sensors import Sensor, Sensors, SimulatedSensor, distorted, into_frame, sees
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import TrackSet, cells_of

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given

IntArray = NDArray[np.int64]

Identities = Literal["true", "own", "none"]
"""Identities in the rows: those of the people; of each sensor's own tracker; or none."""

_MOST_SCANS = 10_000_000


@dataclass(frozen=True, eq=False)
class SimulatedRows:
    """Rows of simulated sensors.

    Attributes
    ----------
    columns : of the native table, in the order of their times, and ``true_id``; ``true_x`` to
        ``true_head_deg`` are true, in the world
    poses : observed poses of moving sensors, ``t, x, y, yaw_deg``, their 1-σ and ``sensor``; None: none moves
    truth : the people, at their own times
    """

    columns: dict[str, NDArray[Any]]
    poses: dict[str, NDArray[Any]] | None
    truth: TrackSet

    def described(self) -> str:
        """Return the numbers of people, sensors, and detections in words."""
        n, false = len(self.columns["t"]), int(np.isnan(self.columns[TRUE_ID]).sum())
        observing = len(np.unique(self.columns["sensor"]))
        return (
            f"{counted(len(self.truth), 'person')}, {counted(observing, 'sensor')}, "
            f"{counted(n, 'detection')}, {false} of them false"
        ).replace("persons", "people")


def square(
    rng: np.random.Generator | None = None,
    *,
    position_std: float = 0.15,
    shift: float = 0.2,
    rotation: float = math.radians(1.0),
    angle_bias: float = math.radians(1.0),
    clock_offset: float = 0.1,
) -> SensorScene:
    """Return four cameras that look from its corners at a square of 20 by 20 m about the origin.

    The first has no errors. The errors of each of the others have these magnitudes, and random directions and
    signs. 15 % of the people in view are missed, and there are 0.001 false detections a scan and m².

    Parameters
    ----------
    rng : generator of the directions and signs; None: always the same
    position_std : 1-σ of each axis, m
    shift, rotation, angle_bias, clock_offset : m, rad, rad and s
    """
    rng = np.random.default_rng(0) if rng is None else rng
    found = {}
    for k, name in enumerate(("south-west", "south-east", "north-east", "north-west")):
        heading = math.radians(45.0) + 0.5 * math.pi * k
        corner = np.round(-15.0 * unit(heading), 3)
        way, signs = rng.uniform(-np.pi, np.pi), rng.choice([-1.0, 1.0], 3)
        # 0.0 is added to a product of 0 for its sign.
        moved, signs = (k > 0) * shift * unit(way) + 0.0, (k > 0) * signs + 0.0
        found[name] = Sensor(
            position_std=position_std,
            shift=(float(moved[0]), float(moved[1])),
            rotation=float(signs[0] * rotation),
            angle_bias=float(signs[1] * angle_bias),
            clock_offset=float(signs[2] * clock_offset),
            detection_probability=0.85,
            false_density=1e-3,
            range=25.0,
            sector=(-math.radians(40.0), math.radians(40.0)),
            at=(float(corner[0]), float(corner[1])),
            heading=math.radians(45.0 + 90.0 * (k if k < 2 else k - 4)),
            simulation=SimulatedSensor(hz=10.0, phase=k / 40, body_kappa=4.0, head_kappa=4.0),
        )
    return SensorScene(found)


def observe(
    people: Given,
    sensors: Sensors,
    *,
    identities: Identities = "true",
    folder: str | Path = ".",
    rng: np.random.Generator,
) -> SimulatedRows:
    """Simulate what described sensors observe of people with known truth.

    Each sensor scans at its own rate. It misses people outside of its field of view, people hidden by others
    and some of the rest; positions and angles have noise, then the sensor's errors. Rows of a sensor that
    moves are in its own frame. Between two frames of a person the motion is linear.

    Parameters
    ----------
    people : what is known, in any form that `graphtrack.solve` takes
    sensors : with ``position_std``, or ``ray_std`` and ``across_std`` of `SimulatedSensor`
    identities : "true": the people's; "own": of each sensor's own tracker, none of which another sensor has;
        "none": no identities
    folder : of relative paths of moving sensors

    Raises
    ------
    InputError
        For a sensor whose noise, way or field of view is not known well enough, or if nothing is detected.
    """
    if identities not in get_args(Identities):
        raise InputError(f"identities = {identities!r}", f"one of {', '.join(get_args(Identities))}")
    exact = tracks_given(people)
    if not len(exact):
        raise InputError("no tracks", "at least one")
    ids = np.array([track.track_id for track in exact])
    first = int(ids.max()) + 1 if identities == "true" else 1
    parts: list[dict[str, NDArray[Any]]] = []
    poses: list[dict[str, NDArray[Any]]] = []
    for (name, sensor), own in zip(sensors.items(), rng.spawn(len(sensors)), strict=True):
        try:
            one = _Simulation(exact, name, sensor, Path(folder))
            found = one.detections(own)
            found["track_id"] = one.identities(found, ids, identities, first, own)
            if sensor.moves:
                poses.append(one.poses(own))
        except InputError as error:
            raise InputError(f"[sensors.{name}] {error.found}", error.expected, path=error.path) from error
        first = max(first, int(found["track_id"].max(initial=first - 1)) + 1)
        found[TRUE_ID] = np.where(found["person"] < 0, np.nan, ids[found.pop("person")])
        # Rows of a scan are in no order.
        order = own.permutation(len(found["t"]))
        parts.append({column: values[order] for column, values in found.items()})
    columns = _joined(parts)
    if not len(columns["t"]):
        raise InputError("no detections", "people in view of at least one sensor")
    if identities == "true":
        false = np.isnan(columns[TRUE_ID])
        names = {track.track_id: track.label for track in exact}
        given = [names.get(k, FALSE) for k in columns["track_id"].tolist()]
        columns |= {"label": np.array(given, object)} if any(names.values()) or false.any() else {}
    if identities == "none":
        del columns["track_id"]
    order = np.argsort(columns["t"], kind="stable")
    ordered = {name: columns[name][order] for name in (*in_order(columns), TRUE_ID)}
    return SimulatedRows(ordered, _joined(poses) if poses else None, exact.map(as_truth))


def _joined(parts: Sequence[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Return tables below each other; numbers of a column that one of them lacks are NaN."""
    names = dict.fromkeys(name for part in parts for name in part)
    return {
        name: np.concatenate([part.get(name, np.full(len(part["t"]), np.nan)) for part in parts])
        for name in names
    }


class _Simulation:
    """One sensor, and the truth at the times of its scans, in its frame.

    Attributes
    ----------
    t : (k,) true times of the scans
    pose : (k, 3) of a sensor that moves
    world : (k, m, 2) positions of the people in the world, NaN where a person is not there
    own : (k, m, 2) the same in the sensor's frame
    angles : name → (k, m) body and head in the world
    """

    def __init__(self, people: TrackSet, name: str, sensor: Sensor, folder: Path) -> None:
        self.name, self.sensor = name, sensor
        self.simulation = sensor.simulation or SimulatedSensor()
        simulation = self.simulation
        if sensor.position_std is None and simulation.ray_std is None:
            raise InputError("no noise of positions", "position_std, or ray_std and across_std")
        if simulation.ray_std is not None and sensor.eye is None:
            raise InputError("ray_std without at", "at = [x, y], where the ray begins")
        begin = min(float(track.t[0]) for track in people)
        end = max(float(track.t[-1]) for track in people)
        self.begin, self.end = begin, end
        self.t = self._grid(begin + simulation.phase, simulation.hz)
        self.way = _way_of(name, simulation, folder) if sensor.moves else None
        self.pose: FloatArray | None = None
        if self.way is not None:
            pose = self.way(self.t)
            known = np.isfinite(pose).all(axis=1)
            self.t, self.pose = self.t[known], pose[known]
        if not len(self.t):
            raise InputError("no scan", f"one between {begin:g} and {end:g} s, where its way is known")
        shape = len(self.t), len(people)
        self.world = np.full((*shape, 2), np.nan)
        self.angles = {one: np.full(shape, np.nan) for one in ("body", "head")}
        slack = 1e-6 / simulation.hz
        for place, track in enumerate(people):
            self.world[:, place] = interpolated(track.t, motion(track), self.t, slack, angle=False)
            for one, values in self.angles.items():
                truth = getattr(track, f"true_{one}")
                truth = getattr(track, one) if truth is None else truth
                if truth is not None:
                    values[:, place] = interpolated(track.t, truth, self.t, slack, angle=True)
        self.own = self.world if self.pose is None else into_frame(self.world, self.pose[:, None])

    def _grid(self, begin: float, hz: float) -> FloatArray:
        count = (self.end - begin) * hz
        if count > _MOST_SCANS:
            raise InputError(f"{count:.3g} scans", f"{_MOST_SCANS} at most")
        return begin + np.arange(max(0, int(np.floor(count + 1e-6)) + 1)) / hz

    def visible(self) -> BoolArray:
        """Return a mask (k, m) of the people who are in view and not hidden by others."""
        found = sees(self.sensor, self.own.reshape(-1, 2)).reshape(self.own.shape[:2])
        radius = self.simulation.occlusion_radius
        if self.sensor.eye is None or radius == 0.0:
            return found
        for scan, away in enumerate(self.own - np.array(self.sensor.eye)):
            there = np.flatnonzero(np.isfinite(away).all(axis=1))
            found[scan, there] &= ~hidden(away[there], radius)
        return found

    def detections(self, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
        """Return the columns of its rows, and ``person``, the place of each among the people; −1: false."""
        sensor, simulation = self.sensor, self.simulation
        probability = 1.0 if sensor.detection_probability is None else sensor.detection_probability
        detected = self.visible() & (rng.random(self.own.shape[:2]) < probability)
        scan, person = np.nonzero(detected)
        true = self.own[scan, person]
        false_scan, false = self._false_detections(rng)
        position = np.concatenate([true + self._noise(true, rng), false])
        n, n_false = len(position), len(false)
        scan = np.concatenate([scan, false_scan])
        channels: dict[str, FloatArray] = {"t": self.t[scan], "position": position}
        if simulation.declares:
            # Ellipses about the true ray: a sensor's own estimate of its direction has a smaller error.
            channels |= self._declared(np.concatenate([true, false]))
        unknown = np.full((n_false, 2), np.nan)
        channels["true_position"] = np.concatenate([self.world[scan[: n - n_false], person], unknown])
        for name, kappa in (("body", simulation.body_kappa), ("head", simulation.head_kappa)):
            angle = np.concatenate([self.angles[name][scan[: n - n_false], person], unknown[:, 0]])
            channels[f"true_{name}"] = angle
            if kappa is None or np.isnan(self.angles[name]).all():
                continue
            yaw = 0.0 if self.pose is None else self.pose[scan, 2]
            noisy = angle - yaw + rng.vonmises(0.0, kappa, n)
            noisy[n - n_false :] = rng.uniform(-np.pi, np.pi, n_false)
            channels[name] = wrap(noisy)
            if simulation.declares:
                channels[f"{name}_kappa"] = np.full(n, kappa)
        place = Path(self.name)
        rows = Rows(place, "simulated", np.zeros(n, np.int64), scan, channels, lambda row: row + 1)
        bent = distorted(rows, {"": sensor}).channels
        columns: dict[str, NDArray[Any]] = {
            column.name: cells_of(bent[column.field], column) for column in COLUMNS if column.field in bent
        }
        columns = {name: values for name, values in columns.items() if not (n and np.isnan(values).all())}
        columns |= {"frame": scan, "sensor": np.full(n, self.name, dtype=object)}
        return columns | {"person": np.concatenate([person, np.full(n_false, -1)])}

    def _axes(self, points: FloatArray) -> FloatArray:
        """Return matrices (n, 2, 2) whose columns are the unit vectors along and across each ray."""
        away = points - np.array(self.sensor.eye)
        length = np.hypot(away[:, 0], away[:, 1])
        along = np.divide(
            away, length[:, None], out=np.tile([1.0, 0.0], (len(away), 1)), where=length[:, None] > 0.0
        )
        return np.stack([along, np.column_stack([-along[:, 1], along[:, 0]])], axis=-1)

    def _noise(self, points: FloatArray, rng: np.random.Generator) -> FloatArray:
        white = rng.standard_normal(points.shape)
        if self.simulation.ray_std is None:
            assert self.sensor.position_std is not None
            return self.sensor.position_std * white
        std = np.array([self.simulation.ray_std, self.simulation.across_std])
        return np.asarray(np.einsum("nij,nj->ni", self._axes(points), std * white))

    def _declared(self, points: FloatArray) -> dict[str, FloatArray]:
        """Return the noise that rows declare before `distorted`, which divides it by ``position_scale``."""
        if self.simulation.ray_std is None:
            assert self.sensor.position_std is not None
            return {"position_std": np.full(len(points), self.sensor.position_std)}
        axes, std = self._axes(points), np.array([self.simulation.ray_std, self.simulation.across_std])
        return {"position_covariance": np.einsum("nij,j,nkj->nik", axes, std**2, axes)}

    def _false_detections(self, rng: np.random.Generator) -> tuple[IntArray, FloatArray]:
        """Return scans (n,) and positions (n, 2) of false detections, a Poisson process in the view."""
        density = self.sensor.false_density
        if not density:
            return np.empty(0, np.int64), np.empty((0, 2))
        low, high = self._window()
        count = rng.poisson(density * float(np.prod(high - low)), len(self.t))
        points = rng.uniform(low, high, (int(count.sum()), 2))
        kept = sees(self.sensor, points)
        return np.repeat(np.arange(len(self.t)), count)[kept], points[kept]

    def _window(self) -> tuple[FloatArray, FloatArray]:
        """Return the corners (2,) and (2,) of a rectangle around the field of view."""
        sensor = self.sensor
        if sensor.field_of_view is not None:
            ring = np.array(sensor.field_of_view)
            return ring.min(axis=0), ring.max(axis=0)
        if sensor.range is not None:
            eye = np.array(sensor.eye)
            return eye - sensor.range, eye + sensor.range
        if sensor.sector is not None or sensor.moves:
            raise InputError("false_density without an area", "a field of view, or a range")
        places = self.world[np.isfinite(self.world).all(axis=2)]
        if not len(places):
            raise InputError("no position", "a position of at least one person")
        return places.min(axis=0), places.max(axis=0)

    def identities(
        self,
        found: dict[str, NDArray[Any]],
        ids: IntArray,
        kind: Identities,
        first: int,
        rng: np.random.Generator,
    ) -> IntArray:
        """Return the identity of each row; new ones count from ``first``."""
        person = found["person"]
        numbered = np.where(person < 0, -1, ids[person])
        if kind == "own":
            numbered = self._own_identities(found["frame"], person, first, rng)
            first = max(first, int(numbered.max(initial=first - 1)) + 1)
        false = person < 0
        numbered[false] = first + np.arange(false.sum())
        return numbered

    def _own_identities(
        self, scan: IntArray, person: IntArray, first: int, rng: np.random.Generator
    ) -> IntArray:
        """Return the identities of people by the sensor's own tracker, −1 for false detections.

        They are new after ``lost_after`` seconds without a detection, and may be swapped when people meet.
        """
        simulation, m = self.simulation, self.own.shape[1]
        identity, detected = np.full(m, -1), np.full(m, -np.inf)
        near = np.zeros((m, m), bool)
        found = np.full(len(scan), -1)
        order = np.argsort(scan, kind="stable")
        bounds = np.searchsorted(scan[order], np.arange(len(self.t) + 1))
        for k, t in enumerate(self.t):
            rows = order[bounds[k] : bounds[k + 1]]
            rows = rows[person[rows] >= 0]
            here = person[rows]
            new = here[(identity[here] < 0) | (t - detected[here] > simulation.lost_after)]
            identity[new] = first + np.arange(len(new))
            first, detected[here] = first + len(new), t
            if simulation.switch_probability:
                apart = np.linalg.norm(self.own[k, :, None] - self.own[k], axis=2)
                met = np.triu((apart < simulation.meeting_distance) & ~near, 1)
                near = apart < simulation.meeting_distance
                for i, j in np.argwhere(met).tolist():
                    if i in here and j in here and rng.random() < simulation.switch_probability:
                        identity[[i, j]] = identity[[j, i]]
            found[rows] = identity[here]
        return found

    def poses(self, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
        """Return the columns of observed poses of a sensor that moves, from the first time to the last."""
        assert self.way is not None
        simulation = self.simulation
        t = self._grid(self.begin, simulation.pose_hz or simulation.hz)
        t = np.append(t, self.end) if t[-1] < self.end else t
        pose = self.way(t)
        known = np.isfinite(pose).all(axis=1)
        t, pose = t[known], pose[known]
        std = np.array([simulation.pose_std, simulation.pose_std, simulation.pose_yaw_std])
        noisy = pose + std * rng.standard_normal(pose.shape)
        columns: dict[str, NDArray[Any]] = {"t": t, "x": noisy[:, 0], "y": noisy[:, 1]}
        columns["yaw_deg"] = np.rad2deg(wrap(noisy[:, 2]))
        names = ("x_std", "y_std", "yaw_std_deg")
        for name, value in zip(names, (*std[:2], np.rad2deg(std[2])), strict=True):
            if value > 0.0:
                columns[name] = np.full(len(t), value)
        return columns | {"sensor": np.full(len(t), self.name, dtype=object)}


def hidden(away: FloatArray, radius: float) -> BoolArray:
    """Return a mask (m,) of people behind others, as seen from the origin.

    Parameters
    ----------
    away : (m, 2) metres, positions of the people
    radius : m, a person is hidden by a nearer one whom the ray to the hidden person passes so close
    """
    far = np.hypot(away[:, 0], away[:, 1])
    ray = away / np.maximum(far, 1e-12)[:, None]
    along = away @ ray.T  # of person i on the ray to j
    aside = np.abs(away[:, :1] * ray[:, 1] - away[:, 1:] * ray[:, 0])
    hides = (aside < radius) & (along > 0.0) & (along < far) & (far[:, None] < far)
    return np.asarray(hides.any(axis=0))


Way = Callable[[FloatArray], FloatArray]
"""Function from times (k,) to the poses (k, 3) of a frame in the world: x, y, yaw; NaN where unknown."""


def _way_of(name: str, simulation: SimulatedSensor, folder: Path) -> Way:
    if simulation.way == "circle":
        return lambda t: _on_circle(simulation, t)
    if simulation.path is None:
        raise InputError("a sensor that moves without a way", 'way = "circle", or path = a file')
    return _read_way(folder / simulation.path, name)


def _on_circle(simulation: SimulatedSensor, t: FloatArray) -> FloatArray:
    """Return poses (k, 3) on a circle, which begins below its centre and looks ahead."""
    yaw = simulation.turn_rate * t
    side = -1.0 if simulation.turn_rate < 0.0 else 1.0
    place = np.array(simulation.centre) + side * simulation.radius * unit(yaw - 0.5 * np.pi)
    return np.column_stack([place, wrap(yaw)])


_COLUMNS = ("t", "x", "y", "yaw_deg")


def _read_way(path: Path, name: str) -> Way:
    """Read the way of a sensor from a CSV file; it is linear between two rows."""
    cells = open_table(path, _COLUMNS)
    values = [numbers(cells, one) for one in _COLUMNS]
    for one, column in zip(_COLUMNS, values, strict=True):
        cells.refuse(np.isnan(column), one, "a number")
    t, x, y, yaw = values
    here = np.flatnonzero(labels(cells, "sensor") == name) if "sensor" in cells.columns else np.arange(len(t))
    if not len(here):
        raise InputError(f"no row of the sensor {name!r}", "its poses", path=path)
    back = np.zeros(len(t), bool)
    back[here[1:]] = np.diff(t[here]) <= 0.0
    cells.refuse(back, "t", "a time after that of the row before")
    columns = [x[here], y[here], np.unwrap(np.deg2rad(yaw[here]))]

    def way(at: FloatArray) -> FloatArray:
        found = [np.interp(at, t[here], column, left=np.nan, right=np.nan) for column in columns]
        return np.column_stack(found)

    return way
