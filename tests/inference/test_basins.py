"""Classifiers that take front for back: no engine may settle where the body or the head faces backwards."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from selection import others_slow
from walks import walk

from graphtrack.geometry.angles import difference
from graphtrack.simulation.degrade import add_class_likelihoods
from graphtrack.smoothing import smooth, track_online
from graphtrack.tracks.track import Track, TrackSet

EVERY_ENGINE = pytest.mark.parametrize(
    ("engine", "lag"),
    [("chain", 1.0), ("fixed-lag", 1.0), ("isam2", 1.0), ("isam2", None)],
    ids=["chain", "fixed-lag", "isam2", "full history"],
)

SETTLED = 1.5
"""Seconds of answers after which the direction must be known: 15 answers, of which three are flipped."""


def misjudged(n_people: int = 3) -> TrackSet:
    people = TrackSet(tuple(walk(60, seed=k, track_id=k) for k in range(n_people)))
    return add_class_likelihoods(people, rng=np.random.default_rng(7))


def far_off(estimate: Track, name: str) -> float:
    """Share of the frames in which an orientation points more than 90° from the truth, once settled."""
    late = estimate.t > estimate.t[0] + SETTLED
    error = difference(getattr(estimate, name), getattr(estimate, f"true_{name}"))
    return float((np.abs(error[late]) > np.pi / 2.0).mean())


@EVERY_ENGINE
@pytest.mark.parametrize("preset", others_slow(["separate", "joint", "full"], ["joint"]))
def test_online_nobody_is_left_facing_backwards(preset: str, engine: Any, lag: float | None) -> None:
    """The answers of the first frames, which may be flipped, do not decide for good."""
    for track in misjudged():
        found = track_online(track, preset, engine=engine, lag=lag)
        for name in ("body", "head"):
            assert far_off(found, name) < 0.1, (track.track_id, name)


@pytest.mark.parametrize("engine", ["chain", "gtsam"])
@pytest.mark.parametrize("preset", others_slow(["separate", "joint", "full"], ["full"]))
def test_offline_nobody_faces_backwards(preset: str, engine: Any) -> None:
    for found in smooth(misjudged(), preset, engine=engine):
        assert far_off(found, "body") == far_off(found, "head") == 0.0


@pytest.mark.parametrize("engine", ["chain", "fixed-lag", "isam2"])
def test_whoever_turns_around_is_followed_out_of_the_past(engine: Any) -> None:
    """What left the window says that the head points one way; then it turns within a few frames.

    Not of a full history, which forgets nothing: to have turned around costs more than these answers weigh.
    """
    (track,) = misjudged(1)
    turned = np.array(track.true_head)
    turned[30:] += np.pi
    people = add_class_likelihoods(
        TrackSet((Track(1, track.frame, track.t, track.position, true_head=np.angle(np.exp(1j * turned))),)),
        rng=np.random.default_rng(1),
    )
    found = track_online(people.tracks[0], "separate", engine=engine, lag=2.0)
    error = np.abs(difference(found.head, found.true_head))
    assert (error[:30] < np.pi / 2.0).mean() > 0.7
    assert (error[50:] < np.pi / 4.0).all()
