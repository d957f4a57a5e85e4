"""Walks without angles, exact or quantised, in eight directions: a stationary point may be a saddle there.

A body that was never observed, and points exactly against the motion, has a zero gradient.
"""

from __future__ import annotations

import numpy as np
import pytest
from selection import others_slow

import graphtrack as gt
from graphtrack.geometry.angles import wrap
from graphtrack.model import presets

DT, SPEED = 0.1, 1.0
DIRECTIONS = 2.0 * np.pi * np.arange(8) / 8
QUANTA = (0.0, 0.05, 0.1)  # metres
BODY_FOLLOWS = ("joint-body", "joint", "joint-intentional", "social")
MODELS = [name for name in presets if name != "position"]


def along(travelled: np.ndarray, direction: float, quantum: float) -> np.ndarray:
    """Positions (n, 2) on a line through the origin, exactly on the axes where the direction is theirs."""
    unit = np.round([np.cos(direction), np.sin(direction)], 15)
    positions = travelled[:, None] * unit
    return np.round(positions / quantum) * quantum if quantum else positions


def walk(seconds: float) -> np.ndarray:
    return SPEED * DT * np.arange(round(seconds / DT))


def out_and_back(seconds: float) -> np.ndarray:
    n = round(seconds / DT)
    return SPEED * DT * np.concatenate([np.arange(n), np.arange(n, -1, -1)])


def stand_and_walk(seconds: float) -> np.ndarray:
    return np.concatenate([np.zeros(round(seconds / DT)), walk(seconds)])


def track_of(positions: np.ndarray) -> gt.Track:
    n = len(positions)
    return gt.Track(1, np.arange(n), DT * np.arange(n), positions)


def check(found: gt.Track, track: gt.Track, direction: float, quantum: float, coupled: bool) -> None:
    """The newest state, after a second of walking on: quantisation is noise of up to half a quantum."""
    assert found.velocity is not None and found.covariance is not None
    assert np.linalg.norm(found.position[-1] - track.position[-1]) < 0.02 + quantum
    along = found.velocity[-1] @ [np.cos(direction), np.sin(direction)]
    assert abs(along - SPEED) < 0.1 + 3.0 * quantum
    if coupled:
        assert found.body is not None
        assert abs(wrap(found.body[-1] - direction)) < np.radians(10.0 + 200.0 * quantum)


PATHS = [walk, stand_and_walk, out_and_back]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "quantum", "path"),
    others_slow(
        [(model, quantum, path) for model in MODELS for quantum in QUANTA for path in PATHS],
        [
            (model, QUANTA[k - i], PATHS[k])
            for i, model in enumerate(["joint", "joint-intentional"])
            for k in range(3)
        ],
    ),
)
def test_online_states_follow_an_exact_walk_in_any_direction(model, quantum, path):
    for direction in DIRECTIONS:
        ends = direction + np.pi if path is out_and_back else direction
        track = track_of(along(path(3.0), direction, quantum))
        check(gt.track_online(track, model), track, ends, quantum, model in BODY_FOLLOWS)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["isam2", "fixed-lag"])
@pytest.mark.parametrize("model", others_slow(MODELS, ["joint"]))
def test_online_engines_of_gtsam_leave_saddles(model, engine):
    for direction, quantum in ((np.pi, 0.0), (np.pi, 0.05), (1.5 * np.pi, 0.0)):
        track = track_of(along(walk(3.0), direction, quantum))
        found = gt.track_online(track, model, engine=engine, lag=1.0)
        check(found, track, direction, quantum, model in BODY_FOLLOWS)


@pytest.mark.parametrize(
    ("model", "quantum"),
    others_slow(
        [(model, quantum) for model in MODELS for quantum in QUANTA],
        [(model, QUANTA[k % len(QUANTA)]) for k, model in enumerate(MODELS)],
    ),
)
def test_offline_states_follow_an_exact_walk_in_any_direction(model, quantum):
    tracks = [track_of(along(walk(6.0), direction, quantum)) for direction in DIRECTIONS]
    for track, direction in zip(tracks, DIRECTIONS, strict=True):
        check(gt.smooth(track, model), track, direction, quantum, model in BODY_FOLLOWS)


@pytest.mark.parametrize("model", MODELS)
def test_gtsam_smooths_positions_alone_with_every_preset(model):
    track = track_of(along(walk(6.0), np.pi, 0.0))
    found, chain = gt.smooth(track, model, engine="gtsam"), gt.smooth(track, model)
    check(found, track, np.pi, 0.0, model in BODY_FOLLOWS)
    assert np.allclose(found.position, chain.position, atol=1e-3)
    for name in ("body", "head"):
        if getattr(chain, name) is not None:
            assert np.allclose(found.std(name), chain.std(name), rtol=0.05)


@pytest.mark.parametrize("rate", [2.5, 10.0, 25.0])
@pytest.mark.parametrize("model", BODY_FOLLOWS)
def test_the_heading_of_somebody_who_only_stands_does_not_jump(model, rate):
    rng, n = np.random.default_rng(3), round(20.0 * rate)
    track = gt.Track(1, np.arange(n), np.arange(n) / rate, rng.normal(0.0, 0.05, (n, 2)))
    found = gt.track_online(track, model)
    assert found.body is not None
    assert np.median(found.std("body")) > np.radians(90.0)  # next to nothing is known
    turns = np.abs(wrap(np.diff(found.body)))[round(rate) :]  # the first second decides where it begins
    assert turns.max() < np.radians(45.0)


def test_a_heading_is_taken_up_once_somebody_walks():
    rng, n = np.random.default_rng(3), 150
    travelled = np.maximum(DT * np.arange(n) - 10.0, 0.0)
    direction = np.radians(-130.0)
    track = track_of(along(travelled, direction, 0.0) + rng.normal(0.0, 0.05, (n, 2)))
    body = gt.track_online(track).body
    assert body is not None
    assert np.abs(wrap(body[115:] - direction)).max() < np.radians(30.0)
