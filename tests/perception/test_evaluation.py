"""The tables: rates, clips with their truth, and the command that prints them."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import ran, run

from graphtrack.geometry.angles import class_centres, difference
from graphtrack.model import Model
from perception.drawing.overlays import Cues, draw_cues
from perception.evaluation.classifiers import class_rates
from perception.experiments.chen_pixels import LEAST_FRAMES, METHODS, ObservedPerson, joint_scores, people_of
from perception.models import load_classifier, load_head_localiser
from perception.observation.pipeline import Models
from perception.synthetic.clips import Clip, walking_clip


def test_rates_are_those_of_counting() -> None:
    rng = np.random.default_rng(0)
    true, said = rng.integers(0, 3, 200), rng.integers(0, 3, 200)
    confusion = np.zeros((3, 3), np.int64)
    np.add.at(confusion, (true, said), 1)
    hits, false_alarms = class_rates(confusion)
    for k in range(3):
        assert hits[k] == pytest.approx(np.mean(said[true == k] == k))
        assert false_alarms[k] == pytest.approx(np.mean(said[true != k] == k))


@pytest.fixture(scope="module")
def clip() -> Clip:
    return walking_clip(np.random.default_rng(2), people=2, steps=5)


@pytest.fixture(scope="module")
def people(clip: Clip) -> list[ObservedPerson]:
    models = Models(load_head_localiser(), load_classifier("body_pose"), load_classifier("deep_belief"))
    return people_of(clip, models)


@pytest.mark.slow
def test_joint_estimates_are_nearer_to_the_truth_than_single_frames(
    clip: Clip, people: list[ObservedPerson]
) -> None:
    found = joint_scores("clip", people)
    assert found.mean("joint", "smoother", "body") < 0.8 * found.mean("observation", "", "body")
    # Every online method has Chen et al.'s three models in addition to the paper's own filter.
    for method in ("particle", "particle, eq. 12–14", "graph, chain", "graph, isam2"):
        assert METHODS[method].group == "online"
        assert {
            (model, method, "head") for model in ("separate", "joint-body", "joint")
        } <= found.errors.keys()
    lengths = np.bincount([box.track_id for box in clip.boxes])
    assert found.people == np.count_nonzero(lengths >= LEAST_FRAMES)


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_online_estimates_alone_do_not_know_what_comes_after(name: str, people: list[ObservedPerson]) -> None:
    person, method = people[0], METHODS[name]
    cut = replace(person, causal=person.causal[:3], image=person.image[:3], offline=person.offline[:3])
    first, all_of_it = (method.estimate(one, Model("joint"), 7) for one in (cut, person))
    apart = [
        np.abs(getattr(first, angle) - getattr(all_of_it, angle)[:3]).max() for angle in ("body", "head")
    ]
    assert (max(apart) < 1e-9) == (method.group == "online")


@pytest.mark.slow
def test_likelihoods_in_the_image_are_those_of_the_world_turned_back(people: list[ObservedPerson]) -> None:
    for person in people:
        for angle in ("body", "head"):
            image, world = (getattr(track, f"{angle}_likelihood") for track in (person.image, person.causal))
            centres = class_centres(image.shape[1])
            found = person.camera.world_angle(centres[image.argmax(axis=1)], person.causal.position)
            # Half a class of each: a maximum may change over in the interpolation, seldom by more.
            apart = np.abs(difference(found, centres[world.argmax(axis=1)]))
            assert np.median(apart) <= 2.0 * np.pi / image.shape[1]


def test_arrows_point_where_they_should(clip: Clip, people: list[ObservedPerson]) -> None:
    person = people[0]
    pictures = []
    for angle in (0.0, np.pi):
        cues = Cues(
            person.boxes[0],
            person.head_boxes[0],
            person.causal.position[0],
            visible=np.zeros(2),
            estimated=np.full(2, angle),
        )
        pictures.append(draw_cues(clip.images[0], cues, person.camera))
    assert pictures[0].shape == (320, 240, 3)
    # World +x is the image's right here: where only the arrows differ, one is right, the other left.
    changed = np.nonzero((pictures[0].astype(int) - pictures[1]).any(axis=2))
    red = [(np.asarray(p)[changed] == (60, 60, 235)).all(axis=1) for p in pictures]
    assert changed[1][red[0]].mean() > 120.0 > changed[1][red[1]].mean()


@pytest.mark.slow
def test_the_pose_table_and_its_picture(tmp_path: Path) -> None:
    written = tmp_path / "t.json"
    done = ran("evaluate", "pose", "--count", 50, "--plot", tmp_path / "p.png", "--json", written)
    for text in ("templates", "exemplars", "deep_belief", "body_pose"):
        assert text in done.stdout
    assert cv2.imread(str(tmp_path / "p.png")) is not None
    (errors,) = json.loads(written.read_text(encoding="utf-8"))
    assert {row[0] for row in errors["rows"]} == {"templates", "exemplars", "deep_belief", "body_pose"}
    assert errors["columns"][2] == "mean_error_deg"


def test_wrong_tables_are_refused(tmp_path: Path) -> None:
    assert run("evaluate", "other").returncode == 2
    assert run("evaluate", "localisation", "--plot", tmp_path / "p.png").returncode == 2


@pytest.mark.slow
def test_the_forms_as_printed_stand_beside_ours() -> None:
    done = ran("evaluate", "published", "--train", 200, "--count", 50)
    for text in ("body_pose: ours", "templates: ours", "head_localiser: ours"):
        assert text in done.stdout
    assert done.stdout.count("as printed") >= 4


def test_only_models_of_the_paper_are_trained_as_published(tmp_path: Path) -> None:
    done = run("train", "deep_belief", "--as-published", "-o", tmp_path / "m.npz")
    assert done.returncode == 2 and "as published" in done.stderr and not list(tmp_path.iterdir())
