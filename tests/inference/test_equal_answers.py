"""Equal problems have equal answers: turned, at other times, and with another engine.

The draw: 15 to 60 frames at 2.5, 5 or 10 Hz, a velocity that wanders (0.8 m/s each axis at first, 0.4 m/s
after a second), positions with noise of 0.1 m, a head that drifts from any direction and is observed in four
frames of five with noise of 0.6 rad, and a body that is not observed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from selection import others_slow
from walks import out_and_back, turned

import graphtrack as gt
from graphtrack import OnlineSmoother, TrackSet, smooth
from graphtrack.geometry.angles import difference, wrap
from graphtrack.model.observation import observations
from graphtrack.simulation.degrade import add_noise
from graphtrack.tracks.track import Track

FAR = 1e9
"""Seconds by which time is shifted: such times are rounded to 10⁻⁷ s."""

SAME = math.radians(1.0)

APART = math.radians(5.0)
"""Estimates of engines that differ by more are of different minima."""


def drawn(seed: int) -> Track:
    rng = np.random.default_rng(seed)
    n, dt = int(rng.integers(15, 61)), float(rng.choice([0.1, 0.2, 0.4]))
    velocity = rng.normal(0.0, 0.8, 2) + np.cumsum(rng.normal(0.0, 0.4 * math.sqrt(dt), (n, 2)), axis=0)
    position = np.cumsum(velocity * dt, axis=0) + rng.normal(0.0, 5.0, 2)
    head = rng.uniform(-np.pi, np.pi) + np.cumsum(rng.normal(0.0, 0.5 * math.sqrt(dt), n))
    head += rng.normal(0.0, 0.6, n)
    head[rng.random(n) < 0.2] = np.nan
    seen = position + rng.normal(0.0, 0.1, (n, 2))
    return Track(seed, np.arange(n), np.arange(n) * dt, seen, head=wrap(head))


def apart(a: Sequence[Track], b: Sequence[Track], turn: float = 0.0) -> np.ndarray:
    """Greatest difference of body and head (m, 2) of each pair of tracks, where ``b`` is turned."""
    return np.array(
        [
            [np.abs(difference(getattr(y, of) - turn, getattr(x, of))).max() for of in ("body", "head")]
            for x, y in zip(a, b, strict=True)
        ]
    )


def solved(tracks: Sequence[Track], engine: str = "auto") -> Sequence[Track]:
    return smooth(TrackSet(list(tracks)), "joint", engine=engine, constants="default").tracks


@pytest.fixture(scope="module")
def tracks() -> list[Track]:
    return [drawn(seed) for seed in range(150)]


@pytest.fixture(scope="module")
def answers(tracks: list[Track]) -> Sequence[Track]:
    return solved(tracks)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [180.0, 90.0, 37.0])
def test_turned_input_turns_the_answer(tracks: list[Track], answers: Sequence[Track], degrees: float) -> None:
    angle = math.radians(degrees)
    assert apart(answers, solved([turned(track, angle) for track in tracks]), angle).max() < SAME


def test_the_answer_does_not_depend_on_the_origin_of_time(
    tracks: list[Track], answers: Sequence[Track]
) -> None:
    assert apart(answers, solved([replace(track, t=track.t + FAR) for track in tracks])).max() < SAME


@pytest.mark.slow
def test_gtsam_keeps_orientations_that_only_couplings_hold(
    tracks: list[Track], answers: Sequence[Track], figures: Callable[..., None]
) -> None:
    found = solved(tracks[:25], "gtsam")
    off = [differences_of(one, other) for one, other in zip(found, answers[:25], strict=True)]
    figures("Tracks that differ", differing("gtsam", "offline", off))
    assert np.concatenate(off).max() < SAME


def differences_of(one: Track, other: Track) -> np.ndarray:
    """Differences (n, 2) of body and head."""
    return np.column_stack(
        [np.abs(difference(getattr(one, of), getattr(other, of))) for of in ("body", "head")]
    )


def differing(engine: str, way: str, off: Sequence[np.ndarray]) -> dict[str, str | int | float]:
    """A row of the table: how many tracks, each (n, 2), differ by more than `APART`, and how far."""
    row: dict[str, str | int | float] = {"engine": engine, "way": way, "tracks": len(off)}
    for k, angle in enumerate(("body", "head")):
        frames = np.concatenate(off)[:, k]
        row[f"{angle}: tracks that differ"] = sum(bool((one[:, k] > APART).any()) for one in off)
        row[f"{angle}: frames that differ (%)"] = 100.0 * float((frames > APART).mean())
        row[f"{angle}: median (°)"] = math.degrees(float(np.median(frames)))
        row[f"{angle}: greatest (°)"] = math.degrees(float(frames.max()))
    return row


def online(track: Track, engine: str) -> np.ndarray:
    """Online estimates (n, 2) of body and head, NaN before there are any."""
    smoother = OnlineSmoother("joint", engine=engine, constants="default")
    estimates = [smoother.update(one) for one in observations(track)]
    return np.array([[one.body, one.head] for one in estimates], dtype=float)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["fixed-lag", "isam2"])
def test_engines_online_differ_in_few_frames(
    tracks: list[Track], engine: str, figures: Callable[..., None]
) -> None:
    """A body without observations may turn to either side: engines take different ones, for some frames."""
    off = [np.abs(difference(online(one, engine), online(one, "chain"))) for one in tracks[:12]]
    every = np.concatenate(off)
    figures("Tracks that differ", differing(engine, "online", off))
    assert (np.median(every, axis=0) < math.radians(2.0)).all()
    assert (every > APART).mean() < 0.2


@pytest.mark.parametrize("engine", others_slow(["chain", "fixed-lag", "isam2"], ["chain"]))
def test_online_estimates_do_not_depend_on_the_origin_of_time(tracks: list[Track], engine: str) -> None:
    for track in tracks[:12]:
        found = []
        for given in (track, replace(track, t=track.t + FAR)):
            found.append(online(given, engine))
        assert np.abs(difference(*found)).max() < SAME


@pytest.mark.parametrize("preset", ["joint", "joint-intentional"])
@pytest.mark.parametrize("degrees", [180.0, 37.0])
def test_who_may_turn_either_way_turns_the_same_way_wherever_the_track_lies(
    preset: str, degrees: float
) -> None:
    walks = [out_and_back(seed) for seed in range(30)]
    angle = math.radians(degrees)
    others = [turned(track, angle) for track in walks]
    found = [smooth(TrackSet(them), preset, constants="default").tracks for them in (walks, others)]
    for one, other in zip(*found, strict=True):
        assert np.abs(difference(other.body - angle, one.body)).max() < SAME
        assert np.sum(difference(one.body[1:], one.body[:-1])) > 0.0  # counter-clockwise


def differences(people: gt.TrackSet, preset: str, lag: float = 10.0) -> np.ndarray:
    """Mean degrees between the last bodies and heads of whole tracks, and of the same online."""
    whole = gt.smooth(people, preset, constants="default")
    online = gt.track_online(people, preset, lag=lag, constants="default")
    found = []
    for one, other in zip(whole, online, strict=True):
        found.append([difference(one.body[-1], other.body[-1]), difference(one.head[-1], other.head[-1])])
    return np.asarray(np.degrees(np.abs(found).mean(axis=0)))


def simulated(preset: str) -> gt.TrackSet:
    return gt.simulate(preset, n_tracks=16, n_steps=45, fps=10.0, rng=np.random.default_rng(8))


@pytest.mark.parametrize("preset", ["separate", "joint"])
def test_the_last_frame_is_the_same_online(preset: str) -> None:
    assert differences(simulated(preset), preset).max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 3])
def test_the_last_frame_on_motion_capture(data_dir: Path, every: int) -> None:
    clips = gt.read(data_dir / "mocap" / "tracks_30hz.csv.gz")
    held = [track for track in clips.tracks[1::2] if len(track) >= 60]
    seen = []
    for seed in (0, 1):
        some, rng = clips.with_tracks(held[seed::6]), np.random.default_rng(seed)
        for track in add_noise(some, position_std=0.1, body_kappa=1.2, head_kappa=2.3, rng=rng):
            seen.append(replace(track[::every], track_id=len(seen)))
    scene = clips.with_tracks(seen)
    for preset, body, head in (("separate", 0.01, 0.01), ("joint", 0.02, 0.02)):
        assert (differences(scene, preset, lag=2.0) < (body, head)).all()
