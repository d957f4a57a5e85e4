"""The tables: rates, clips with their truth, and the command that prints them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from command import run

from perception.evaluation.joint_effect import joint_effect
from perception.evaluation.measures import PoseScores
from perception.models import load_classifier, load_head_localiser
from perception.observe.pipeline import Models
from perception.pose.calibration import Reliability
from perception.synthetic.clips import Clip, walking_clip


def test_rates_are_those_of_counting() -> None:
    rng = np.random.default_rng(0)
    true, said = rng.integers(0, 3, 200), rng.integers(0, 3, 200)
    confusion = np.zeros((3, 3), np.int64)
    np.add.at(confusion, (true, said), 1)
    curve = Reliability(np.ones(1), np.ones(1), np.ones(1, np.int64))
    hits, false_alarms = PoseScores(0.0, 0.0, 0.0, 0.0, curve, confusion).rates
    for k in range(3):
        assert hits[k] == pytest.approx(np.mean(said[true == k] == k))
        assert false_alarms[k] == pytest.approx(np.mean(said[true != k] == k))


@pytest.fixture(scope="module")
def clip() -> Clip:
    return walking_clip(np.random.default_rng(2), people=2, steps=5)


def test_boxes_of_a_clip_stand_where_the_truth_is(clip: Clip) -> None:
    assert len(clip.images) == 5 and len(clip.boxes) >= 5
    for item in clip.boxes:
        track = clip.truth[item.track_id]
        left, top, width, height = item.box
        foot = clip.camera.ground_to_image(track.true_position[item.frame])
        assert left - 0.2 * width < foot[0] < left + 1.2 * width
        assert abs(top + height - foot[1]) < 0.2 * height


def test_the_same_seed_gives_the_same_clip(clip: Clip) -> None:
    again = walking_clip(np.random.default_rng(2), people=2, steps=5)
    assert again.boxes == clip.boxes
    np.testing.assert_array_equal(again.images[3], clip.images[3])


def test_joint_estimates_are_nearer_to_the_truth_than_single_frames(clip: Clip) -> None:
    models = Models(load_head_localiser(), load_classifier("body_pose"), load_classifier("deep_belief"))
    rows = {row["estimate"]: row for row in joint_effect([clip], models)}
    assert set(rows) == {"per frame", "separate", "joint"}
    assert rows["joint"]["body_deg"] < 0.8 * rows["per frame"]["body_deg"]
    assert {row["person_frames"] for row in rows.values()} == {len(clip.boxes)}


def test_the_pose_table_and_its_picture(tmp_path: Path) -> None:
    done = run("evaluate", "pose", "--count", 50, "--plot", tmp_path / "p.png")
    assert done.returncode == 0, done.stderr
    for text in ("templates", "exemplars", "deep_belief", "body_pose", "TPR", "FPR"):
        assert text in done.stdout
    assert cv2.imread(str(tmp_path / "p.png")) is not None


def test_wrong_tables_are_refused(tmp_path: Path) -> None:
    assert run("evaluate", "other").returncode == 2
    assert run("evaluate", "recognition", "--plot", tmp_path / "p.png").returncode == 2
