"""Detections of supervision and Ultralytics, and their trackers' output, as tracks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.errors import InputError

FRAMES = 8


def detections(frame: int, ids: bool = True, make: Any = SimpleNamespace) -> Any:
    """Two people who walk past each other, and a dog."""
    left = np.array([10.0 + 3.0 * frame, 200.0 - 3.0 * frame, 50.0])
    corners = np.stack([left, [10.0, 30.0, 40.0], left + 40.0, [110.0, 130.0, 60.0]], axis=1)
    return make(
        xyxy=corners,
        confidence=np.array([0.9, 0.8, 0.7]),
        class_id=np.array([0, 0, 16]),
        tracker_id=np.array([5, 2, 7]) if ids else None,
    )


def assert_walks(tracks: gt.TrackSet, frames: Any = range(FRAMES)) -> None:
    frame = np.array(list(frames))
    foot = np.stack([0.01 * (30.0 + 3.0 * frame), np.full(len(frame), -1.1)], axis=1)
    first = min(tracks, key=lambda track: float(track.position[0, 0]))
    np.testing.assert_allclose(first.position, foot)
    np.testing.assert_array_equal(first.frame, frame)
    np.testing.assert_allclose(first.t, frame / 4.0)


def test_ids_of_a_tracker_are_the_tracks() -> None:
    found = [detections(frame) for frame in range(FRAMES)]
    tracks = gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01)
    assert [track.track_id for track in tracks] == [2, 5]
    assert_walks(tracks)
    some = {frame: detections(frame) for frame in (3, 6)}
    assert_walks(gt.from_supervision(some, fps=4.0, metres_per_pixel=0.01), some)
    everything = gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01, person=None)
    assert [track.track_id for track in everything] == [2, 5, 7]

    def result(one: Any) -> SimpleNamespace:
        boxes = SimpleNamespace(xyxy=one.xyxy, conf=one.confidence, cls=one.class_id, id=one.tracker_id)
        return SimpleNamespace(boxes=boxes, names={0: "person", 16: "dog"}, keypoints=None)

    assert_walks(gt.from_ultralytics(map(result, found), fps=4.0, metres_per_pixel=0.01))


def test_detections_without_ids_are_associated() -> None:
    found = [detections(frame, ids=False) for frame in range(FRAMES)]
    tracks = gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01)
    assert len(tracks) == 2
    assert_walks(tracks)
    with pytest.raises(InputError, match="without identities"):
        gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01, associate="never")


def test_what_the_package_trackers_gives_is_taken() -> None:
    supervision = pytest.importorskip("supervision", reason="the extra peers has it")
    trackers = pytest.importorskip("trackers", reason="see the extra peers")
    tracker = trackers.ByteTrackTracker(frame_rate=4.0)
    found = [tracker.update(detections(k, ids=False, make=supervision.Detections)) for k in range(FRAMES)]
    assert found[0].tracker_id is not None and (found[0].tracker_id == -1).all()  # no tracks yet
    tracks = gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01)
    assert_walks(tracks, range(1, FRAMES))


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (detections(0), "a list of them"),
        ([], "no people in 0 frames"),
        ([detections(0), detections(1, ids=False)], "no ids in frame 1"),
        ([SimpleNamespace(boxes=None)], "without xyxy"),
    ],
)
def test_what_does_not_fit_together_is_refused(found: Any, told: str) -> None:
    with pytest.raises(InputError, match=told):
        gt.from_supervision(found, fps=4.0)
    with pytest.raises(InputError, match="fps"):
        gt.from_supervision([detections(0)], fps=0.0)
