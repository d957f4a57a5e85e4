"""Online association with appearance and scores of detections."""

from __future__ import annotations

import json

import numpy as np
import pytest
from crossing_people import descriptors_of_people, idf1, met_behind_a_pillar, run_online, street

import graphtrack as gt
from graphtrack.association.associate import rows_of
from graphtrack.association.online import OnlineAssociation
from graphtrack.association.tracker import track_rows

TURNING = {"acceleration_density": 0.2}
"""People may turn, unlike the people of the learned scene."""


def kept(found: np.ndarray, whose: np.ndarray, frame: np.ndarray, person: int) -> bool:
    """Return True if a person has the same identity before and after being hidden."""
    before, after = (found[(whose == person) & some] for some in (frame < 32, frame > 40))
    return bool(before[-1] == after[-1] > 0)


@pytest.mark.parametrize("seed", range(3))
def test_looks_tell_who_came_back_from_behind_a_pillar(seed: int) -> None:
    rng = np.random.default_rng(seed)
    detections, whose = met_behind_a_pillar(rng)
    looks = descriptors_of_people(rng, whose)
    pair = (int(whose.max()) - 1, int(whose.max()))
    _, seen, _ = run_online(detections, OnlineAssociation(TURNING), descriptor=looks)
    _, blind, _ = run_online(detections, OnlineAssociation(TURNING))
    assert all(kept(seen, whose, detections.frame, person) for person in pair)
    assert not any(kept(blind, whose, detections.frame, person) for person in pair)


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


def test_a_detector_that_is_surer_of_people_helps() -> None:
    blind, seen = [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        detections, whose = street(rng, frames=80, people=20, noise=0.2, miss=0.3, false=8.0)
        score = np.where(whose >= 0, rng.normal(2.0, 0.5, len(whose)), rng.normal(1.0, 0.5, len(whose)))
        blind.append(idf1(run_online(detections)[1], whose))
        seen.append(idf1(run_online(detections, score=np.maximum(score, 0.0))[1], whose))
    assert np.mean(seen) > np.mean(blind) + 0.1


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

    def seen(size: int, **more: float) -> gt.Observation:
        return gt.Observation(0.0, position=(0.0, 0.0), inputs={"appearance": (0.5,) * size}, **more)

    for k in range(3):
        tracker.update(0.4 * k, [seen(3)])
    before = json.dumps(tracker.state())
    for wrong, told in (
        ([seen(4)], "a descriptor of 4 numbers"),
        ([seen(3), seen(2)], "a descriptor of 2 numbers"),
        ([seen(3, score=-1.0)], "score = -1"),
    ):
        with pytest.raises(gt.InputError, match=told):
            tracker.update(1.2, wrong)
    assert json.dumps(tracker.state()) == before and len(tracker.update(1.2, [seen(3)])) == 1


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
    assert (
        tracker.scene == alone.scene and tracker._association._appearance.state() == alone._appearance.state()
    )
    assert len(tracks) >= 5 and all("appearance" not in track.inputs for track in tracks)
