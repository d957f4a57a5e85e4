"""Speed of the trackers of many people: ratios of processor time a frame, of the same detections."""

from __future__ import annotations

import time
from collections.abc import Callable

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


def test_a_frame_of_a_crowd_beside_a_plain_tracker(record: Callable[[str, float], None]) -> None:
    alone, tracker = OnlineAssociation(), gt.OnlineTracker("full")
    own, whole, peer = milliseconds(alone.update, tracker.update, HungarianTracker().step)
    print(f"\nms of a frame: association {own:.1f}, tracker with full {whole:.1f}, plain {peer:.1f}")
    record("frame of 100 people, online association / Kalman and Hungarian, processor time", own / peer)
    record("frame of 100 people, online tracker full / Kalman and Hungarian, processor time", whole / peer)


def test_groups_looks_and_forecasts_of_a_crowd_beside_a_plain_tracker(
    record: Callable[[str, float], None],
) -> None:
    """All of `graphtrack track - --groups --attention --forecast 2` but for reading and writing rows."""
    tracker, groups, looks = gt.OnlineTracker("full"), gt.OnlineGroups(), gt.OnlineAttention()
    people: list[gt.PersonEstimate] = []
    found: list[gt.Groups] = []

    def track(t: float, seen: np.ndarray) -> None:
        people[:] = tracker.update(t, seen)

    def part(t: float, seen: np.ndarray) -> None:
        found[:] = [groups.update(t, people)]

    def look(t: float, seen: np.ndarray) -> None:
        looks.update(t, people, found[0])

    def foresee(t: float, seen: np.ndarray) -> None:
        tracker.forecast(2.0, 0.4)

    whole, *own, peer = milliseconds(track, part, look, foresee, HungarianTracker().step)
    names = ("groups", "attention", "forecast")
    told = ", ".join(f"{name} {one:.1f}" for name, one in zip(names, own, strict=True))
    print(
        f"\nms of a frame: tracker with full and what forecasts learn {whole:.1f}, {told}, plain {peer:.1f}"
    )
    spent = sum(own)
    record(
        "frame of 100 people, groups, attention, forecast / Kalman and Hungarian, processor time",
        spent / peer,
    )
    record("frame of 100 people, groups, attention, forecast / tracker full, processor time", spent / whole)
