"""A smoother that is saved and built again goes on as if nothing had happened, to the last bit."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from selection import others_slow
from walks import walk

import graphtrack as gt
from graphtrack.geometry.angles import difference, wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import Estimate
from graphtrack.inference.chain.window import SLOTS, pool_of
from graphtrack.inference.online import OnlineSolver
from graphtrack.model import Observation
from graphtrack.model.observation import observations
from graphtrack.saved import packed, unpacked
from graphtrack.streaming.answers import StreamBounds, TrackAnswers
from graphtrack.tracks.track import Track

CAMERA = GroundCamera.from_homography([[0.02, 0.001, -6.0], [0.0, -0.03, 14.0], [0.0, 0.0012, 1.0]])


def bits(estimate: Estimate) -> bytes:
    """Every number of an estimate, bit for bit."""
    angles = [estimate.body, estimate.head]
    numbers = np.concatenate(
        [estimate.position, estimate.velocity, angles, estimate.covariance.ravel(), [estimate.t]]
    )
    return numbers.tobytes() + f"{estimate.frame} {estimate.status} {estimate.reason}".encode()


def through_json(state: dict[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps(state, allow_nan=False))


def spinning(track: Track) -> Track:
    """A person who turns round and round, so that angles exceed ±π by many turns."""
    turn = 4.0 * (track.t - track.t[0])
    return replace(track, body=wrap(track.body + turn), head=wrap(track.head + turn))


def seen_by_camera(track: Track) -> Track:
    position = track.position - track.position.mean(axis=0)
    noise = np.random.default_rng(2).normal(0.0, 2.0, position.shape)
    return replace(track, position=position, pixel=CAMERA.ground_to_image(position) + noise)


def rows(track: Track, seed: int) -> list[Observation]:
    """Its observations over a bad line: with gaps, outliers, and out-of-sequence, repeated and old ones."""
    rng = np.random.default_rng(seed)
    seen = list(observations(track))
    for k, chance in enumerate(rng.random(len(seen)).tolist()):
        if chance < 0.1 or (track.pixel is not None and chance < 0.6):
            seen[k] = replace(seen[k], position=None)
        elif chance > 0.9:
            seen[k] = replace(seen[k], body=None, head=None)
        elif chance > 0.85:
            seen[k] = replace(seen[k], position=(50.0, 5.0))
    for k, chance in enumerate(rng.random(len(seen) - 3).tolist()):
        if chance < 0.1:
            seen[k], seen[k + 1] = seen[k + 1], seen[k]
        elif chance < 0.15:
            seen.insert(k, seen[k + 1])
        elif chance < 0.2:
            seen.insert(k, seen[max(0, k - 40)])
    half = len(seen) // 2
    return seen[:half] + [replace(one, t=one.t + 5.0) for one in seen[half:]]


SCENES: dict[str, Callable[[int], Track]] = {
    "angles": lambda n: spinning(walk(n, seed=1, dt=0.04, noise=0.1, angle_kappa=3.0)),
    "classes": lambda n: walk(n, seed=2, dt=0.04, uneven=True, noise=0.1, classes=True),
    "pixels": lambda n: seen_by_camera(walk(n, seed=3, dt=0.04, noise=0.0)),
}


KEPT = [
    ("chain", "joint-intentional", 120),
    ("chain", "position", 80),
    ("fixed-lag", "joint", 60),
    ("fixed-lag", "joint-intentional", 60),
]
QUICK = [
    (*KEPT[0], "classes"),
    (*KEPT[0], "pixels"),
    (*KEPT[1], "pixels"),
    (*KEPT[2], "pixels"),
]


@pytest.mark.parametrize(
    ("engine", "preset", "n", "scene"),
    others_slow([(*one, scene) for one in KEPT for scene in SCENES], QUICK),
)
def test_it_goes_on_to_the_last_bit(engine: Any, preset: str, n: int, scene: str) -> None:
    options: dict[str, Any] = {"engine": engine, "lag": 0.5, "camera": CAMERA}
    whole = OnlineSolver(preset, **options)
    stopped = OnlineSolver.from_state(through_json(whole.state()), preset, **options)  # of nothing so far
    rng, statuses = np.random.default_rng(4), set()
    for k, observation in enumerate(rows(SCENES[scene](n), seed=5)):
        expected = whole.update(observation)
        assert bits(stopped.update(observation)) == bits(expected), k
        statuses.add(expected.status)
        if rng.random() < 0.3:
            saved = through_json(stopped.state())
            stopped = OnlineSolver.from_state(saved, preset, **options)
            assert through_json(stopped.state()) == saved
    assert statuses >= {"new", "late", "duplicate", "too-late"}


@pytest.mark.parametrize(
    ("engine", "preset", "scene"),
    [("chain", "joint-intentional", "classes"), ("fixed-lag", "joint", "angles")],
)
def test_a_state_that_is_asked_for_later_is_that_of_now(engine: Any, preset: str, scene: str) -> None:
    smoother = OnlineSolver(preset, engine=engine, lag=0.5)
    taken: list[tuple[dict[str, Any], Callable[[], dict[str, Any]]]] = []
    for observation in rows(SCENES[scene](60), seed=5):
        smoother.update(observation)
        taken.append((through_json(smoother.state()), smoother.later_state()))
    assert all(through_json(later()) == now for now, later in taken)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "scene"),
    others_slow(
        [(preset, scene) for preset in ("separate", "joint") for scene in SCENES],
        [("separate", "angles"), ("joint", "classes")],
    ),
)
def test_that_settled_frames_are_not_factored_anew_does_not_show(preset: str, scene: str) -> None:
    options: dict[str, Any] = {"engine": "chain", "lag": 2.0, "camera": CAMERA}
    smoother, anew = OnlineSolver(preset, **options), OnlineSolver(preset, **options)
    differ = False
    for observation in observations(SCENES[scene](90)):
        found = smoother.update(observation)
        state = through_json(anew.state())
        arrays = state["arrays"]
        if "factored" in arrays:
            arrays["factored"] = packed(unpacked(arrays["factored"]) + 1.0)  # so far away
        anew = OnlineSolver.from_state(state, preset, **options)
        expected = anew.update(observation)
        np.testing.assert_allclose(found.position, expected.position, atol=1e-4)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=0.02, atol=1e-4)
        for one, other in ((found.body, expected.body), (found.head, expected.head)):
            assert abs(difference(one, other)) < 1e-3
        differ = differ or bits(found) != bits(expected)
    assert differ


def test_what_is_remembered_of_intervals_does_not_show() -> None:
    """Frames are packed once for all intervals that round to the same; the first of them must not decide."""
    moments = [0.0, 0.1 + 3e-10, 5.0, 5.1, 5.2, 5.3, 5.4 + 1e-11]
    seen = [Observation(t=t, position=(t, 0.0), body=0.1 * t, head=0.2) for t in moments]
    whole = OnlineSolver("joint", engine="chain", lag=0.15)
    for observation in seen[:3]:
        whole.update(observation)
    resumed = OnlineSolver.from_state(through_json(whole.state()), "joint", engine="chain", lag=0.15)
    assert all(bits(resumed.update(one)) == bits(whole.update(one)) for one in seen[3:])


def courses(people: int, frames: int) -> list[list[Observation | None]]:
    """Observations by frame; people begin, end, and miss frames and channels."""
    rng = np.random.default_rng(people)
    found: list[list[Observation | None]] = [[None] * people for _ in range(frames)]
    for person in range(people):
        seen = observations(walk(frames, seed=person, classes=person % 3 == 1))
        begin, end = rng.integers(0, frames // 3), rng.integers(frames // 2, frames)
        for k, one in enumerate(seen):
            if not begin <= k < end or rng.random() < 0.1:
                continue
            lost = {"head": None} if rng.random() < 0.3 else {"position": None} if rng.random() < 0.1 else {}
            found[k][person] = replace(one, **lost)
    return found


def assert_same(one: Estimate, other: Estimate) -> None:
    assert one.status == other.status
    for name in ("t", "position", "velocity", "body", "head", "covariance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["position", "joint", "joint-intentional"])
def test_together_is_the_same_as_one_by_one(preset: str) -> None:
    people = SLOTS + 3 if preset == "joint" else 5  # more than one call takes
    alone, joined = ([OnlineSolver(preset, lag=1.0) for _ in range(people)] for _ in range(2))
    told = 0
    for k, frame in enumerate(courses(people, 16)):
        there = [person for person, one in enumerate(frame) if one is not None]
        if k == 8:  # going on elsewhere makes no difference either
            joined = [OnlineSolver.from_state(one.state(), preset, lag=1.0) for one in joined]
        seen = [joined[person].usable(frame[person]) for person in there]
        estimates = OnlineSolver.update_together([joined[person] for person in there], seen)
        for person, estimate in zip(there, estimates, strict=True):
            assert_same(alone[person].update(frame[person]), estimate)
            told += estimate.status == "new"
    assert told > 6 * people


@pytest.mark.slow
def test_slots_are_used_again_blocks_let_go_and_windows_outgrow_theirs() -> None:
    def blocks() -> int:
        return len(pool_of(smoother._smoother._program).blocks)

    smoother = OnlineSolver("joint", lag=2.0)
    before = blocks()
    many = [OnlineSolver("joint") for _ in range(2 * SLOTS)]
    assert blocks() > before
    del many
    assert blocks() == before
    seen = list(observations(walk(300, dt=0.005)))
    for one in seen[:150]:
        smoother.update(one)
    # It moves to larger arrays, and goes on as one that has them from the start.
    other = OnlineSolver.from_state(smoother.state(), "joint", lag=2.0)
    for one in seen[150:]:
        assert_same(smoother.update(one), other.update(one))
    assert len(smoother.history()) == 300


def test_who_fails_leaves_the_others_alone_and_stays_as_they_were() -> None:
    """By a position whose information exceeds a double."""
    alone, joined = ([OnlineSolver("joint") for _ in range(3)] for _ in range(2))
    for k in range(5):
        for person in range(3):
            seen = Observation(0.1 * k, k, (0.1 * k, float(person)))
            alone[person].update(seen), joined[person].update(seen)
    before = joined[1].state()
    bad = Observation(0.5, 5, (1e8, 1.0), position_std=1e-150)
    seen = [Observation(0.5, 5, (0.5, 0.0)), bad, Observation(0.5, 5, (0.5, 2.0))]
    found = OnlineSolver.update_together(joined, seen)
    assert [one.status for one in found] == ["new", "failed", "new"]
    for person in (0, 2):
        assert_same(alone[person].update(seen[person]), found[person])
    after = joined[1].state()
    assert all(after[name] == before[name] for name in ("steps", "window", "next_index", "last"))
    assert joined[1].update(Observation(0.5, 5, (0.5, 1.0))).status == "new"


@pytest.mark.slow
def test_rows_together_are_answered_as_one_by_one() -> None:
    """Updates of repeated, out-of-sequence, new, invalid and forgotten people."""
    rng = np.random.default_rng(1)
    lines = []
    for k in range(40):
        for person in rng.permutation(6).tolist():
            t = 0.04 * (k - 3 * (rng.random() < 0.05)) + (100.0 if k > 26 else 0.0)
            row = {"track_id": person, "frame": k, "t": t, "x": float(k), "y": float(person)}
            row |= {"head_deg": 20 * person} if rng.random() < 0.5 else {}
            row |= {"x": "?"} if rng.random() < 0.02 else {"other": 1} if rng.random() < 0.02 else {}
            lines += [json.dumps(row).encode()] * (2 if rng.random() < 0.05 else 1)
    numbered = list(enumerate(lines, 1))
    by_one, together = people(), people()
    alone = [by_one.answers(number, line) for number, line in numbered]
    joined = []
    while numbered:
        size = int(rng.integers(1, 20))
        joined += together.answers_together(numbered[:size])
        numbered = numbered[size:]
    assert joined == alone
    assert {row.get("status", "error") for answers in alone for row in answers} >= {"new", "late", "error"}
    assert (together.rows, together.line) == (by_one.rows, by_one.line) == (len(lines), len(lines))


def people() -> TrackAnswers:
    return TrackAnswers(
        lambda: gt.OnlineSmoother("joint"), None, lambda text: None, bounds=StreamBounds(5, 10.0)
    )
