"""Every classifier through the same battery."""

import sys
from collections.abc import Callable
from copy import copy
from pathlib import Path

import numpy as np
import pytest
from selection import others_slow

from graphtrack.errors import InputError
from perception.models import load_classifier
from perception.pose.classes import PoseClasses
from perception.pose.classifier import FeatureClassifier, evaluate, fit_temperature_and_share, with_neighbours
from perception.pose.deep_belief import DeepBelief
from perception.pose.exemplars import CENTRE_STEP, DEVIATION_STEP, Exemplars
from perception.pose.features import SkinColours
from perception.pose.templates import Templates
from perception.storage import ModelCard, load_model, save_model
from perception.synthetic import HeadSet, HeadVariation, make_heads

Heads = tuple[HeadSet, HeadSet]
EIGHT = PoseClasses.circle(8)
LARGE = HeadVariation(size=(32, 32), tilt_deviation=0.1, offset=0.01, scale=0.02)


@pytest.fixture(scope="module")
def heads() -> Heads:
    return make_heads(320, np.random.default_rng(1), LARGE), make_heads(100, np.random.default_rng(2), LARGE)


def skin_of(heads: HeadSet) -> SkinColours:
    return SkinColours.fit(heads.images, heads.skin)


BUILDERS: dict[str, tuple[Callable[[HeadSet], FeatureClassifier], float]] = {
    "templates": (lambda heads: Templates(EIGHT, skin=skin_of(heads)), 35.0),
    "templates without skin": (lambda heads: Templates(EIGHT), 50.0),
    "templates, fisher": (lambda heads: Templates(EIGHT, skin=skin_of(heads), metric="fisher"), 35.0),
    "exemplars": (lambda heads: Exemplars(EIGHT, exemplars=3), 50.0),
    "exemplars, weighed filters": (lambda heads: Exemplars(EIGHT, exemplars=3, weigh_filters=True), 50.0),
    "exemplars, gaussian": (lambda heads: Exemplars(EIGHT, exemplars=3, density="gaussian"), 50.0),
}


@pytest.fixture(
    scope="module",
    params=others_slow(BUILDERS, ["templates", "templates, fisher", "exemplars, weighed filters"]),
)
def fitted(request: pytest.FixtureRequest, heads: Heads) -> tuple[FeatureClassifier, float]:
    build, error = BUILDERS[request.param]
    model = build(heads[0])
    return model.fit(heads[0].images, EIGHT.index(heads[0].pan)), error


Fitted = tuple[FeatureClassifier, float]


@pytest.mark.slow
def test_it_learns(fitted: Fitted, heads: Heads) -> None:
    scores = evaluate(fitted[0], heads[1].images, heads[1].pan)
    assert scores.mean_error < fitted[1]  # by chance: 90°
    assert scores.confusion.sum() == len(heads[1])
    assert scores.accuracy <= scores.within_one


@pytest.mark.slow
def test_likelihoods_are_normalised(fitted: Fitted, heads: Heads) -> None:
    images = heads[1].images[:5]
    found = fitted[0].log_likelihoods(images)
    assert found.shape == (5, 8)
    np.testing.assert_allclose(np.exp(found).sum(axis=1), 1.0)
    np.testing.assert_allclose([fitted[0].log_likelihood(image) for image in images], found, atol=1e-3)
    assert fitted[0].log_likelihoods([]).shape == (0, 8)
    assert np.isfinite(fitted[0].log_likelihood(images[0][..., 1].copy())).all()  # grey


@pytest.mark.slow
def test_a_saved_model_says_the_same(fitted: Fitted, heads: Heads, tmp_path: Path) -> None:
    model, path = fitted[0], tmp_path / "model.npz"
    model.save(path)
    again = type(model).load(path)
    images = heads[1].images[:20]
    np.testing.assert_allclose(again.log_likelihoods(images), model.log_likelihoods(images), atol=0.05)
    assert again.classes == model.classes
    assert again.card.figures == model.card.figures and again.card.images == 320


