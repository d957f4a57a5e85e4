"""Origins of time, of frames and of the ground, its axes, and rounded times change no command's result."""

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st
from selection import others_slow
from walks import rotation

import graphtrack as gt
from graphtrack.geometry.angles import FloatArray, difference, unit
from graphtrack.scale import associate_dataset
from graphtrack.streaming.behaviour import Asked
from graphtrack.streaming.session import Answers
from graphtrack.tracks.track import Track

UNIX = 1763892000.0

SECONDS = {2.5: 14, 10.0: 8}
"""Frames a second → duration. At both rates windows and gaps of whole seconds end exactly at a frame."""


@dataclass(frozen=True)
class Change:
    """Another way to write the same recording.

    Attributes
    ----------
    seconds, frames : added to times and to frame numbers
    digits : decimals of the written times; None: as they are
    jitter : seconds by which the times of a frame's rows differ at most
    turn, metres : rotation (rad) and translation (m) of the ground
    is_mirrored : whether y changes its sign first
    """

    seconds: float = 0.0
    frames: int = 0
    digits: int | None = None
    jitter: float = 0.0
    turn: float = 0.0
    metres: tuple[float, float] = (0.0, 0.0)
    is_mirrored: bool = False

    def points(self, points: FloatArray) -> FloatArray:
        """Return positions (n, 2) as they are written."""
        return (points * self.signs) @ rotation(self.turn).T + self.metres

    def angles(self, angles: FloatArray) -> FloatArray:
        """Return angles (rad) as they are written."""
        return angles * self.signs[1] + self.turn

    @property
    def signs(self) -> FloatArray:
        """Of x and y."""
        return np.array([1.0, -1.0 if self.is_mirrored else 1.0])

    def table(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return the recording as it is written."""
        t = table.t.to_numpy() + self.seconds
        t = t if self.digits is None else t.round(self.digits)
        t = t + np.random.default_rng(0).uniform(-0.5, 0.5, len(t)) * self.jitter
        changed = table.assign(frame=table.frame + self.frames, t=t)
        changed[["x", "y"]] = self.points(table[["x", "y"]].to_numpy())
        for name in ("body_deg", "head_deg"):
            if name in table:
                changed[name] = np.degrees(self.angles(np.radians(table[name].to_numpy())))
        return changed


@dataclass(frozen=True)
class Result:
    """What a command has found: positions (n, 2), angles (n,), numbers that are equal exactly, and others."""

    points: FloatArray
    angles: FloatArray
    labels: list[Any]
    numbers: FloatArray


Command = Callable[[pd.DataFrame], Result]

CHANGES = st.builds(
    Change,
    seconds=st.sampled_from([0.05, 1000.0, 86400.0, UNIX]) | st.floats(-1e5, 2e9),
    frames=st.integers(-200, 0) | st.integers(-1_000_000, 1_000_000),
    digits=st.sampled_from([None, 6]),
    jitter=st.floats(0.0, 2e-6),
    turn=st.sampled_from([0.0, 0.7]) | st.floats(-np.pi, np.pi),
    metres=st.sampled_from([(0.0, 0.0), (5e5, 5e6)]) | st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)),
    is_mirrored=st.booleans(),
)


def everybody(hz: float) -> pd.DataFrame:
    """Two who walk together, two who stand face to face, and two strangers; some rows are missing."""
    rng = np.random.default_rng(round(10 * hz))
    t = np.arange(SECONDS[hz] * hz) / hz
    ways = [
        ((0.0, 0.0), 1.2 * unit(0.2 + 0.02 * t)),
        ((0.0, 0.7), 1.2 * unit(0.2 + 0.02 * t)),
        ((3.0, 3.0), 0.0 * unit(0.0 * t)),
        ((4.1, 3.0), 0.0 * unit(0.0 * t)),
        ((9.0, -3.0), 1.3 * unit(2.0 - 0.05 * t)),
        ((-3.0, 5.0), 1.0 * unit(-0.6 + 0.03 * t)),
    ]
    tables = []
    for place, (start, velocity) in enumerate(ways):
        course = np.where(
            np.hypot(*velocity.T) > 0.0, np.arctan2(velocity[:, 1], velocity[:, 0]), np.pi * (place == 3)
        )
        position = np.array(start) + np.cumsum(velocity, axis=0) / hz + rng.normal(0.0, 0.05, (len(t), 2))
        body, head = course + rng.normal(0.0, 0.1, (2, len(t)))
        rows = {
            "track_id": place + 1,
            "frame": np.arange(len(t)),
            "t": t,
            "x": position[:, 0],
            "y": position[:, 1],
        }
        table = pd.DataFrame(rows | {"body_deg": np.degrees(body), "head_deg": np.degrees(head)})
        seen = rng.random(len(t)) > 0.1
        if place == 4:  # hidden for a gap of exactly two seconds
            seen[round(4 * hz) : round(6 * hz)] = False
        tables.append(table[seen])
    return pd.concat(tables, ignore_index=True)


def of_tracks(tracks: Iterable[Track]) -> Result:
    """Return the estimates of tracks."""
    parts = sorted(tracks, key=lambda track: track.track_id)
    angles = [angle for track in parts for angle in (track.body, track.head) if angle is not None]
    spread = [
        np.linalg.eigvalsh(track.covariance[:, :2, :2]) for track in parts if track.covariance is not None
    ]
    return Result(
        np.concatenate([track.position for track in parts]),
        np.concatenate([*angles, np.zeros(0)]),
        [(track.track_id, len(track)) for track in parts],
        np.concatenate([*spread, np.zeros((0, 2))]).ravel(),
    )


def smoothed(table: pd.DataFrame) -> Result:
    """`smooth --fill`."""
    return of_tracks(gt.smooth(gt.read(table), fill=True))


def resampled(table: pd.DataFrame) -> Result:
    """`smooth --resample`."""
    return of_tracks(gt.smooth(gt.read(table), "joint", resample=5.0))


def tracked(table: pd.DataFrame) -> Result:
    """`track` of a file."""
    return of_tracks(gt.track_online(gt.read(table), "joint"))


def associated(table: pd.DataFrame) -> Result:
    """`smooth --associate`, before smoothing."""
    return of_tracks(gt.associate(table[["frame", "t", "x", "y"]]))


def followed(table: pd.DataFrame) -> Result:
    """`OnlineTracker`."""
    tracker, points, labels, numbers = gt.OnlineTracker("position"), [], [], []
    for _, frame in table.groupby("frame"):
        for one in tracker.update(float(frame.t.iloc[0]), frame[["x", "y"]].to_numpy()):
            points.append(one.position)
            labels.append((tracker.updates, one.track_id, one.detection))
            numbers.append(np.nan_to_num(one.identity_p))
    return Result(np.array(points), np.zeros(0), labels, np.array(numbers))


def forecast(table: pd.DataFrame) -> Result:
    """`forecast`."""
    found = gt.forecast(gt.read(table), horizon=2.0, every=0.8).columns
    labels = np.column_stack([found["track_id"], found["frame"] - table.frame.min()]).tolist()
    spread = np.array(
        [[found["x_std"] ** 2, found["xy_cov"]], [found["xy_cov"], found["y_std"] ** 2]], dtype=float
    ).T
    sizes = np.column_stack([found["radius_50"], found["radius_90"], np.linalg.eigvalsh(spread)])
    return Result(np.column_stack([found["x"], found["y"]]), np.zeros(0), labels, sizes.ravel())


def grouped(table: pd.DataFrame, *, online: bool) -> Result:
    """`groups`."""
    found = gt.groups(gt.read(table[["track_id", "frame", "t", "x", "y"]]), online=online)
    labels = np.column_stack(
        [found.track_id, found.frame - table.frame.min(), found.group, found.kind]
    ).tolist()
    return Result(found.centre, np.zeros(0), labels, found.probability)


def attention(table: pd.DataFrame, *, online: bool) -> Result:
    """`attention`."""
    from graphtrack.interaction.attention import attention

    found = attention(gt.read(table), online=online)
    labels = [(one.track_id, one.people) for one in found]
    probability = np.concatenate([one.probability.ravel() for one in found])
    return Result(np.zeros((0, 2)), np.zeros(0), labels, probability)


def scored(table: pd.DataFrame) -> Result:
    """`score` of every second row, a little off, against all."""
    truth, found = gt.read(table), gt.read(table.iloc[::2].assign(x=table.x.iloc[::2] + 0.03))
    identities, states = gt.score(found, truth, metres=1.0).to_dict(), gt.score_states(found, truth)
    numbers = numbers_in((identities, astuple(states)))
    return Result(np.zeros((0, 2)), np.zeros(0), [identities["together"]["switches"]], numbers)


def numbers_in(value: Any) -> FloatArray:
    """Return all numbers in nested data."""
    found: list[float] = []

    def gather(part: Any) -> None:
        if isinstance(part, dict):
            part = list(part.values())
        if isinstance(part, list | tuple | np.ndarray):
            for one in part:
                gather(one)
        elif isinstance(part, int | float):
            found.append(float(part))

    gather(value)
    return np.nan_to_num(np.array(found))


def in_blocks(table: pd.DataFrame) -> Result:
    """Streamed `smooth` of detections: `associate_dataset`."""
    with TemporaryDirectory() as folder:
        given, found = Path(folder) / "given.parquet", Path(folder) / "found.parquet"
        table.sort_values(["frame", "track_id"])[["frame", "t", "x", "y"]].to_parquet(given, index=False)
        outcome = associate_dataset(given, found, {"longest_gap": 1.0}, block_rows=60)
        rows = pd.read_parquet(found)
    assert outcome.blocks > 1
    labels = np.column_stack([rows.frame - table.frame.min(), rows.track_id]).tolist()
    return Result(rows[["x", "y"]].to_numpy(), np.zeros(0), labels, np.nan_to_num(rows.identity_p.to_numpy()))


def streamed(table: pd.DataFrame, *, detections: bool = False) -> Result:
    """`track - --forecast 2 --groups --attention`, of rows with identities or of detections."""
    settings = Answers(gt.Model("joint"), horizon=(2.0, 0.4), asked=Asked(groups=True, attention=True))
    members = settings.scenes() if detections else settings.people()
    points, angles, labels, numbers = [], [], [], []
    rows = table.sort_values(["frame", "track_id"] if "track_id" in table else ["frame"], kind="stable")
    lines = [json.dumps(row).encode() for row in rows.to_dict("records")]
    answers = [row for k, line in enumerate(lines) for row in members.answers_together([(k + 1, line)])[0]]
    for row in (*answers, *members.finish()):
        assert "error" not in row, row
        if "x" in row and row["x"] is not None:
            points.append((row["x"], row["y"]))
            angles += [np.radians(row[name]) for name in ("body_deg", "head_deg") if name in row]
        points += [(one["x"], one["y"]) for one in row.get("forecast", ())]
        labels.append(
            [row.get(name) for name in ("track_id", "group", "kind", "people", "observed", "status")]
        )
        numbers += [one["radius_90"] for one in row.get("forecast", ())]
        # Of all targets those above a small probability are listed: their number may change with rounding.
        numbers.append(max((one["probability"] for one in row.get("attention", ())), default=0.0))
    return Result(np.array(points), np.array(angles), labels, np.array(numbers))


COMMANDS: dict[str, Command] = {
    "smooth": smoothed,
    "smooth --resample": resampled,
    "track": tracked,
    "associate": associated,
    "OnlineTracker": followed,
    "forecast": forecast,
    "groups": lambda table: grouped(table, online=False),
    "groups online": lambda table: grouped(table, online=True),
    "attention": lambda table: attention(table, online=False),
    "attention online": lambda table: attention(table, online=True),
    "score": scored,
    "associate_dataset": in_blocks,
    "track -": streamed,
    "track - of detections": lambda table: streamed(table.drop(columns="track_id"), detections=True),
}

GAZE = {"attention", "attention online", "track -", "track - of detections"}
"""Commands that report gaze: gaze at nothing has one of 24 directions, which do not turn with the ground."""

PHASES = [Phase.explicit, *([Phase.generate] if os.environ.get("HYPOTHESIS_PROFILE") else [])]
"""Every time the examples below; with another profile one that is drawn, too."""

_EXPECTED: dict[tuple[str, float], Result] = {}


def expected(command: str, hz: float) -> Result:
    """Return the result for the recording as it is, computed once."""
    if (command, hz) not in _EXPECTED:
        _EXPECTED[command, hz] = COMMANDS[command](everybody(hz))
    return _EXPECTED[command, hz]


@pytest.mark.parametrize(
    ("hz", "command"),
    others_slow(
        [(hz, command) for hz in SECONDS for command in COMMANDS],
        [*((2.5, command) for command in COMMANDS), (10.0, "smooth"), (10.0, "associate")],
    ),
)
@settings(max_examples=1, phases=PHASES, suppress_health_check=[HealthCheck.too_slow])
@example(Change(seconds=UNIX, frames=-35, digits=3))
@example(Change(seconds=0.05, frames=-80, jitter=2e-6, turn=0.7, metres=(5e5, 5e6)))
@given(CHANGES)
def test_origins_axes_and_rounding_change_no_result(command: str, hz: float, change: Change) -> None:
    before, after = expected(command, hz), COMMANDS[command](change.table(everybody(hz)))
    assert after.labels == before.labels
    np.testing.assert_allclose(after.points, change.points(before.points), atol=2e-4)
    assert np.abs(difference(after.angles, change.angles(before.angles))).max(initial=0.0) < 2e-3
    atol = 1e-2 if change.turn and command in GAZE else 2e-3
    np.testing.assert_allclose(after.numbers, before.numbers, rtol=2e-3, atol=atol)
