"""Notes on what frames show: one colour, a still picture, a camera that moves."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from command import ran, run
from encoded_videos import encoded

from perception.detection.boxes import PersonBox
from perception.ground.inspection import FrameInspection

RNG = np.random.default_rng(1)
SMALL = cv2.GaussianBlur(RNG.integers(0, 256, (200, 500, 3)).astype(np.uint8), (0, 0), 1.5)
WIDE = cv2.resize(SMALL, (1250, 500))
PERSON = cv2.resize(SMALL[:80, :28], (70, 200))


def view(k: int, left: float, *, noise: float = 2.0) -> np.ndarray:
    """Return a picture of 480 × 320 pixels of a wall, from a column on, in front of which a person walks."""
    move = np.array([[1.0, 0.0, -left], [0.0, 1.0, -60.0]])
    image = cv2.warpAffine(WIDE, move, (480, 320)).astype(float)
    rng = np.random.default_rng(k)
    image += rng.normal(0.0, noise, image.shape)
    image[80:280, 20 + 4 * k : 90 + 4 * k] = PERSON
    return image.clip(0, 255).astype(np.uint8)


MOTIONS = {
    "still": (lambda k: 100.0, False),
    "shaken by less than a pixel": (lambda k: 100.0 + 0.5 * (-1) ** k, False),
    "pans": (lambda k: 20.0 + 6.0 * k, True),
    "pans slowly": (lambda k: 100.0 + 0.5 * k, True),
    "hand-held": (lambda k: 100.0 + 12.0 * np.sin(1.7 * k), True),
    "is turned once": (lambda k: 100.0 + 25.0 * (k > 30), True),
}


@pytest.mark.slow
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("boxes", [True, False])
def test_a_camera_that_moves_is_known_from_one_that_does_not(motion: str, boxes: bool) -> None:
    left, moves = MOTIONS[motion]
    inspection = FrameInspection(every=1.0)
    for k in range(60):
        people = [PersonBox(k, 1, (20.0 + 4 * k, 80.0, 70.0, 200.0))] if boxes else []
        inspection.add(k, view(k, left(k)), k / 10.0, people)
    notes = inspection.notes()
    assert any("THE CAMERA MOVES" in line for line in notes) == moves, notes
    assert not inspection.notes(moves=True)
    assert moves or not notes


def test_a_still_picture_and_one_colour_are_noted() -> None:
    still, black, half = FrameInspection(), FrameInspection(), FrameInspection()
    for k in range(30):
        still.add(k, view(0, 100.0), k / 10.0)
        black.add(k, np.full((320, 480, 3), 16, np.uint8), k / 10.0)
        half.add(k, view(k, 100.0) if k % 10 else np.zeros((320, 480, 3), np.uint8), k / 10.0)
    assert "the picture does not change" in still.notes()[0]
    assert black.nothing_shown and not half.nothing_shown and not still.nothing_shown
    assert "have one colour, such as frame 0" in half.notes()[0]


@pytest.mark.slow
def test_a_black_video_is_refused_and_a_folder_has_an_assumed_rate(tmp_path: Path) -> None:
    black = encoded(tmp_path / "black.mp4", [np.full((96, 128, 3), 16, np.uint8)] * 8)
    boxes = tmp_path / "boxes.txt"
    boxes.write_text("".join(f"{k},1,{20 + 4 * k},80,70,200,1,-1,-1,-1\n" for k in range(8)))
    for command in ("observe", "report"):
        done = run(command, black, "-o", tmp_path / "out.csv")
        assert done.returncode == 2 and "one colour in all" in done.stderr
    assert "ONE COLOUR in all" in ran("observe", black, "--boxes", boxes, "-o", tmp_path / "o.csv").stderr
    frames = tmp_path / "frames"
    frames.mkdir()
    for k in range(8):
        cv2.imwrite(str(frames / f"{k}.png"), view(k, 20.0 + 10.0 * k))
    table = tmp_path / "rows.csv"
    said = ran("observe", frames, "--boxes", boxes, "-o", table).stderr
    assert "25 frames a second are assumed: a folder of images gives no rate (--fps)" in said
    said = ran("observe", frames, "--boxes", boxes, "-o", table, "--fps", 2.5).stderr
    assert "assumed" not in said and "THE CAMERA MOVES" in said
    init = "20,80,70,200"
    said = ran("follow", frames, "--tracker", "color", "--init", init, "-o", table, "--fps", 2.5).stderr
    assert "THE CAMERA MOVES" in said


def test_damaged_frames_are_noted(tmp_path: Path) -> None:
    video = encoded(tmp_path / "a.mpg", [view(k, 100.0)[::2, ::2] for k in range(20)])
    data, rng = bytearray(video.read_bytes()), np.random.default_rng(0)
    for at in rng.integers(len(data) // 3, 2 * len(data) // 3, 25):
        data[at] ^= 1 << int(rng.integers(8))
    video.write_bytes(data)
    boxes = tmp_path / "boxes.txt"
    boxes.write_text("".join(f"{k},1,{10 + 2 * k},40,35,100,1,-1,-1,-1\n" for k in range(20)))
    said = ran("observe", video, "--boxes", boxes, "-o", tmp_path / "o.csv").stderr
    assert "damaged (bit errors), such as frame" in said