def test_calibration_on_other_images_makes_up_for_scores_of_another_scale(
    fitted: Fitted, heads: Heads
) -> None:
    model, before = copy(fitted[0]), fitted[0].temperature
    model.temperature = 20.0 * before
    model.calibrate(heads[1].images, heads[1].pan)
    honest = evaluate(model, heads[1].images, heads[1].pan).reliability.expected_calibration_error
    assert before / 4.0 < model.temperature < 4.0 * before and honest < 0.15


def test_wrong_labels_are_refused() -> None:
    images = [np.zeros((8, 8, 3), np.uint8)] * 4
    for labels in ([0, 1], [0, 0, 1, 2], [0.0, 0.0, 1.0, 1.0], [0, 0, 0, 1]):
        with pytest.raises(InputError):
            Templates(PoseClasses.circle(2)).fit(images, labels)


def test_wrong_settings_are_refused() -> None:
    for kind, setting in (
        (Exemplars, {"density": "flat"}),
        (Exemplars, {"exemplars": 0}),
        (Templates, {"metric": "x"}),
    ):
        with pytest.raises(InputError):
            kind(**setting)


def test_other_files_are_no_models(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    for write in (
        lambda: None,
        lambda: path.write_bytes(b"hello"),
        lambda: np.savez(path, a=np.zeros(3)),
        lambda: np.savez(path, card=np.array([{"kind": "x"}], dtype=object), allow_pickle=True),  # a pickle
    ):
        write()
        with pytest.raises(InputError):
            load_model(path)
    save_model(path, ModelCard("exemplars"), {"a": np.zeros(2)})
    assert load_model(path)[1]["a"].shape == (2,)
    for kind in (Templates, Exemplars):
        with pytest.raises(InputError):
            kind.load(path)


def test_the_saturated_density_is_equation_5() -> None:
    rng = np.random.default_rng(0)
    model = Exemplars(PoseClasses.circle(2), exemplars=2)
    features, labels = rng.normal(0.0, 1.0, (20, 764)), np.repeat([0, 1], 10)
    model.fit_features(features, labels, rng)
    stored = model.arrays()
    z = rng.normal(0.0, 3.0, 764)
    centre, deviation = stored["centre"] * CENTRE_STEP, stored["deviation"] * DEVIATION_STEP
    with np.errstate(divide="ignore"):
        terms = np.maximum(np.exp(-0.5 * ((z - centre) / deviation) ** 2), np.exp(-3.0)) / deviation
        by_exemplar = np.log(terms).sum(axis=2) + stored["log_weight"]
    expected = np.logaddexp.reduce(by_exemplar, axis=1)
    np.testing.assert_allclose(model.scores(z[None])[0], expected, rtol=2e-3)


def test_temperature_and_share_recover_known_ones() -> None:
    rng = np.random.default_rng(0)
    logits = rng.normal(0.0, 3.0, (6000, 8))
    p = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    spread = with_neighbours(p, 0.12)
    np.testing.assert_allclose(spread.sum(axis=1), 1.0)
    np.testing.assert_allclose(with_neighbours(np.eye(8)[0], 0.12)[[0, 1, 4, 7]], [0.76, 0.12, 0.0, 0.12])
    labels = (rng.random(6000)[:, None] > spread.cumsum(axis=1)).sum(axis=1)
    temperature, share = fit_temperature_and_share(4.0 * logits, labels)
    assert temperature == pytest.approx(4.0, rel=0.1) and share == pytest.approx(0.12, abs=0.02)


def test_classes_agree_with_the_observation_table() -> None:
    classes = PoseClasses.circle(12, 3)
    np.testing.assert_allclose(np.rad2deg(classes.pan[[0, 3, 6, 9]]), [0.0, 90.0, 180.0, -90.0], atol=1e-9)
    assert classes.index(np.deg2rad([44.0, -16.0]), np.deg2rad([40.0, -40.0])).tolist() == [25, 11]
    log_likelihood = np.log(np.full((1, 36), 1.0 / 36.0))
    np.testing.assert_allclose(np.exp(classes.pan_log_likelihood(log_likelihood)), 1.0 / 12.0)
    np.testing.assert_allclose(np.rad2deg(PoseClasses.half_circle().pan), np.arange(-90.0, 91.0, 22.5))


SMALL = {"units": (40, 20), "epochs": 6, "pretraining_epochs": 1}


@pytest.fixture(scope="module")
def network(heads: Heads) -> DeepBelief:
    pytest.importorskip("torch", reason="PyTorch trains the deep belief network; pip install -e '.[train]'")
    return DeepBelief(**SMALL).fit(heads[0].images, EIGHT.index(heads[0].pan))


def test_the_network_learns_and_its_file_says_the_same(
    network: DeepBelief, heads: Heads, tmp_path: Path
) -> None:
    assert evaluate(network, heads[1].images, heads[1].pan).mean_error < 60.0  # by chance: 90°
    network.save(tmp_path / "network.npz")
    again = DeepBelief.load(tmp_path / "network.npz")
    found = network.log_likelihoods(heads[1].images)
    np.testing.assert_allclose(again.log_likelihoods(heads[1].images), found, atol=0.1)
    np.testing.assert_allclose(np.exp(found).sum(axis=1), 1.0)


def test_the_network_is_the_same_for_the_same_seed_and_leaves_other_numbers_alone(
    network: DeepBelief, heads: Heads
) -> None:
    import torch

    torch.manual_seed(3)
    expected = torch.rand(1).item()
    torch.manual_seed(3)
    again = DeepBelief(**SMALL).fit(heads[0].images, EIGHT.index(heads[0].pan))
    assert torch.rand(1).item() == expected
    images = heads[1].images[:10]
    np.testing.assert_allclose(again.log_likelihoods(images), network.log_likelihoods(images), atol=1e-4)


def test_pretraining_makes_a_boltzmann_machine_that_remembers(heads: Heads) -> None:
    torch = pytest.importorskip("torch")
    from perception.pose.deep_belief_training import boltzmann_machine

    pixels = DeepBelief().features(heads[0].images)
    seen = torch.from_numpy(((pixels - pixels.mean(axis=0)) / pixels.std()).astype(np.float32))

    def forgotten(epochs: int) -> float:
        torch.manual_seed(0)
        machine = boltzmann_machine(seen, 100, epochs)
        again = torch.relu(seen @ machine.weight + machine.hidden) @ machine.weight.T + machine.visible
        return float(((again - seen) ** 2).mean() / (seen**2).mean())

    assert forgotten(15) < 0.6 < 0.9 * forgotten(0)


def test_without_pytorch_training_is_refused_in_one_line(
    monkeypatch: pytest.MonkeyPatch, heads: Heads
) -> None:
    monkeypatch.setitem(sys.modules, "perception.pose.deep_belief_training", None)
    with pytest.raises(InputError, match=r"PyTorch"):
        DeepBelief().fit(heads[0].images, EIGHT.index(heads[0].pan))


@pytest.mark.slow
def test_the_network_of_the_package_meets_its_bars() -> None:
    made = make_heads(200, np.random.default_rng(99))
    scores = evaluate(load_classifier("deep_belief"), made.images, made.pan)
    assert scores.accuracy > 0.75 and scores.within_one > 0.94
    assert scores.reliability.expected_calibration_error < 0.09  # of 200 images; noise alone gives about 0.04


def test_mirror_images_have_the_mirrored_classes() -> None:
    for classes in (EIGHT, PoseClasses.circle(12, 3), PoseClasses.half_circle()):
        every = np.arange(len(classes))
        level = every // classes.n_pan
        tilt = np.array([0.0])[level] if classes.n_tilt == 1 else np.array([-0.8, 0.0, 0.8])[level]
        expected = classes.index(-classes.pan[every % classes.n_pan], tilt)
        np.testing.assert_array_equal(classes.reflected(every), expected)
