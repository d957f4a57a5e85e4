"""Trackers on recordings: synthetic ones here, and the command's message where there are none."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from command import run

from graphtrack.errors import InputError
from perception.experiments.head_trackers import heads_of, slower
from perception.trackers.sigma_pi import SigmaPiTracker
from perception.trackers.sigma_pi_cues import ViewCue, descriptors
from perception.trackers.sigma_pi_network import SigmaPiParameters
from perception.trackers.tracker import Box, BoxDynamics, Cloud, predict

SIZE = (160, 120)


def texture(width: int, height: int, level: float, grain: float, seed: int) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (height, width)), (0, 0), grain)
    return np.clip(level + 20.0 * noise / noise.std(), 0, 255)


ROOM, STANDS, WALKS = texture(*SIZE, 120, 6, 0), texture(24, 16, 100, 1.5, 1), texture(24, 16, 150, 1.5, 2)
BOX: Box = (40.0, 60.0, 24.0, 16.0)


def lobby(k: int, seed: int = 0) -> np.ndarray:
    """A person who stands from the first frame on, and a person of the same colours who passes closely."""
    grey = ROOM.copy()
    grey[60:76, 40:64] = STANDS
    left = 4 * k - 30
    lo, hi = max(left, 0), min(left + 24, SIZE[0])
    if hi > lo:
        grey[78:94, lo:hi] = WALKS[:, lo - left : hi - left]
    grey = grey + np.random.default_rng([seed, k]).normal(0, 2, grey.shape)
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def on(box: Box, label: Box = BOX) -> bool:
    x, y = box[0] + box[2] / 2.0, box[1] + box[3] / 2.0
    return bool(label[0] <= x <= label[0] + label[2] and label[1] <= y <= label[1] + label[3])


def test_who_stands_from_the_first_frame_on_is_held_though_somebody_passes() -> None:
    held = []
    for seed in range(3):
        tracker = SigmaPiTracker(seed=seed)
        tracker.start(lobby(0), BOX)
        found = [tracker.step(lobby(k, seed)) for k in range(1, 60)]
        held += [one.found and on(one.box) for one in found]
    assert np.mean(held) > 0.98


def test_views_are_liker_the_person_than_what_is_beside_and_blank_walls() -> None:
    image = lobby(0)
    cue = ViewCue.of(image, np.array(BOX))
    assert cue is not None
    cue.look(lobby(1))
    left, top, width, height = BOX
    aside = np.array(
        [(left + dx * width, top + dy * height, width, height) for dx, dy in ((0.5, 0), (0, 0.5))]
    )
    activity = cue.activity(np.vstack([[BOX], aside]))
    assert activity[0] > 0.9 > 0.1 > activity[1:].max()
    cue.look(np.full((*SIZE[::-1], 3), 120, np.uint8))
    assert cue.gain(np.array([BOX]))[0] < 0.1


def test_the_first_view_is_never_forgotten_and_known_ones_are_not_added() -> None:
    cue = ViewCue(lobby(0), np.array(BOX))
    cue.look(lobby(1))
    for _ in range(5):
        cue.adapt(np.array(BOX))
    assert not cue._later
    for k in range(15):
        cue.look(np.repeat(texture(*SIZE, 120, 2, 10 + k).astype(np.uint8)[..., None], 3, axis=2))
        cue.adapt(np.array(BOX))
    assert len(cue._later) == 10
    cue.look(lobby(1))
    assert cue.gain(np.array([BOX]))[0] > 0.8


def test_boxes_that_are_too_small_or_blank_have_no_view() -> None:
    assert ViewCue.of(lobby(0), np.array([40.0, 60.0, 24.0, 8.0])) is None
    assert ViewCue.of(np.full((120, 160, 3), 90, np.uint8), np.array(BOX)) is None
    lengths = np.linalg.norm(descriptors(lobby(0)[..., 0], np.array([BOX, (0.0, 0.0, 30.0, 30.0)])), axis=1)
    assert (lengths <= 1.0 + 1e-6).all() and lengths[0] > 0.8


@pytest.mark.parametrize("box", [None, BOX])
def test_views_change_nothing_for_people_whom_nobody_shows(box: Box | None) -> None:
    ends = []
    for views in (True, False):
        tracker = SigmaPiTracker(SigmaPiParameters(views=views), seed=0)
        tracker.start(lobby(0), box)
        ends.append([tracker.step(lobby(k)).box for k in range(1, 10)][-1])
    assert (ends[0] == ends[1]) == (box is None)


def test_in_too_small_a_box_motion_keeps_its_reliability() -> None:
    tracker = SigmaPiTracker(seed=0)
    tracker.start(lobby(0), (40.0, 60.0, 10.0, 8.0))
    found = [tracker.step(lobby(k)) for k in range(1, 12)]
    assert {one.cues["reliability motion"] for one in found} == {1.0}
    assert len({one.cues["reliability colour"] for one in found}) > 1


def test_folders_without_recordings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Town Centre"):
        heads_of(tmp_path, 1)
    assert run("evaluate", "heads", "--data", str(tmp_path)).returncode == 2


def test_slower_motion_is_that_of_many_steps() -> None:
    dynamics = BoxDynamics(size_std=0.0, size_persistence=0.0, reversion=0.0)
    n = 20_000
    start = np.tile([0.0, 0.0, 0.0, 0.0], (n, 1))
    cloud = Cloud(start, start, np.full(n, 1.0 / n))
    rng = np.random.default_rng(0)
    for _ in range(10):
        cloud = predict(cloud, np.zeros(2), dynamics, rng)
    once = predict(Cloud(start, start, np.full(n, 1.0 / n)), np.zeros(2), slower(dynamics, 10), rng)
    assert once.now[:, 0].std() == pytest.approx(cloud.now[:, 0].std(), rel=0.05)
