"""Experiments on identities, parties, forecasts and wrong observations: what they change and compare."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from graphtrack.evaluation.trackers import synthetic_scenes
from graphtrack.experiments import Settings, robustness
from graphtrack.experiments.behaviour import forecasts, parties
from graphtrack.geometry.angles import wrap
from graphtrack.interaction.group_files import GroupLabels, GroupStep
from graphtrack.model import Model
from graphtrack.simulation.sampling import simulate
from graphtrack.simulation.scenario import party
from graphtrack.smoothing import smooth
from graphtrack.tracks.track import Track, TrackSet
from perception.experiments import identities

SETTINGS = Settings(quick=True)


def walkers(n: int = 80) -> TrackSet:
    """People of `joint`, whose truth are their positions."""
    drawn = simulate("joint", n_tracks=3, n_steps=n, rng=np.random.default_rng(0))
    return drawn.map(
        lambda track: replace(track, position=track.true_position, body=track.true_body, head=track.true_head)
    )


def test_a_fault_changes_what_it_names_and_nothing_else() -> None:
    people = walkers()
    plain = robustness.observed(people, "none", SETTINGS)
    for fault in robustness.FAULTS:
        for one, other in zip(robustness.observed(people, fault, SETTINGS), plain, strict=True):
            moved = np.linalg.norm(one.position - other.position, axis=1)
            turned = np.abs(wrap(one.body - other.body)), np.abs(wrap(one.head - other.head))
            np.testing.assert_array_equal(one.true_position, other.true_position)
            if "angles" in fault:
                assert not moved.any() and 0.1 < np.mean(turned[0] > 3.0) < 0.5
                assert set(np.round(np.concatenate(turned), 6)) <= {0.0, round(np.pi, 6)}
                continue
            assert not np.any(turned)
            if "ten frames" in fault:
                (off,) = np.nonzero(moved)
                assert len(off) == 10 and np.ptp(off) == 9
                assert np.ptp(one.position[off], axis=0).max() == 0.0  # one place
            elif "fifth" in fault:
                np.testing.assert_allclose(moved[moved > 0.0], 1.0)
                assert 0.05 < np.mean(moved > 0.0) < 0.4


def test_robust_options_lose_less_to_angles_that_are_turned_around() -> None:
    people = walkers(120)
    some = robustness.observed(people, "30 % of the angles turned around", SETTINGS)
    models = {"default": Model("joint"), "robust": robustness.robust_model()}
    errors = {
        name: robustness._errors(smooth(some, model, constants="default", trust="declared").tracks, some)
        for name, model in models.items()
    }
    assert errors["robust"][:, 1:].mean() < 0.97 * errors["default"][:, 1:].mean()


def test_groups_of_some_people_are_those_among_them() -> None:
    people = walkers(4)
    ids = [track.track_id for track in people]
    steps = (GroupStep(0.0, (frozenset(ids[:2]), frozenset(ids[2:])), 1),)
    some = people.with_tracks(people.tracks[1:])
    (step,) = parties.among(GroupLabels("always", steps, Path("labels")), some).steps
    assert step.groups == (frozenset(ids[1:2]), frozenset(ids[2:]))


def test_gaze_labels_are_the_targets_of_the_party() -> None:
    known = party(np.random.default_rng(3), people=4, steps=12)
    labels = parties.look_labels(known)
    for track, look in zip(known.tracks, known.look, strict=True):
        np.testing.assert_array_equal(labels.of(track.track_id, track.frame), look)


def test_errors_of_members_and_of_people_alone_are_apart() -> None:
    people = walkers(10)
    first = people.tracks[0].track_id
    steps = (GroupStep(0.0, (frozenset(track.track_id for track in people.tracks[1:]),), 1),)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        roles = parties.members(people, GroupLabels("always", steps, Path("labels")))
    together, alone = zip(*roles, strict=True)
    off = people.map(
        lambda track: replace(track, body=wrap(track.body + (0.5 if track.track_id == first else 0.1)))
    )
    assert parties.mean_error(off, people, "body", list(alone)) == pytest.approx(np.degrees(0.5))
    assert parties.mean_error(off, people, "body", list(together)) == pytest.approx(np.degrees(0.1))


def test_straight_walkers_are_predicted_as_well_as_by_constant_velocity() -> None:
    t = 0.4 * np.arange(40)
    tracks = TrackSet(
        tuple(
            Track(k, np.arange(40), t, np.column_stack([(1.0 + 0.2 * k) * t, np.full(40, 9.0 * k)]))
            for k in range(4)
        )
    )
    row = forecasts.ratios(forecasts.scored(tracks, None))
    assert row["forecasts"] == 4 * (40 - 7 - 12)
    assert row["ADE (m)"] < 0.3 and row["in 90 % (%)"] > 90.0


def test_seeds_are_summed_up_by_column() -> None:
    rows = [[{"method": "a", "IDF1": 0.5, "switches": 2}], [{"method": "a", "IDF1": 0.7, "switches": 4}]]
    (row,) = identities.over_seeds(rows)
    assert row["method"] == "a" and row["IDF1"] == pytest.approx(0.6) and row["switches"] == 3.0
    assert row["IDF1 ±"] == pytest.approx(np.std([0.5, 0.7], ddof=1))
    (alone,) = identities.over_seeds(rows[:1])
    assert alone["IDF1"] == 0.5 and alone["IDF1 ±"] is None


def test_evidence_is_what_is_left_of_the_observations() -> None:
    columns = dict.fromkeys(("t", "x", "body_p0", "head_p3", "appearance_1", "score"))
    left = {evidence: set(identities.with_evidence(columns, evidence)) for evidence in identities.EVIDENCE}
    assert left["positions"] == {"t", "x", "score"}
    assert left["positions, body and head"] == {"t", "x", "score", "body_p0", "head_p3"}
    assert left["positions and appearance"] == {"t", "x", "score", "appearance_1"}
    assert left["positions, body, head and appearance"] == set(columns)


def test_a_homography_is_found_from_boxes_and_their_positions(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    homography = np.array([[0.01, 0.001, -3.0], [0.0, 0.02, -4.0], [0.0, 0.0005, 1.0]])
    boxes = np.column_stack([rng.uniform(0, 600, (20, 2)), rng.uniform(20, 80, (20, 2))])
    feet = boxes[:, :2] + boxes[:, 2:] * [0.5, 1.0]
    ground = np.column_stack([feet, np.ones(20)]) @ homography.T
    rows = np.column_stack([np.ones(20), np.arange(20), boxes, np.ones(20), ground[:, :2] / ground[:, 2:]])
    np.savetxt(tmp_path / "gt.txt", rows, delimiter=",")
    camera = identities.fitted_homography(tmp_path / "gt.txt")
    np.testing.assert_allclose(camera.image_to_ground(feet), ground[:, :2] / ground[:, 2:], atol=1e-6)


def test_the_first_frames_of_a_scene_have_their_detections_and_people() -> None:
    known = synthetic_scenes(seconds=10.0)[0]
    scene = identities.JudgedScene("crowd", known.detections, known.truth)
    few = identities.shortened(scene, SETTINGS)
    last = few.detections.frame.max()
    assert len(np.unique(few.detections.frame)) == identities.FEW_FRAMES
    assert max(track.frame[-1] for track in few.truth) <= last
    assert identities.shortened(scene, Settings()) is scene
    rows = list(identities.compared(few, ("hungarian",)))
    assert [row["method"] for row in rows] == ["hungarian"] and 0.0 < rows[0]["IDF1"] <= 1.0
