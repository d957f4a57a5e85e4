"""A camera that adapts itself: labels, alignment, learning, and rejected input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import ran, run
from street_files import write_street

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from graphtrack.model import Model
from perception.adaptation import learning
from perception.adaptation.directions import (
    CLASSES,
    calibrated,
    class_outlier_probability,
    fit_directions,
    folds_of,
    observed_directions,
)
from perception.adaptation.labels import COLUMNS, ROWS, TALL, in_patch, of_patch, patch_of, walking_labels
from perception.adaptation.learning import joined, thinned
from perception.adaptation.models import CameraModels
from perception.evaluation.adapted_cameras import sequences_of
from perception.models import load_classifier, load_head_localiser
from perception.observation.pipeline import Models, observe_frame
from perception.pose.classifier import reliability
from perception.synthetic.clips import FPS, PastedStreet, pasted_street


@pytest.fixture(scope="module")
def adapted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The file that a camera wrote, and its messages."""
    folder = tmp_path_factory.mktemp("adapted")
    arguments = write_street(pasted_street(12, np.random.default_rng(0)), folder / "street")
    done = ran("adapt", *arguments, "-o", folder / "camera.npz", "--write-model", folder / "graph.toml")
    return folder / "camera.npz", done.stdout + done.stderr


@pytest.fixture(scope="module")
def others() -> PastedStreet:
    return pasted_street(8, np.random.default_rng(1))


def test_labels_are_where_people_go_and_nobody_who_stands_has_one() -> None:
    street = pasted_street(4, np.random.default_rng(2), offset=0.0)
    labels = walking_labels(street.boxes, None, street.camera, FPS)
    assert len(np.unique(labels.person)) == 4
    assert np.abs(difference(labels.angle, street.angle[labels.box])).max() < np.deg2rad(20.0)
    at_once = [replace(item, box=street.boxes[0].box) for item in street.boxes]
    assert len(walking_labels(at_once, None, street.camera, FPS)) == 0


def test_too_few_who_walk_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    street = pasted_street(2, np.random.default_rng(3), offset=0.0)
    labels = walking_labels(street.boxes, None, street.camera, FPS)
    with pytest.raises(InputError, match="2 walking people, in 2 tracks"):
        thinned(labels)
    monkeypatch.setattr(learning, "LEAST_PEOPLE", 2)
    monkeypatch.setattr(learning, "MOST_OF_PERSON", 3)
    few = thinned(labels)
    assert np.bincount(few.person)[1:].tolist() == [3, 3]


def test_a_patch_holds_the_box_in_its_middle() -> None:
    image = np.zeros((200, 300, 3), np.uint8)
    image[60:100, 150:170] = 255
    patch = patch_of(image, (150, 60, 20, 40))
    assert patch.shape == (ROWS, COLUMNS, 3)
    rows, columns = np.nonzero(patch[..., 0] > 127)
    top_left = of_patch(np.array([columns.min(), rows.min()], float))
    np.testing.assert_allclose(top_left, [-0.25, 0.0], atol=1.5 / TALL)
    np.testing.assert_allclose(of_patch(in_patch(np.array([0.1, 0.2]))), [0.1, 0.2])
    assert patch_of(image, (-30, -30, 20, 400)).shape == (ROWS, COLUMNS, 3)


def test_a_direction_that_nobody_walked_in_is_neither_likely_nor_unlikely() -> None:
    label, person = np.repeat([0, 4, 1], 2), np.arange(6)
    seen = observed_directions(label, person)
    # Mirror images count: walking to the left gives samples of walking to the right.
    assert seen.tolist() == [True, True, False, False, True, False, False, True]
    said = np.exp(calibrated(np.array([[9.0, 0, 5, 5, 0, 5, 5, 0]]), 1.0, 0.0, seen)[0])
    np.testing.assert_allclose(said.sum(), 1.0)
    np.testing.assert_allclose(said[~seen], 1.0 / 8.0, rtol=1e-3)
    assert said[0] > 0.4


@pytest.mark.slow
def test_likelihoods_are_flat_where_nothing_can_be_told() -> None:
    rng = np.random.default_rng(4)
    features = rng.normal(size=(240, 30)).astype(np.float32)
    person = np.repeat(np.arange(24), 10)
    angle = np.repeat(rng.uniform(-np.pi, np.pi, 24), 10)
    _, out = fit_directions(features, np.ones(30, np.float32), angle, person, folds_of(person, rng))
    assert reliability(out, CLASSES.index(angle)).expected_calibration_error < 0.12
    assert np.exp(out).max() < 0.6


