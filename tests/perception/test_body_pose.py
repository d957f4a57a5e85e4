"""Sparse representation against scikit-learn, and body pose on rendered people."""

import numpy as np
import pytest
from sklearn.decomposition import sparse_encode

from perception.pose.body import BodyPose
from perception.pose.classifier import evaluate
from perception.pose.features import fisher_projection, sparse_weights
from perception.synthetic import PedestrianSet, PedestrianVariation, make_pedestrians

EASY = PedestrianVariation(size=(64, 80), occluded=0.0, elevation=(0.0, 0.1), offset=0.01, scale=0.02)


def test_sparse_weights_are_those_of_coordinate_descent() -> None:
    rng = np.random.default_rng(0)
    dictionary = rng.normal(size=(12, 20))
    dictionary /= np.linalg.norm(dictionary, axis=1, keepdims=True)
    samples = np.abs(rng.normal(size=(5, 12))) @ dictionary
    expected = sparse_encode(
        samples, dictionary, algorithm="lasso_cd", alpha=0.3, positive=True, max_iter=5000
    )
    found = sparse_weights(samples, dictionary, 0.3, iterations=2000)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert (found >= 0.0).all()


def test_the_projection_finds_what_separates_and_makes_the_rest_unit() -> None:
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 3, 6000)
    features = rng.normal(size=(6000, 5)) * (1.0, 9.0, 1.0, 1.0, 1.0)
    features[:, 2] += 4.0 * labels
    projection = fisher_projection(features, labels)
    assert projection.shape == (5, 2)
    direction = projection[:, 0] / np.linalg.norm(projection[:, 0])
    assert abs(direction[2]) > 0.99


@pytest.fixture(scope="module")
def learned_from() -> PedestrianSet:
    return make_pedestrians(160, np.random.default_rng(1), EASY)


@pytest.fixture(scope="module")
def fitted(learned_from: PedestrianSet) -> BodyPose:
    people = learned_from
    model = BodyPose(samples=15)
    return model.fit(people.images, model.classes.index(people.body))


@pytest.mark.slow
def test_it_learns_the_direction_of_the_body(fitted: BodyPose) -> None:
    people = make_pedestrians(40, np.random.default_rng(2), EASY)
    scores = evaluate(fitted, people.images, people.body)
    assert scores.mean_error < 60.0  # by chance: 90°
    found = fitted.log_likelihoods(people.images)
    np.testing.assert_allclose(np.exp(found).sum(axis=1), 1.0)


@pytest.mark.slow
def test_as_published_it_is_the_normalised_weight_of_the_classes_of_the_hog_itself(
    learned_from: PedestrianSet,
) -> None:
    people = learned_from
    model = BodyPose.as_published()
    model.samples = 15
    model.fit(people.images, model.classes.index(people.body))
    assert (model.temperature, model.neighbour_share) == (1.0, 0.0)
    model.calibrate(people.images, people.body)
    assert (model.temperature, model.neighbour_share) == (1.0, 0.0)
    image = people.images[0]
    hog = model.features([image])
    hog /= np.linalg.norm(hog)
    dictionary, label = model.arrays()["dictionary"].astype(float), model.arrays()["label"]
    assert dictionary.shape == (len(label), hog.shape[1])
    weights = sparse_encode(
        hog, dictionary, algorithm="lasso_cd", alpha=model.penalty, positive=True, max_iter=5000
    )[0]
    of_class = np.array([weights[label == k].sum() for k in range(8)])
    found = np.exp(model.log_likelihood(image))
    np.testing.assert_allclose(found, of_class / of_class.sum(), atol=0.02)
    assert found.min() < 1e-6  # there is no floor
