"""Boosting and head localisation against brute force, and on rendered people."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from graphtrack.errors import InputError
from perception.evaluation.localisation import NATURAL, WEAK, Located, localisation_tables
from perception.images.pixels import intersection_over_union
from perception.models import load_head_localiser
from perception.pose.boosting import BoostedBlocks, Quantised, Weak, reweighted
from perception.pose.features import block_corners, block_histograms, corner_sums, integral_histogram
from perception.pose.head_detection import (
    HeadCandidates,
    HeadLocaliser,
    candidate_windows,
    select_along_track,
    select_so_far,
)
from perception.synthetic import PedestrianSet, PedestrianVariation, make_pedestrians

People = tuple[PedestrianSet, PedestrianSet]
EASY = PedestrianVariation(size=(80, 110), occluded=0.0)


def test_block_histograms_are_sums_over_the_pixels() -> None:
    rng = np.random.default_rng(0)
    grey = rng.integers(0, 40, (48, 60)).astype(np.uint8)
    integral = integral_histogram(grey)
    votes = np.diff(np.diff(integral[..., :9], axis=0), axis=1)
    corners = corner_sums(integral, np.array([[6.0, 3.0, 36.0, 42.0]]))
    found = block_histograms(corners)[0]
    for k in rng.integers(0, 441, 10):
        top, bottom, left, right = block_corners()[k]
        inside = votes[3 + 7 * top : 3 + 7 * bottom, 6 + 6 * left : 6 + 6 * right].sum(axis=(0, 1))
        np.testing.assert_allclose(found[k], inside / (inside.sum() + 1.0), atol=1e-3)


def test_the_best_stump_is_that_of_brute_force() -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(80, 6)).astype(np.float32)
    labels = np.where(features[:, 3] + 0.5 * rng.normal(size=80) > 0.2, 1, -1)
    weights = rng.random(80)
    weights /= weights.sum()
    quantised = Quantised(features)
    stump, votes = quantised.best_stump(weights, labels)
    errors = [
        min(np.sum(weights[p * np.where(features[:, j] > t, 1, -1) != labels]) for p in (-1, 1))
        for j in range(6)
        for t in quantised.thresholds[:, j]
    ]
    error = np.sum(weights[votes != labels])
    assert error == pytest.approx(min(errors), abs=1e-9)
    assert stump.weight == pytest.approx(0.5 * np.log((1 - error) / error), rel=1e-3)
    expected = stump.polarity * np.where(features[:, stump.feature] > stump.threshold, 1, -1)
    np.testing.assert_array_equal(votes, expected)
    after = reweighted(weights, labels, votes, stump.weight)
    assert np.sum(after[votes != labels]) == pytest.approx(0.5, abs=1e-3)  # of no use in the next round


@pytest.mark.parametrize("weak", ["differential", "fisher"])
def test_scores_are_the_weighted_votes(weak: Weak) -> None:
    rng = np.random.default_rng(0)
    integral = integral_histogram(rng.integers(0, 40, (60, 60)).astype(np.uint8))
    windows = np.column_stack([rng.uniform(0, 20, (60, 2)), np.full((60, 2), 24.0)])
    corners = corner_sums(integral, windows)
    histograms = block_histograms(corners)
    labels = np.where(rng.random(60) < 0.5, 1, -1)
    model = BoostedBlocks.fit(histograms, labels, weak, rounds=12)
    values = np.einsum("ntb,tb->nt", histograms[:, model.block], model.direction)
    votes = np.where(values > model.threshold, 1.0, -1.0)
    expected = votes @ model.weight / model.weight.sum()
    # Thresholds are values of some windows: there rounding decides.
    clear = np.abs(values - model.threshold).min(axis=1) > 1e-5
    assert clear.sum() > 10
    np.testing.assert_allclose(model.scores(integral, windows)[clear], expected[clear], atol=1e-5)
    assert np.mean(np.sign(expected) == labels) > 0.8
    nonzero = np.count_nonzero(model.direction, axis=1)
    assert (nonzero == 2).all() if weak == "differential" else (nonzero > 2).all()


@pytest.fixture(scope="module")
def people() -> People:
    return make_pedestrians(40, np.random.default_rng(1), EASY), make_pedestrians(
        10, np.random.default_rng(2), EASY
    )


@pytest.fixture(scope="module")
def fitted(people: People) -> HeadLocaliser:
    return HeadLocaliser(rounds=40).fit(people[0].images, people[0].head_box)


def mean_overlap(model: HeadLocaliser, made: PedestrianSet) -> float:
    first = [model.locate(image).boxes[0] for image in made.images]
    return float(np.mean([intersection_over_union(f, b) for f, b in zip(first, made.head_box, strict=True)]))


@pytest.mark.slow
def test_it_finds_heads(fitted: HeadLocaliser, people: People) -> None:
    assert mean_overlap(fitted, people[1]) > 0.3  # of a window drawn at random: 0.12
    assert mean_overlap(load_head_localiser(), people[1]) > 0.6
    for image in people[1].images:
        found = fitted.locate(image)
        assert len(found.boxes) >= 1 and (np.diff(found.scores) <= 0).all()


@pytest.mark.slow
def test_a_saved_model_says_the_same(fitted: HeadLocaliser, people: People, tmp_path: Path) -> None:
    fitted.save(tmp_path / "heads.npz")
    again = HeadLocaliser.load(tmp_path / "heads.npz")
    for image in people[1].images[:3]:
        np.testing.assert_allclose(again.locate(image).boxes, fitted.locate(image).boxes)


def test_wrong_use_is_refused() -> None:
    with pytest.raises(InputError):
        HeadLocaliser().locate(np.zeros((20, 10), np.uint8))
    with pytest.raises(InputError):
        HeadLocaliser().fit([np.zeros((20, 10), np.uint8)], np.zeros((2, 4)))
    with pytest.raises(InputError):
        BoostedBlocks.fit(np.zeros((4, 441, 9), np.float32), np.ones(4, np.int64), "differential")


def drawn_candidates(count: int) -> list[HeadCandidates]:
    """Three candidates in each of some frames."""
    rng = np.random.default_rng(0)
    return [
        HeadCandidates(rng.uniform((0, 0, 10, 10), (20, 20, 30, 30), (3, 4)), np.sort(rng.random(3))[::-1])
        for _ in range(count)
    ]


def test_selection_along_a_track_is_the_best_of_all_paths() -> None:
    frames = drawn_candidates(4)

    def value(path: tuple[int, ...]) -> float:
        boxes = [f.boxes[k] for f, k in zip(frames, path, strict=True)]
        steps = sum(np.linalg.norm(b - a) / b[3] for a, b in pairwise(boxes))
        return sum(f.scores[k] for f, k in zip(frames, path, strict=True)) - 0.3 * steps

    best = max(np.ndindex(3, 3, 3, 3), key=value)
    assert tuple(select_along_track(frames, smoothness=0.3)) == best


def test_the_causal_selection_is_the_end_of_the_best_path_up_to_each_frame() -> None:
    frames = drawn_candidates(40)
    found = select_so_far(frames, smoothness=0.3)
    ends = [select_along_track(frames[: k + 1], smoothness=0.3)[-1] for k in range(len(frames))]
    np.testing.assert_array_equal(found, ends)
    # Offline errors are smaller: the difference is the cost of causality.
    assert (found != select_along_track(frames, smoothness=0.3)).any()


@pytest.mark.slow
def test_plain_the_detector_alone_judges_windows_all_over_the_box(people: People) -> None:
    plain = HeadLocaliser(rounds=60, plain=True).fit(people[0].images, people[0].head_box)
    image = people[1].images[0]
    found = plain.locate(image)
    factor = 128.0 / image.shape[0]
    windows = candidate_windows(128 * image.shape[1] // image.shape[0], 1.0)
    assert (windows[:, 1] + windows[:, 3] / 2.0).max() > 100.0  # feet are windows too
    # The best candidate is a window itself, not a mean of some.
    away = np.abs(found.boxes[0] * factor - windows).max(axis=1)
    assert away.min() < 1.5
    assert mean_overlap(plain, people[1]) > 0.2


def test_figures_of_a_threshold_are_those_of_the_model_with_it(fitted: HeadLocaliser, people: People) -> None:
    found = Located.of(fitted, people[1])
    free = found.figures(-np.inf)
    assert (free[2] == [len(scores) for scores in found.scores]).all()
    overlap = {
        threshold: [
            intersection_over_union(fitted.locate(image, threshold).boxes, true)
            for image, true in zip(people[1].images, people[1].head_box, strict=True)
        ]
        for threshold in (0.0, 0.3)
    }
    for threshold, of_crops in overlap.items():
        first, best, count = found.figures(threshold)
        np.testing.assert_allclose(first, [one[0] for one in of_crops])
        np.testing.assert_allclose(best, [one.max() for one in of_crops])
        np.testing.assert_array_equal(count, [len(one) for one in of_crops])
        assert (count <= free[2]).all() and (best <= free[1]).all() and (count >= 1).all()


def test_the_threshold_of_a_recall_accepts_that_share_of_the_heads() -> None:
    scores = [np.array([0.9, 0.1 * k]) for k in range(10)]
    found = Located([np.array([0.1, 0.8])] * 10 + [np.array([0.2])], [*scores, np.array([0.5])])
    for recall, least in ((1.0, 0.0), (0.8, 0.1), (0.5, 0.4)):
        threshold = found.threshold_of_recall(recall)
        assert threshold == pytest.approx(least)
        assert np.mean([score[1] >= threshold for score in scores]) >= recall
    assert Located([np.array([0.2])], [np.array([0.5])]).threshold_of_recall(0.9) == -np.inf


@pytest.mark.slow
def test_the_localisation_table_has_both_features_and_the_paper() -> None:
    rows, differences = localisation_tables(20, 40, np.random.default_rng(0), rounds=20)
    found = {(row["form"], row["weak classifier"], row["threshold"]): row for row in rows.records()}
    for row in differences.records():
        first, second = (found[row["form"], weak, row["threshold"]][row["measure"]] for weak in WEAK)
        assert row["difference"] == pytest.approx(first - second)
    assert found["the package's", "differential", "the model's own"]["paper: candidates"] is None
    assert found["as printed", "fisher", NATURAL]["paper: candidates"] == 3.0
