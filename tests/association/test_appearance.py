"""Likelihood ratio of appearance, and online association with appearance and scores."""

import json

import numpy as np
import pytest
from crossing_people import descriptors_of_people, idf1, met_behind_a_pillar, run_online, street
from hypothesis import given, settings
from hypothesis import strategies as st
from selection import others_slow

import graphtrack as gt
from graphtrack.association.appearance import AppearanceModel
from graphtrack.association.associate import rows_of
from graphtrack.association.online import OnlineAssociation
from graphtrack.association.tracker import track_rows
from graphtrack.errors import InputError
from graphtrack.saved import pack

K = 5


def people(rng: np.random.Generator, count: int, seen: int = 12, k: int = K) -> tuple[np.ndarray, np.ndarray]:
    """Descriptors (count · seen, k) whose covariances within and between people differ."""
    among, within = np.linspace(2.0, 0.5, k), np.linspace(1.5, 0.1, k)
    mean = rng.normal(size=(count, 1, k)) * among
    return (mean + rng.normal(size=(count, seen, k)) * within).reshape(-1, k), np.repeat(
        np.arange(count), seen
    )


def pairs(rng: np.random.Generator, person: np.ndarray, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    neighbours = np.column_stack([np.arange(len(person) - 1), np.arange(1, len(person))])
    any_two = rng.integers(len(person), size=(count, 2))
    one = person[any_two[:, 0]] == person[any_two[:, 1]]
    return neighbours[person[neighbours[:, 0]] == person[neighbours[:, 1]]], any_two[~one]


def learned(rng: np.random.Generator, count: int, **settings: float) -> AppearanceModel:
    values, person = people(rng, count)
    return AppearanceModel.learned(values, *pairs(rng, person), **settings)


@pytest.mark.parametrize("count", [12, 60, 200])
def test_it_is_calibrated_on_other_people(count: int) -> None:
    """Among pairs with the probability p of one person, a share of about p has one person."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        model = learned(rng, count)
        values, person = people(rng, 400)
        same, different = pairs(rng, person, len(values))
        ratio = [model.log_ratio(values[rows[:, 0]], values[rows[:, 1]]) for rows in (same, different)]
        said = 1.0 / (1.0 + np.exp(-np.concatenate(ratio)))
        true = np.repeat([1.0, 0.0], [len(same), len(different)])
        weight = np.repeat([0.5 / len(same), 0.5 / len(different)], [len(same), len(different)])
        place = np.minimum((10.0 * said).astype(int), 9)
        off = np.abs(np.bincount(place, weight * (said - true), minlength=10)).sum()
        assert off < (0.12 if count < 100 else 0.05)
        # By chance it is log 2.
        lost = 0.5 * (np.logaddexp(0.0, -ratio[0]).mean() + np.logaddexp(0.0, ratio[1]).mean())
        assert lost < 0.7 * np.log(2.0)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.001, 0.4))
def test_it_falls_with_the_distance_is_symmetric_and_bounded(seed: int, outlier: float) -> None:
    rng = np.random.default_rng(seed)
    model = AppearanceModel(rng.normal(size=(K, K)), rng.normal(), abs(rng.normal()) * 4.0, outlier)
    first, step = rng.normal(size=K), rng.normal(size=K)
    ratio = model.log_ratio(first, first + np.geomspace(1e-9, 1e9, 40)[:, None] * step)
    assert (np.diff(ratio) <= 1e-12).all() and (
        np.abs(ratio) <= np.log((1.0 - outlier) / outlier) + 1e-9
    ).all()
    np.testing.assert_array_equal(model.log_ratio(first, first + step), model.log_ratio(first + step, first))


def test_units_and_turns_of_the_descriptors_do_not_matter() -> None:
    """A whitened distance has none: but for the shrinkage, which is small here."""
    rng = np.random.default_rng(4)
    values, person = people(rng, 80)
    linked, mixed = pairs(rng, person), 1e3 * np.linalg.qr(rng.normal(size=(K, K)))[0]
    models = [AppearanceModel.learned(seen, *linked, 1e-6) for seen in (values, values @ mixed)]
    found = models[1].log_ratio(values[:-1] @ mixed, values[1:] @ mixed)
    np.testing.assert_allclose(found, models[0].log_ratio(values[:-1], values[1:]), atol=1e-3)


def test_missing_descriptors_and_too_few_people_say_nothing() -> None:
    rng = np.random.default_rng(7)
    values, person = people(rng, 40)
    same, different = pairs(rng, person)
    holes = values.copy()
    holes[::7] = np.nan
    model = AppearanceModel.learned(holes, same, different)
    ratio = model.log_ratio(holes[same[:, 0]], holes[same[:, 1]])
    missing = np.isnan(holes[same]).any(axis=(1, 2))
    assert (ratio[missing] == 0.0).all() and np.isfinite(ratio).all() and (ratio[~missing] != 0.0).all()
    kept = ~np.isnan(holes).any(axis=1)
    few, others = people(rng, 3)
    silent = AppearanceModel.learned(few, *pairs(rng, others)), AppearanceModel.learned(values, same, [])
    for model_of_few in silent:
        assert (model_of_few.log_ratio(values[:-1], values[1:]) == 0.0).all()
    of_kept = AppearanceModel.learned(values, *(p[kept[p].all(axis=1)] for p in (same, different)))
    np.testing.assert_array_equal(of_kept.whitening, model.whitening)


@pytest.mark.parametrize(
    ("descriptors", "same", "said"),
    [
        (np.zeros(4), [[0, 1]], r"shape \(4,\)"),
        (np.zeros((4, 2)), [[0, 4]], "row 4"),
        (np.zeros((4, 2)), [[0.0, 1.0]], "type float64"),
        (np.zeros((4, 2)), [0, 1], r"pairs of shape \(2,\)"),
    ],
)
def test_what_is_no_pair_is_told(descriptors: np.ndarray, same: list[object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        AppearanceModel.learned(descriptors, same, [])
    with pytest.raises(InputError, match="shape"):
        AppearanceModel(np.eye(3)).log_ratio(np.zeros(3), np.zeros(2))


TURNING = {"acceleration_density": 0.2}
"""People may turn, unlike the people of the learned scene."""


def kept(found: np.ndarray, whose: np.ndarray, frame: np.ndarray, person: int) -> bool:
    """Return True if a person has the same identity before and after being hidden."""
    before, after = (found[(whose == person) & some] for some in (frame < 32, frame > 40))
    return bool(before[-1] == after[-1] > 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", others_slow(range(3), [0]))
def test_looks_tell_who_came_back_from_behind_a_pillar(seed: int) -> None:
    rng = np.random.default_rng(seed)
    detections, whose = met_behind_a_pillar(rng)
    looks = descriptors_of_people(rng, whose)
    pair = (int(whose.max()) - 1, int(whose.max()))
    _, seen, _ = run_online(detections, OnlineAssociation(TURNING), descriptor=looks)
    _, blind, _ = run_online(detections, OnlineAssociation(TURNING))
    assert all(kept(seen, whose, detections.frame, person) for person in pair)
    assert not any(kept(blind, whose, detections.frame, person) for person in pair)


@pytest.mark.slow
def test_missing_descriptors_and_one_that_comes_late_are_fine() -> None:
    rng = np.random.default_rng(3)
    detections, whose = met_behind_a_pillar(rng)
    looks = descriptors_of_people(rng, whose)
    looks[rng.random(len(looks)) < 0.2] = np.nan
    looks[detections.frame == 5] = np.nan
    association = OnlineAssociation()
    for frame in np.unique(detections.frame):
        places = np.flatnonzero(detections.frame == frame)
        shown = None if frame < 4 else looks[places]
        found = association.update(
            float(detections.t[places[0]]), detections.position[places], descriptor=shown
        )
        assert np.isfinite(found.probability).all()
    assert association.descriptor_size == looks.shape[1]


@pytest.mark.slow
def test_a_detector_that_is_surer_of_people_helps() -> None:
    blind, seen = [], []
    for seed in range(1):
        rng = np.random.default_rng(seed)
        detections, whose = street(rng, frames=60, people=15, noise=0.2, miss=0.3, false=8.0)
        score = np.where(whose >= 0, rng.normal(2.0, 0.5, len(whose)), rng.normal(1.0, 0.5, len(whose)))
        blind.append(idf1(run_online(detections)[1], whose))
        seen.append(idf1(run_online(detections, score=np.maximum(score, 0.0))[1], whose))
    assert np.mean(seen) > np.mean(blind) + 0.1


@pytest.mark.slow
def test_it_goes_on_with_looks_and_scores_to_the_last_bit() -> None:
    rng = np.random.default_rng(4)
    detections, whose = street(rng, people=10, frames=50, miss=0.1, false=1.0)
    looks, score = descriptors_of_people(rng, whose), rng.uniform(0.0, 1.0, len(whose))
    whole, resumed = OnlineAssociation(), OnlineAssociation()
    for number in range(50):
        places = np.flatnonzero(detections.frame == number)
        given = 0.4 * number, detections.position[places], None, None, score[places], looks[places]
        expected = whole.update(*given)
        if number % 7 == 3:
            resumed = OnlineAssociation.from_state(json.loads(json.dumps(resumed.state())))
        found = resumed.update(*given)
        np.testing.assert_array_equal(found.identity, expected.identity)
        np.testing.assert_array_equal(found.probability, expected.probability)
        assert found.revised == expected.revised
    assert json.dumps(resumed.state()) == json.dumps(whole.state())
    assert resumed.scene == whole.scene != gt.SceneParameters()
    assert resumed._appearance.model is not None and resumed._appearance.model.slope > 0.0


def test_descriptors_of_another_size_and_bad_scores_change_nothing() -> None:
    tracker = gt.OnlineTracker("position")

    def seen(size: int, t: float = 1.2, **more: float) -> gt.Observation:
        return gt.Observation(t, position=(0.0, 0.0), inputs={"appearance": (0.5,) * size}, **more)

    for k in range(3):
        tracker.update(0.4 * k, [seen(3, 0.4 * k)])
    before = json.dumps(tracker.state())
    for wrong, told in (
        ([seen(4)], "a descriptor of 4 numbers"),
        ([seen(3), seen(2)], "a descriptor of 2 numbers"),
        ([seen(3, score=-1.0)], "score = -1"),
    ):
        with pytest.raises(gt.InputError, match=told):
            tracker.update(1.2, wrong)
    assert json.dumps(tracker.state()) == before and len(tracker.update(1.2, [seen(3)])) == 1


@pytest.mark.slow
def test_a_table_with_looks_is_tracked_as_its_arrays_are() -> None:
    rng = np.random.default_rng(5)
    detections, whose = met_behind_a_pillar(rng, people=5)
    looks = descriptors_of_people(rng, whose, size=4)
    x, y = detections.position.T
    columns = {"frame": detections.frame, "t": detections.t, "x": x, "y": y}
    columns |= {f"appearance_{k}": looks[:, k] for k in range(4)}
    tracker = gt.OnlineTracker("position")
    tracks = track_rows(rows_of(columns), tracker)
    alone = OnlineAssociation()
    run_online(detections, alone, descriptor=looks)
    assert tracker.scene == alone.scene
    assert pack(tracker._association._appearance) == pack(alone._appearance)
    assert len(tracks) >= 5 and all("appearance" not in track.inputs for track in tracks)
