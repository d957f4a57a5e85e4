"""Joining boxes to tracks on made-up boxes, and the detector on an empty frame."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from perception.detection.people import (
    Detections,
    DetectorParameters,
    PeopleDetector,
    PeopleTracker,
    colour_histogram,
)

RED, BLUE = (20, 20, 200), (200, 40, 20)


def frame_of(*people: tuple[float, tuple[int, int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """A picture with people of one colour each at the given columns, and their boxes."""
    image = np.full((120, 400, 3), 127, np.uint8)
    boxes = []
    for x, colour in people:
        image[20:100, round(x) : round(x) + 30] = colour
        boxes.append((x, 20.0, 30.0, 80.0))
    return image, np.array(boxes).reshape(-1, 4)


def detections(*people: tuple[float, tuple[int, int, int]]) -> Detections:
    return Detections.of(*frame_of(*people), np.ones(len(people)))


def run(frames: list[list[tuple[float, tuple[int, int, int]]]], **options: object) -> list[list[int]]:
    tracker = PeopleTracker(**options)  # type: ignore[arg-type]
    return [tracker.update(k, detections(*people)) for k, people in enumerate(frames)]


def test_a_person_keeps_the_id_and_a_second_one_gets_another() -> None:
    ids = run([[(10 + 4 * k, RED), (300 - 4 * k, BLUE)] for k in range(10)])
    assert {tuple(of_frame) for of_frame in ids} == {(1, 2)}


def test_people_who_cross_are_told_apart_by_motion_and_colour() -> None:
    ids = run([[(100 + 5 * k, RED), (200 - 5 * k, BLUE)] for k in range(21)])
    assert {tuple(of_frame) for of_frame in ids} == {(1, 2)}


def test_a_short_gap_is_bridged_and_a_long_one_is_not() -> None:
    def with_gap(gap: int) -> list[list[int]]:
        return run([[] if 8 <= k < 8 + gap else [(50 + 3 * k, RED)] for k in range(50)])

    assert {i for of_frame in with_gap(5) for i in of_frame} == {1}
    assert {i for of_frame in with_gap(20) for i in of_frame} == {1, 2}


def test_a_jump_starts_a_new_track() -> None:
    ids = run([[(10.0, RED)]] * 4 + [[(300.0, RED)]] * 4)
    assert [of_frame[0] for of_frame in ids] == [1] * 4 + [2] * 4


def test_with_a_camera_the_gate_is_in_metres() -> None:
    step = [[(10.0 + 20 * (k > 3), RED)] for k in range(6)]
    far, near = (GroundCamera.from_scale(scale) for scale in (0.1, 0.01))
    assert [of_frame[0] for of_frame in run(step, camera=far)][-1] == 2  # 2 m in one frame
    assert [of_frame[0] for of_frame in run(step, camera=near)][-1] == 1  # 0.2 m


def test_short_tracks_are_dropped_and_gaps_are_filled() -> None:
    tracker = PeopleTracker()
    for k in range(9):
        people = [] if k in (4, 5) else [(50 + 3 * k, RED)]
        people = people + ([(300, BLUE)] if k == 2 else [])
        tracker.update(k, detections(*people))
    found = tracker.tracks()
    assert [(item.frame, item.track_id) for item in found] == [(k, 1) for k in range(9)]
    np.testing.assert_allclose([item.box[0] for item in found], 50 + 3 * np.arange(9))


def test_an_empty_or_tiny_frame_has_no_people() -> None:
    detector = PeopleDetector()
    for shape in ((288, 384, 3), (20, 20, 3)):
        boxes, scores = detector.detect(np.full(shape, 90, np.uint8))
        assert boxes.shape == (0, 4) and scores.shape == (0,)
    with pytest.raises(InputError):
        PeopleDetector(DetectorParameters(enlarge=0.0))


def test_colours_are_shares_even_outside_the_frame() -> None:
    image, boxes = frame_of((10.0, RED))
    for box in (boxes[0], boxes[0] + (900.0, 0.0, 0.0, 0.0)):
        assert colour_histogram(image, box).sum() == pytest.approx(1.0)


def test_small_frames_are_enlarged_so_that_small_people_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[tuple[int, ...]] = []

    class Descriptor:
        def setSVMDetector(self, weights: np.ndarray) -> None: ...

        def detectMultiScale(self, image: np.ndarray, **options: object) -> tuple[np.ndarray, np.ndarray]:
            sizes.append(image.shape[:2])
            return np.array([[250, 125, 160, 320]]), np.ones(1)

        getDefaultPeopleDetector = staticmethod(cv2.HOGDescriptor.getDefaultPeopleDetector)

    monkeypatch.setattr(cv2, "HOGDescriptor", Descriptor)
    boxes, _ = PeopleDetector().detect(np.zeros((288, 384, 3), np.uint8))
    assert sizes[0] == (720, 960)
    np.testing.assert_allclose(boxes[0, :2] + boxes[0, 2:] / 2.0, (330 / 2.5, 285 / 2.5))
    PeopleDetector().detect(np.zeros((1080, 1920, 3), np.uint8))
    PeopleDetector(DetectorParameters(enlarge=2.0)).detect(np.zeros((288, 384, 3), np.uint8))
    assert sizes[1:] == [(1080, 1920), (576, 768)]
