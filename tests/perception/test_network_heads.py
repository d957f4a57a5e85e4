"""Heads by the network: splits of its last layer, heads of CAVIAR's frames, and known poses."""

from pathlib import Path

import numpy as np
import pytest

from graphtrack.experiments import Settings
from graphtrack.geometry.angles import class_centres, difference
from graphtrack.io.formats.caviar import LOBBY_HEIGHT, lobby_camera
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks.track import Track
from perception.evaluation.classifiers import class_rates, softmax_layer, split_scores
from perception.experiments.baxter_network import (
    EXPERIMENT,
    PersonWithHeads,
    head_size,
    network_heads,
    people_with_heads,
    upright_head,
)
from perception.experiments.chen_pixels import classified
from perception.experiments.street_heads import APART, BEFORE, FEWEST, HIDDEN, street_people, windows
from perception.models import load_classifier
from perception.pose.classes import PoseClasses
from perception.pose.deep_belief import DeepBelief
from perception.synthetic import make_heads


def network() -> DeepBelief:
    model = load_classifier("deep_belief")
    assert isinstance(model, DeepBelief)
    return model


def test_a_last_layer_of_two_classes_never_says_a_third() -> None:
    rng = np.random.default_rng(0)
    labels = 2 * rng.integers(0, 2, 200)
    inputs = rng.normal(size=(200, 4)) + 3.0 * np.eye(3, 4)[labels]
    weight, bias = softmax_layer(inputs, labels, 3, penalty=0.01)
    found = (inputs @ weight + bias).argmax(axis=1)
    assert np.mean(found == labels) > 0.95 and 1 not in found


def test_no_person_is_learned_from_and_judged() -> None:
    heads = make_heads(48, np.random.default_rng(0))
    # Each person has a distinct direction, and no two are reflections: no person predicts another.
    who = np.repeat(np.arange(4), 12)
    pan = np.deg2rad(45.0) * who
    options = {"share": 0.5, "repetitions": 2}
    apart = split_scores(network(), heads.images, pan, rng=np.random.default_rng(1), groups=who, **options)
    assert apart.rates.max() == 0.0 and apart.confusion.sum() == 2 * 24
    judged = split_scores(network(), heads.images, heads.pan, rng=np.random.default_rng(1), **options)
    assert judged.rates.mean() > 0.25  # by chance: 0.125
    hits, false_alarms = class_rates(judged.confusion)
    assert np.nanmin(hits) >= 0.0 and np.nanmax(false_alarms) < 0.5


def test_a_head_is_as_large_as_the_camera_has_it() -> None:
    camera = lobby_camera()
    centre = np.asarray(camera.optical_centre_on_ground)
    factor = LOBBY_HEIGHT / (LOBBY_HEIGHT - 1.6)
    for pixel in ([87.0, 111.0], [70.0, 210.0], [200.0, 150.0]):
        # A horizontal span of 27 cm across the ray at 1.6 m: on the ground it is enlarged about the camera.
        behind = camera.image_to_ground(pixel)
        away = behind - centre
        across = np.array([-away[1], away[0]]) / np.linalg.norm(away)
        ends = [behind + factor * side * 0.135 * across for side in (-1.0, 1.0)]
        span = np.linalg.norm(np.subtract(*(camera.ground_to_image(end) for end in ends)))
        assert head_size(np.array(pixel), camera) == pytest.approx(span, rel=0.2)


def test_an_upright_head_has_the_feet_below() -> None:
    image = np.zeros((288, 384, 3), np.uint8)
    head, foot = np.array([180.0, 150.0]), np.array([230.0, 190.0])
    toward = (foot - head) / np.linalg.norm(foot - head)
    side = head_size(head, lobby_camera())
    for share in np.linspace(0.15, 0.6, 10):  # bright from the head towards the feet
        u, v = np.round(head + share * side * toward).astype(int)
        image[v, u] = 255
    shown = upright_head(image, head, foot, lobby_camera())[:, :, 0].astype(float)
    rows, columns = np.nonzero(shown > 60)
    assert rows.mean() > 18.0 and abs(columns.mean() - 16.0) < 3.0


@pytest.fixture(scope="module")
def people(data_dir) -> list[PersonWithHeads]:
    found = people_with_heads(data_dir / "caviar")
    if not found:
        pytest.skip("no frames of CAVIAR")
    return found


