"""Rows of several sensors, and figures of the people, identities and errors of sensors found in them."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import graphtrack as gt
from graphtrack.evaluation.identities import judge, threshold_of
from graphtrack.evaluation.matching import known_detections
from graphtrack.evaluation.state_score import score_states
from graphtrack.geometry.angles import rotated
from graphtrack.simulation.crowd import crossing
from graphtrack.simulation.sensors import SimulatedRows, observe
from graphtrack.tracks.sensor_errors import errors_of
from graphtrack.tracks.sensors import Sensors, SimulatedSensor
from graphtrack.tracks.track import Track, TrackSet

NO_ERRORS = gt.Sensor(shift=(0.0, 0.0), rotation=0.0, angle_bias=0.0, clock_offset=0.0)
"""A sensor known to have no errors."""


def table_of(simulated: SimulatedRows) -> pd.DataFrame:
    """Return the rows, with the true identity (−1 of false detections) and the row's number as inputs."""
    rows = pd.DataFrame(simulated.columns)
    true = pd.to_numeric(rows.pop("true_id"), errors="coerce").fillna(-1.0)
    return rows.assign(input_true_id=true, input_row=np.arange(len(rows), dtype=float))


def identified(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of people, with their identities."""
    people = rows[rows.input_true_id >= 0]
    return people.assign(track_id=people.input_true_id.astype(int) + 1).reset_index(drop=True)


def anonymous(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows without identities."""
    return rows.drop(columns=["track_id", "label"], errors="ignore")


def error_of(tracks: Iterable[Track]) -> float:
    """Return the root mean square distance of estimates to the truth in the rows that have one, m."""
    squares = [np.sum((one.position - one.true_position) ** 2, axis=1) for one in tracks]
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))


def error_of_people(tracks: gt.TrackSet, people: gt.TrackSet) -> float:
    """Return the root mean square error of people's positions at the times of the truth, m.

    People are matched with estimates within 1 m at each time, as by ``graphtrack score``: a row that is
    associated with another person counts in IDF1.
    """
    (position,) = (row for row in score_states(tracks, people).rows if row["quantity"] == "position")
    return float(position["rmse"])


def coverage_of(tracks: Iterable[Track]) -> float:
    """Return the share of rows whose true position lies in the 95 % region of the estimate."""
    squares = []
    for one in tracks:
        known = np.isfinite(one.position).all(axis=1) & np.isfinite(one.true_position).all(axis=1)
        error, spread = (one.position - one.true_position)[known], one.covariance[known, :2, :2]
        squares.append(np.einsum("ni,ni->n", error, np.linalg.solve(spread, error[:, :, None])[:, :, 0]))
    return float(np.mean(np.concatenate(squares) < -2.0 * math.log(0.05)))


def idf1_of(found: Iterable[Track], rows: pd.DataFrame) -> float:
    """Return IDF1 of the identities of ``rows``, each of which is a frame of its own.

    ``found``: tracks of these rows, with their input ``row``
    """
    ids, places = [], []
    for one in found:
        place = np.asarray(one.inputs["row"]).reshape(len(one))
        ids.append(np.full(int(np.isfinite(place).sum()), one.track_id))
        places.append(place[np.isfinite(place)].astype(int))
    true = rows[rows.input_true_id >= 0]
    identity, frame = np.concatenate(ids), np.concatenate(places)
    estimates = known_detections(identity, frame, np.zeros((len(frame), 2)))
    truth = known_detections(
        true.input_true_id.to_numpy(int), true.input_row.to_numpy(int), np.zeros((len(true), 2))
    )
    return float(judge([("", estimates, truth)], threshold_of()).together.idf1)


