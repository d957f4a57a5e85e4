"""Simulated classifiers: frequencies of answers, and likelihoods that are those of the truth."""

from dataclasses import replace

import numpy as np
import pytest
from walks import walk

from graphtrack.errors import InputError
from graphtrack.geometry.angles import class_centres
from graphtrack.simulation.degrade import add_class_likelihoods, confusion_matrix
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES


def test_answers_come_as_often_as_the_confusion_says() -> None:
    rng = np.random.default_rng(0)
    track = walk(20_000, seed=3)
    (seen,) = add_class_likelihoods(track, rng=rng)
    for name, n in (("body", BODY_CLASSES), ("head", HEAD_CLASSES)):
        truth, likelihood = getattr(seen, f"true_{name}"), getattr(seen, f"{name}_likelihood")
        assert getattr(seen, name) is None
        true_class = np.argmax(np.cos(truth[:, None] - class_centres(n)), axis=1)
        expected = confusion_matrix(n)
        # Each answer has a column of its own, whose greatest entry is the answer itself.
        answer = likelihood.argmax(axis=1)
        for k in np.flatnonzero(np.bincount(true_class, minlength=n) > 1000):
            share = np.bincount(answer[true_class == k], minlength=n) / (true_class == k).sum()
            np.testing.assert_allclose(share, expected[k], atol=0.04)
        np.testing.assert_allclose(likelihood, expected[:, answer].T)


def test_what_is_not_known_is_not_seen() -> None:
    track = walk(5)
    truth = np.array(track.true_body)
    truth[2] = np.nan
    (seen,) = add_class_likelihoods(replace(track, true_body=truth), rng=np.random.default_rng(0))
    assert np.isnan(seen.body_likelihood[2]).all()
    assert np.isfinite(seen.body_likelihood[[0, 1, 3, 4]]).all()


@pytest.mark.parametrize(
    ("body", "said"), [(np.eye(12), r"shape \(12, 12\)"), (np.ones((8, 8)), "rows that sum to 1")]
)
def test_a_matrix_that_is_no_confusion_is_refused(body: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        add_class_likelihoods(walk(3), body=body, rng=np.random.default_rng(0))


@pytest.mark.parametrize("shares", [{"flipped": 0.8, "at_random": 0.3}, {"flipped": -0.1}])
def test_shares_that_are_none_are_refused(shares: dict[str, float]) -> None:
    with pytest.raises(InputError, match="at most 1 together"):
        confusion_matrix(8, **shares)
    with pytest.raises(InputError, match="7 classes"):
        confusion_matrix(7)