@pytest.mark.slow
def test_heads_of_caviar_stand_for_the_labelled_ones(people: list[PersonWithHeads]) -> None:
    for person in people:
        assert len(person.images) == len(person.track) == len(person.pan) >= 20
        assert 3.0 < person.size.min() <= person.size.max() < 12.0
        assert all(image.shape == (32, 32, 3) for image in person.images)
        said = network_heads(network(), person)
        assert np.isfinite(said.head).all() and not np.allclose(said.head, person.track.head)
        np.testing.assert_array_equal(said.position, person.track.position)


@pytest.mark.slow
def test_the_experiment_without_recordings_has_the_splits_alone() -> None:
    found = EXPERIMENT.run(Settings(quick=True), lambda count: None)
    assert [row["split"] for row in found.tables[0].records()] == ["80:20", "50:50"]
    assert any("not found" in note for note in found.notes)


def test_a_window_hides_all_positions_that_follow_and_its_heads_are_seen_from_the_last_one() -> None:
    camera, n = lobby_camera(), 18
    position = np.column_stack([1.0 + 0.3 * np.arange(n), 2.0 + 0.1 * np.arange(n)])
    track = Track(1, np.arange(n), 0.4 * np.arange(n), position, true_position=position)
    pan = np.linspace(-1.0, 2.0, n)
    found = windows(track, pan, camera)
    assert len(found) == len(range(BEFORE, n - HIDDEN + 1, APART))
    for part, window in found:
        begin = len(part) - HIDDEN
        np.testing.assert_array_equal(np.flatnonzero(window), np.arange(begin, begin + HIDDEN))
        np.testing.assert_array_equal(np.isnan(part.position).all(axis=1), window)
        np.testing.assert_allclose(part.true_position, position[: len(part)])
        assert part.head is not None
        before = camera.world_angle(pan[:begin], position[:begin])
        np.testing.assert_allclose(part.head[:begin], before)
        held = np.repeat(position[begin - 1 : begin], HIDDEN, axis=0)
        np.testing.assert_allclose(part.head[begin:], camera.world_angle(pan[begin : len(part)], held))


@pytest.mark.slow
def test_people_of_the_street_are_those_of_its_pictures(data_dir: Path) -> None:
    folder = data_dir / "towncentre"
    if not (folder / "boxes.csv").is_file():
        pytest.skip("no Town Centre among the recordings")
    people, _ = street_people(folder)
    assert len(people) > 40
    for person in people:
        track = person.track
        assert len(track) == len(person.images) == len(person.size) >= FEWEST
        np.testing.assert_array_equal(np.diff(track.frame), 1)
        assert track.frame[0] >= 1 and track.frame[-1] <= 150 and track.t[-1] < 60.0
        speed = np.linalg.norm(np.diff(track.position, axis=0), axis=1) / np.diff(track.t)
        assert np.median(speed) < 3.0
    sizes = np.concatenate([person.size for person in people])
    assert 15.0 < np.median(sizes) < 35.0


class Sure:
    """A classifier that returns given classes, in the order of calls."""

    def __init__(self, classes: PoseClasses, labels: np.ndarray) -> None:
        self.classes, self.labels = classes, labels

    def log_likelihoods(self, images: list) -> np.ndarray:
        found = np.full((len(images), len(self.classes)), -50.0)
        found[np.arange(len(images)), self.labels] = 0.0
        return found


def test_right_answers_of_the_image_are_right_in_the_world() -> None:
    (track,) = simulate("joint", n_tracks=1, n_steps=6, rng=np.random.default_rng(0))
    bodies, heads = PoseClasses.circle(8), PoseClasses.circle(12, 3)
    ray = np.random.default_rng(1).uniform(-np.pi, np.pi)  # the first number that is drawn
    body = Sure(bodies, bodies.index(track.true_body - ray))
    head = Sure(heads, heads.index(track.true_head - ray, np.full(6, -1.0)))
    seen = classified(track, body, head, np.random.default_rng(1))  # type: ignore[arg-type]
    for angle, count in (("body", 8), ("head", 12)):
        likelihood = getattr(seen, f"{angle}_likelihood")
        np.testing.assert_allclose(likelihood.sum(axis=1), 1.0)
        said = class_centres(count)[likelihood.argmax(axis=1)]
        # Half a class of the image, and half a one of the world.
        assert np.abs(difference(said, getattr(track, f"true_{angle}"))).max() < 2.1 * np.pi / count
        assert getattr(seen, angle) is None
