"""Joint weight of frames of one person, and several recordings of a camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command import run
from street_files import write_street

from graphtrack.errors import InputError
from graphtrack.model import Model
from perception.adaptation.directions import CLASSES, class_outlier_probability
from perception.adaptation.labels import walking_labels
from perception.adaptation.learning import AdaptationParameters, joined, thinned
from perception.evaluation.adapted_cameras import sequences_of
from perception.synthetic.clips import FPS, pasted_street


def _said(rng: np.random.Generator, *, again: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Classifications of 60 people in 20 frames each, right by 0.65; one per person, or one per frame."""
    person = np.repeat(np.arange(60), 20)
    angle = np.repeat(rng.uniform(-np.pi, np.pi, 60), 20)
    draws = rng.choice(8, 60 if again else len(person), p=[0.65, *[0.05] * 7])
    off = draws[person] if again else draws
    said = np.full((len(person), 8), 0.05)
    said[np.arange(len(person)), (CLASSES.index(angle) + off) % 8] = 0.65
    return np.log(said), angle, person


def test_frames_that_repeat_each_other_are_worth_less_than_new_ones() -> None:
    rng = np.random.default_rng(0)
    found = {}
    for again in (True, False):
        said, angle, person = _said(rng, again=again)
        found[again] = class_outlier_probability([said], angle, person, np.ones(len(person)))
    assert found[True] > 0.8 and found[False] < 0.4


def test_people_of_several_recordings_stay_apart_and_thinning_keeps_their_weight() -> None:
    one = pasted_street(4, np.random.default_rng(2), offset=0.0)
    labels = walking_labels(one.boxes, None, one.camera, FPS)
    both = joined([labels, labels])
    assert len(np.unique(both.person)) == 8 and both.tracks == 8
    thin = thinned(both, AdaptationParameters(most_of_person=2))
    assert len(thin) == 16
    np.testing.assert_allclose(thin.count.sum(), len(both))


@pytest.mark.slow
def test_a_camera_learns_from_two_recordings_and_writes_the_graph_that_goes_with_it(tmp_path: Path) -> None:
    arguments: list[object] = []
    for name, seed in (("a", 5), ("b", 6)):
        street = pasted_street(11, np.random.default_rng(seed))
        frames, option, boxes, *options = write_street(street, tmp_path / name)
        arguments += [frames, option, boxes]
    arguments += options
    once = run("adapt", *arguments, "--boxes", boxes, "-o", tmp_path / "camera.npz")
    assert once.returncode == 2 and "--boxes 3 times for 2 recordings" in once.stderr
    graph = tmp_path / "camera.toml"
    done = run("adapt", *arguments, "-o", tmp_path / "camera.npz", "--write-model", graph)
    assert done.returncode == 0, done.stderr
    assert "of 22 tracks" in done.stdout + done.stderr
    share = Model.named(graph).parameters.likelihood.class_outlier_probability
    assert 0.05 <= share <= 0.98


def test_one_sequence_of_the_lobby_is_too_few_to_judge_adaptation(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="0 sequences"):
        sequences_of(tmp_path)