def misses(found: Sensors, true: Sensors) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (s, 5) of learned errors, and their 1-σ, without those of the first sensor."""
    errors, stds = [], []
    for name, sensor in list(true.items())[1:]:
        one: Any = found[name]
        # A rotation about another pivot is one with another shift.
        turn = float(sensor.rotation or 0.0)
        matrix = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        away = np.array(one.pivot) - sensor.pivot
        shift = matrix @ away + np.array(sensor.shift) - away
        errors.append(errors_of(one) - np.array([*shift, *errors_of(sensor)[2:]]))
        stds.append([*one.shift_std, one.rotation_std, one.angle_bias_std or math.nan, one.clock_offset_std])
    return np.array(errors), np.array(stds)


# -- two views that do not overlap ---------------------------------------------------------------------------


def hand_over(seed: int, *, people: int, a_minute: float, gap: float) -> pd.DataFrame:
    """Return rows of people who walk between two views of 8 by 6 m, the second with other colours."""
    rng = np.random.default_rng(seed)
    length, tracks = 16.0 + gap, []
    for k, begin in enumerate(np.cumsum(rng.exponential(60.0 / a_minute, people)).tolist()):
        speed, y, way = rng.uniform(1.0, 1.6), rng.uniform(-2.0, 2.0), rng.choice([-1.0, 1.0])
        frame = np.arange(math.ceil(10.0 * begin), math.floor(10.0 * (begin + length / speed)))
        # The velocity deviates as in `simulation.crowd`: 0.15 m/s for 1.5 s.
        kept = math.exp(-0.1 / 1.5)
        shocks = 0.15 * math.sqrt(1.0 - kept**2) * rng.standard_normal((len(frame), 2))
        walk = np.cumsum(0.1 * lfilter([1.0], [1.0, -kept], shocks, axis=0), axis=0)
        walk[:, 0] += speed * (frame / 10.0 - begin) - 0.5 * length
        tracks.append(Track(k, frame, frame / 10.0, walk * [way, 1.0] + [0.0, y]))
    simulated = SimulatedSensor(hz=8.0)
    near, far = 0.5 * gap, 0.5 * gap + 8.0
    view = ((-far, -3.0), (-near, -3.0), (-near, 3.0), (-far, 3.0))
    first = gt.Sensor(position_std=0.1, detection_probability=0.9, field_of_view=view, simulation=simulated)
    second = replace(first, field_of_view=tuple((-x, y) for x, y in view))
    rows = table_of(observe(TrackSet(tuple(tracks)), {"first": first, "second": second}, rng=rng))
    looks = rng.normal(size=(people, 6))[rows.input_true_id.astype(int)]
    looks = looks + 0.4 * rng.normal(size=looks.shape)
    changed = np.exp(0.3 * rng.normal(size=6)) * looks + rng.normal(size=6)
    looks = np.where((rows.sensor == "second").to_numpy()[:, None], changed, looks)
    return rows.assign(**{f"appearance_{k}": looks[:, k] for k in range(6)})


def kept(found: TrackSet) -> float:
    """Return the share of the people in both views who have one identity there."""
    table = found.to_table().dropna(subset=["x", "input_true_id"])
    most = table.groupby(["input_true_id", "sensor"]).track_id.agg(lambda ids: ids.mode()[0])
    both = most.unstack().dropna()
    return float((both["first"] == both["second"]).mean())


# -- recordings that are split -------------------------------------------------------------------------------


def hermes(data_dir: Path, seconds: float) -> pd.DataFrame:
    """Return people in a corridor, at 8 Hz."""
    table = pd.read_csv(data_dir / "hermes" / "truth.csv.gz")
    return table[(table.t >= 20.0) & (table.t < 20.0 + seconds)]


def town_centre(data_dir: Path, seconds: float) -> pd.DataFrame:
    """Return people in a street, at 5 Hz, for 60 s at most: later frames are for acceptance."""
    folder = data_dir / "towncentre"
    tracks = gt.read(folder / "boxes.csv", calibration=folder / "calibration.ci", fps=25)
    table = tracks.to_table()[["track_id", "frame", "t", "x", "y"]]
    return table[(table.t < min(seconds, 60.0)) & (table.frame % 5 == 0)]


@dataclass(frozen=True, eq=False)
class Split:
    """A recording of one sensor, and the same of two, the second of which has errors.

    Attributes
    ----------
    rows : of two sensors, whose views overlap by 2 m
    single : of one sensor
    scene : the errors of both
    """

    rows: pd.DataFrame
    single: pd.DataFrame
    scene: gt.SensorScene

    @classmethod
    def of(cls, table: pd.DataFrame, rng: np.random.Generator, std: float = 0.1) -> "Split":
        """Split a table of true positions at its middle; each row has noise."""
        place = table[["x", "y"]].to_numpy()
        axis = int(np.argmax(np.ptp(place, axis=0)))
        away = place[:, axis] - np.median(place[:, axis])
        middle = tuple(np.median(place, axis=0).tolist())
        turn = math.radians(2.0)
        second = gt.Sensor(shift=(0.18, -0.24), rotation=turn, pivot=middle, clock_offset=0.2)
        scene = gt.SensorScene({"first": NO_ERRORS, "second": second})

        def observed(part: pd.DataFrame) -> pd.DataFrame:
            noisy = part[["x", "y"]].to_numpy() + std * rng.standard_normal((len(part), 2))
            # From 1: 0 and −1 are no identities.
            return part.assign(x=noisy[:, 0], y=noisy[:, 1], pos_std=std, input_true_id=part.track_id + 1)

        parts = []
        for name, here in (("first", away < 1.0), ("second", away > -1.0)):
            part = observed(table[here]).assign(sensor=name)
            one = scene[name]
            moved = np.array(middle) + rotated(part[["x", "y"]].to_numpy() - middle, one.rotation or 0.0)
            moved += one.shift
            parts.append(part.assign(x=moved[:, 0], y=moved[:, 1], t=part.t + one.clock_offset))
        rows = pd.concat(parts, ignore_index=True).sort_values("t", kind="stable").reset_index(drop=True)
        single = observed(table).sort_values("t", kind="stable").reset_index(drop=True)
        return cls(_numbered(rows), _numbered(single), scene)


def _numbered(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(input_row=np.arange(len(rows), dtype=float))


# -- a robot -------------------------------------------------------------------------------------------------


def on_robot(seed: int, *, seconds: float = 15.0, moves: bool = True) -> SimulatedRows:
    """Return the rows of two lasers of a robot that turns at 1 rad/s, or of one that stands.

    12.5 scans a second, the second laser half a scan after the first; errors of the poses are 3 cm and 1°.
    """
    rng = np.random.default_rng(seed)
    people = crossing(rng, people=12, seconds=seconds, fps=12.5, side=14.0)
    fixed = gt.Sensor(
        position_std=0.05,
        detection_probability=0.95,
        range=8.0,
        at=(0.0, 0.0),
        simulation=SimulatedSensor(hz=12.5),
    )
    if not moves:
        return observe(people, {"laser": fixed}, rng=rng)
    drives = SimulatedSensor(
        hz=12.5, way="circle", radius=1.0, turn_rate=1.0, pose_std=0.03, pose_yaw_std=math.radians(1.0)
    )
    front = replace(fixed, moves=True, sector=(-2.4, 2.4), heading=0.0, simulation=drives)
    rear = replace(front, heading=math.pi, simulation=replace(drives, phase=0.04))
    return observe(people, {"front": front, "rear": rear}, rng=rng)
