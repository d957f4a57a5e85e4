"""Joint weight of frames of one person, several recordings of a camera, and rendered training data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command import run
from street_files import write_street

from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model import Model
from perception.adaptation.directions import (
    CLASSES,
    Sums,
    class_outlier_probability,
    fit_directions,
    folds_of,
)
from perception.adaptation.labels import ABOVE, COLUMNS, ROWS, TALL, as_patch, surroundings, walking_labels
from perception.adaptation.learning import AdaptationParameters, Scenery, joined, rendered_people, thinned
from perception.detection.boxes import PersonBox
from perception.evaluation.adapted_cameras import sequences_of
from perception.images.frames import Frame
from perception.synthetic import inserted
from perception.synthetic.clips import FPS, pasted_street
from perception.synthetic.inserted import Place, with_person


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


def test_rendered_people_help_where_few_walk() -> None:
    rng = np.random.default_rng(3)
    weight = rng.normal(size=(40, 2))

    def looks(angle: np.ndarray, noise: float) -> np.ndarray:
        even, odd = np.cos(angle)[:, None] * weight[:, 0], np.sin(angle)[:, None] * weight[:, 1]
        values = np.hstack([even, odd])
        return (values + noise * rng.normal(size=values.shape)).astype(np.float32)

    sign = np.repeat([1.0, -1.0], 40).astype(np.float32)
    person = np.repeat(np.arange(6), 5)
    angle = np.repeat(rng.uniform(-np.pi, np.pi, 6), 5)
    of_person = np.repeat(rng.normal(0.0, 2.0, (6, 80)), 5, axis=0)
    features = (looks(angle, 0.3) + of_person).astype(np.float32)
    many = rng.uniform(-np.pi, np.pi, 300)
    fold = folds_of(person, rng)
    alone = fit_directions(features, sign, angle, person, fold)[1].loss(angle)
    helped = fit_directions(features, sign, angle, person, fold, (looks(many, 1.0), many))[1].loss(angle)
    assert helped <= alone + 1e-9


def test_people_are_rendered_where_the_camera_saw_people_walk() -> None:
    rng = np.random.default_rng(4)
    camera = GroundCamera.from_scale(0.02)
    walkers = [PersonBox(k, 1, (40.0 + 5.0 * k, 60.0, 16.0, 40.0)) for k in range(12)]
    scenery = Scenery(walkers, walkers, None, camera)
    # The background is distinguished from a walking person, who moves in every frame.
    behind = rng.integers(60, 200, (160, 160, 3), np.uint8)
    shown = []
    for item in walkers:
        image = behind.copy()
        first, upper, across, down = (int(value) for value in item.box)
        image[upper : upper + down, first : first + across // 4] = 255
        shown.append(Frame(item.frame, image))
    assert [frame.number for frame in scenery.watched(shown)] == sorted(scenery.frames)
    places = scenery.positions(rng)
    assert len(places) == len(walkers)
    for place, item in zip(places, walkers, strict=True):
        _, top, width, height = place.box
        assert (width, height) == pytest.approx(item.box[2:], abs=1.0)
        assert top / len(place.image) == pytest.approx(ABOVE / ROWS)
        np.testing.assert_array_equal(place.image, surroundings(behind, item.box))
    people = rendered_people(places, rng, 40)
    assert len(people.patches) == len(people.angle) == 40
    assert all(patch.shape == (ROWS, COLUMNS, 3) for patch in people.patches)
    # Heads are near the box's top: the middle of a person of 1.75 m is a tenth below it.
    assert np.abs(np.median(people.head, axis=0) - (0.0, 0.09)).max() < 0.05
    empty = as_patch(places[0].image)
    inside = slice(ABOVE, ABOVE + TALL), slice(COLUMNS // 2 - 30, COLUMNS // 2 + 30)
    changed = np.abs(people.patches[0][inside].astype(float) - empty[inside]).mean()
    assert changed > 5.0


def test_rendered_people_look_where_they_are_said_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """Facing the camera shows a face, facing away hair: skin is redder than hair on average."""
    rng = np.random.default_rng(5)
    place = Place(np.full((224, 160, 3), 120, np.uint8), (48.0, 32.0, 64.0, 160.0), 0.2, 8.0)
    for name in ("_SCALE", "_BLUR", "_NOISE"):
        monkeypatch.setattr(inserted, name, 0.0)
    red = []
    for angle in (0.0, np.pi):
        found = []
        for _ in range(40):
            picture, head = with_person(place, angle, rng)
            across, down = np.rint(head).astype(int)
            part = picture[down - 2 : down + 6, across - 4 : across + 4].astype(float)
            found.append(part[..., 2].mean() - part[..., 0].mean())
        red.append(np.mean(found))
    assert red[0] > red[1] + 5.0


def test_people_of_few_kinds_move_with_those_they_help() -> None:
    """Rendered people are shifted to the real ones direction by direction, not to their mean."""
    rng = np.random.default_rng(6)
    sign = np.ones(3, np.float32)
    angle = rng.uniform(-np.pi, np.pi, 4000)
    label = CLASSES.index(angle)

    def looks(whose: np.ndarray) -> np.ndarray:
        clean = np.column_stack([np.cos(whose), np.cos(2.0 * whose), np.zeros(len(whose))])
        return (clean + 0.1 * rng.normal(size=clean.shape)).astype(np.float32)

    off = np.array([3.0, -2.0, 1.0], np.float32)
    real = np.full(20, np.pi)  # all people face away
    few = Sums.of(looks(real) + off, sign, CLASSES.index(real), np.arange(20))
    many = Sums.of(looks(angle), sign, label, np.arange(len(angle)))
    helped = few.helped(many, 3.0)
    alone = Sums.of(looks(angle) + off, sign, label, np.arange(len(angle)))
    for k in range(len(CLASSES)):
        found, expected = helped.total[k] / helped.weight[k], alone.total[k] / alone.weight[k]
        np.testing.assert_allclose(found, expected, atol=0.15)
    assert helped.weight.sum() == pytest.approx(4.0 * few.weight.sum())
    np.testing.assert_allclose(few.helped(many, 0.0).total, few.total)


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
