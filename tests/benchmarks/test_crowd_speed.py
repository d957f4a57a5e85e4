"""Speed of the trackers of many people: ratios of processor time a frame, of the same detections."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from crossing_people import crowd

import graphtrack as gt
from graphtrack.association.online import OnlineAssociation
from graphtrack.baselines.hungarian import HungarianTracker

pytestmark = pytest.mark.benchmark
STEP = 0.04
FIRST, FRAMES = 60, 120
"""By frame ``FIRST`` windows are full."""


def milliseconds(*steps: Callable[[float, np.ndarray], object]) -> list[float]:
    """Median processor time of a frame with 100 people at 25 Hz; all take the same frames in turn."""
    spent = []
    for k, seen in enumerate(crowd(np.random.default_rng(0), people=100, frames=FRAMES, step=STEP)):
        row = []
        for step in steps:
            start = time.process_time()
            step(STEP * k, seen)
            row.append(1e3 * (time.process_time() - start))
        spent.append(row)
    return np.median(spent[FIRST:], axis=0).tolist()  # type: ignore[no-any-return]


def show(figures: Callable[..., None], parts: dict[str, float]) -> None:
    """Print and record the milliseconds of a frame by its part."""
    print("\nms of a frame:", ", ".join(f"{name} {value:.1f}" for name, value in parts.items()))
    for name, value in parts.items():
        figures("Time of a frame of 100 people", {"part": name, "median (ms)": value})


def test_a_frame_of_a_crowd_beside_a_plain_tracker(
    record: Callable[[str, float], None], figures: Callable[..., None]
) -> None:
    alone, tracker = OnlineAssociation(), gt.OnlineTracker()
    own, whole, peer = milliseconds(alone.update, tracker.update, HungarianTracker().step)
    show(figures, {"association": own, "tracker": whole, "Kalman and Hungarian": peer})
    record("frame of 100 people, online association / Kalman and Hungarian, processor time", own / peer)
    record("frame of 100 people, online tracker / Kalman and Hungarian, processor time", whole / peer)


def test_groups_looks_and_forecasts_of_a_crowd_beside_a_plain_tracker(
    record: Callable[[str, float], None],
    figures: Callable[..., None],
) -> None:
    """All of `graphtrack track - --groups --attention --forecast 2` but for reading and writing rows."""
    tracker, groups, looks = gt.OnlineTracker(), gt.OnlineGroups(), gt.OnlineAttention()
    latest: dict[str, Any] = {}
    steps = (
        lambda t, seen: latest.update(people=tracker.update(t, seen)),
        lambda t, seen: latest.update(groups=groups.update(t, latest["people"])),
        lambda t, seen: looks.update(t, latest["people"], latest["groups"]),
        lambda t, seen: tracker.forecast(2.0, 0.4),
    )
    whole, *own, peer = milliseconds(*steps, HungarianTracker().step)
    show(figures, dict(zip(("groups", "attention", "forecasts 2 s ahead"), own, strict=True)))
    name = "frame of 100 people, groups, attention, forecast /"
    record(f"{name} Kalman and Hungarian, processor time", sum(own) / peer)
    record(f"{name} tracker, processor time", sum(own) / whole)
