"""People who are worked in together: the same as one by one, to the last bit."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from walks import walk

from graphtrack.inference import OnlineSmoother
from graphtrack.inference.chain.window_arrays import SLOTS, pool_of
from graphtrack.inference.state import Estimate
from graphtrack.model import Observation
from graphtrack.model.observation import observations
from graphtrack.streaming.answers import StreamBounds, TrackAnswers


def courses(people: int, frames: int) -> list[list[Observation | None]]:
    """By frame: what was seen of each; people begin, end, and miss frames and channels."""
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
    for name in ("t", "position", "velocity", "body", "head", "covariance", "aligned_p", "gait_offset"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


@pytest.mark.parametrize("preset", ["position", "joint", "full"])
def test_together_is_the_same_as_one_by_one(preset: str) -> None:
    people = SLOTS + 3 if preset == "joint" else 5  # more than one call takes
    alone, joined = ([OnlineSmoother(preset, lag=1.0) for _ in range(people)] for _ in range(2))
    told = 0
    for k, frame in enumerate(courses(people, 24)):
        there = [person for person, one in enumerate(frame) if one is not None]
        if k == 12:  # going on elsewhere makes no difference either
            joined = [OnlineSmoother.from_state(one.state(), preset, lag=1.0) for one in joined]
        seen = [joined[person].usable(frame[person]) for person in there]
        estimates = OnlineSmoother.update_together([joined[person] for person in there], seen)
        for person, estimate in zip(there, estimates, strict=True):
            assert_same(alone[person].update(frame[person]), estimate)
            told += estimate.status == "new"
    assert told > 10 * people


def test_slots_are_used_again_blocks_let_go_and_windows_outgrow_theirs() -> None:
    def blocks() -> int:
        return len(pool_of(smoother._smoother._program).blocks)

    smoother = OnlineSmoother("joint", lag=2.0)
    before = blocks()
    many = [OnlineSmoother("joint") for _ in range(2 * SLOTS)]
    assert blocks() > before
    del many
    assert blocks() == before
    seen = list(observations(walk(300, dt=0.005)))
    for one in seen[:150]:
        smoother.update(one)
    # It moves to larger arrays, and goes on as one that has them from the start.
    other = OnlineSmoother.from_state(smoother.state(), "joint", lag=2.0)
    for one in seen[150:]:
        assert_same(smoother.update(one), other.update(one))
    assert len(smoother.history()) == 300


def test_who_fails_leaves_the_others_alone_and_stays_as_they_were() -> None:
    """By a frame that comes next to at once after another, far away."""
    alone, joined = ([OnlineSmoother("joint") for _ in range(3)] for _ in range(2))
    for k in range(5):
        for person in range(3):
            seen = Observation(0.1 * k, k, (0.1 * k, float(person)))
            alone[person].update(seen), joined[person].update(seen)
    before = joined[1].state()
    bad = Observation(0.4 + 1e-12, 5, (1e8, 1.0))
    seen = [Observation(0.5, 5, (0.5, 0.0)), bad, Observation(0.5, 5, (0.5, 2.0))]
    found = OnlineSmoother.update_together(joined, seen)
    assert [one.status for one in found] == ["new", "failed", "new"]
    for person in (0, 2):
        assert_same(alone[person].update(seen[person]), found[person])
    after = joined[1].state()
    assert all(after[name] == before[name] for name in ("steps", "prior", "next_index", "last"))
    assert joined[1].update(Observation(0.5, 5, (0.5, 1.0))).status == "new"


def test_rows_together_are_answered_as_one_by_one() -> None:
    """Of people who come twice, late, for the first time, with what is no row, and who are forgotten."""
    rng = np.random.default_rng(1)
    lines = []
    for k in range(60):
        for person in rng.permutation(6).tolist():
            t = 0.04 * (k - 3 * (rng.random() < 0.05)) + (100.0 if k > 40 else 0.0)
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
        lambda: OnlineSmoother("joint"), None, lambda text: None, bounds=StreamBounds(5, 10.0)
    )