@pytest.mark.slow
def test_a_head_is_found_where_it_is_however_the_box_lies(
    adapted: tuple[Path, str], others: PastedStreet
) -> None:
    models = CameraModels.load(adapted[0])
    assert models.templates is not None
    moved = np.array([0.06, -0.04])
    apart = []
    for frame, item in zip(others.frames[:20], others.boxes[:20], strict=True):
        assert frame.image is not None
        box = np.array(item.box)
        there = box + box[3] * np.array([*moved, 0.0, 0.0])
        first, second = (models.candidates(patch_of(frame.image, b)).boxes[0, :2] for b in (box, there))
        apart.append(first - second - moved)
    assert np.abs(np.median(apart, axis=0)).max() < 0.03


@pytest.mark.slow
def test_an_adapted_camera_sees_bodies_better_than_the_models_of_the_package(
    adapted: tuple[Path, str], others: PastedStreet
) -> None:
    def error(of_camera: CameraModels | None) -> float:
        parts = load_head_localiser(), load_classifier("body_pose"), load_classifier("deep_belief")
        models = Models(*parts, of_camera=of_camera)
        said = []
        for frame, item in zip(others.frames, others.boxes, strict=True):
            assert frame.image is not None
            (seen,) = observe_frame(frame.image, frame.number, [item], models, pytest.fail)
            said.append(seen.body)
        return float(np.abs(difference(CLASSES.mean_pan(np.array(said)), others.angle)).mean())

    assert error(CameraModels.load(adapted[0])) < 0.75 * error(None)


def test_the_card_and_the_command_tell_of_people_left_out(adapted: tuple[Path, str]) -> None:
    path, said = adapted
    card = CameraModels.load(path).card
    assert card.parameters["people"] > 10
    assert card.figures["body_expected_calibration_error"] < 0.15
    share = CameraModels.load(path).class_outlier_probability
    graph = Model.named(path.with_name("graph.toml")).parameters.likelihood
    assert share is not None and graph.class_outlier_probability == pytest.approx(share)
    for text in ("in 12 tracks", "boxes as given", "expected calibration error"):
        assert text in said


def test_frames_of_another_size_are_refused(adapted: tuple[Path, str]) -> None:
    models = CameraModels.load(adapted[0])
    with pytest.raises(InputError, match="320 × 240"):
        models.look(np.zeros((100, 100, 3), np.uint8), [(10, 10, 20, 40)])


@pytest.mark.parametrize("case", ["no camera", "nobody walks", "name"])
def test_what_cannot_be_learned_from_is_one_line_and_nothing_is_written(case: str, tmp_path: Path) -> None:
    street = pasted_street(2, np.random.default_rng(5))
    if case == "nobody walks":
        street = replace(street, boxes=[replace(item, box=street.boxes[0].box) for item in street.boxes])
    arguments = write_street(street, tmp_path / "street")
    if case == "no camera":
        at = arguments.index("--homography")
        del arguments[at : at + 2]
    (tmp_path / "out").mkdir()
    output = tmp_path / "out" / ("camera.txt" if case == "name" else "camera.npz")
    done = run("adapt", *arguments, "-o", output)
    assert done.returncode == 2
    said = {"no camera": "--calibration or --homography", "nobody walks": "walking people", "name": ".npz"}
    assert said[case] in done.stderr and done.stderr.count("error:") == 1
    assert list((tmp_path / "out").iterdir()) == []


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


def test_people_of_several_recordings_stay_apart_and_thinning_keeps_their_weight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = pasted_street(4, np.random.default_rng(2), offset=0.0)
    labels = walking_labels(one.boxes, None, one.camera, FPS)
    both = joined([labels, labels])
    assert len(np.unique(both.person)) == 8 and both.tracks == 8
    monkeypatch.setattr(learning, "MOST_OF_PERSON", 2)
    thin = thinned(both)
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
    done = ran("adapt", *arguments, "-o", tmp_path / "camera.npz", "--write-model", graph)
    assert "of 22 walking people in 22 tracks" in done.stdout + done.stderr
    share = Model.named(graph).parameters.likelihood.class_outlier_probability
    assert 0.05 <= share <= 0.98


def test_one_sequence_of_the_lobby_is_too_few_to_judge_adaptation(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="0 sequences"):
        sequences_of(tmp_path)
