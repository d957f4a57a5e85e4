"""Scenes: rates over the ground, known and learned parameters, at any rate, from any start."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command import ran
from crossing_people import idf1, packed_square, run_online, street
from scipy import stats
from selection import others_slow

import graphtrack as gt
from graphtrack.association.likelihood import (
    STATE,
    Chains,
    link_by,
    observed_angles,
    refresh,
    scene_of,
    steer,
    unlinked,
)
from graphtrack.association.motion import noise_of, velocities_of
from graphtrack.association.offline import associate_detections
from graphtrack.association.online import REPORTED_FROM, OnlineAssociation
from graphtrack.association.scene import (
    AHEAD,
    SPREAD,
    duplicate_density,
    first_guess,
    learn_ground_rates,
    learn_scene,
    own_rates,
)
from graphtrack.geometry.angles import class_centres
from graphtrack.tracks.detections import Detections

FRAMES, CROSSING = 400, 20


def both_ways(seed: int = 0) -> tuple[Chains, np.ndarray]:
    """A walk of 20 m each, one after the other from left to right, and false detections in a corner above."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(FRAMES // CROSSING):
        y = rng.uniform(-1.0, 1.0)
        rows += [(k * CROSSING + j, j + rng.normal(0.0, 0.1), y, k) for j in range(CROSSING)]
    rows += [(f, rng.uniform(14.0, 20.0), rng.uniform(10.0, 12.0), -1) for f in range(FRAMES)]
    frame, x, y, identity = np.array(sorted(rows)).T
    position = np.column_stack([x, y])
    nothing = np.full((len(frame), 2), np.nan)
    chains = unlinked(0.4 * frame, frame.astype(np.int64), position, nothing)
    link_by(chains, identity.astype(np.int64))
    return chains, identity.astype(np.int64)


def test_people_come_where_they_came_and_leave_where_they_left() -> None:
    chains, identity = both_ways()
    left, middle, right, corner = np.array([[0.0, 0.0], [10.0, 0.0], [19.0, 0.0], [17.0, 11.0]])
    births, deaths, clutter = learn_ground_rates(chains, identity).at(np.array([left, middle, right, corner]))
    assert births[0] > 2.0 > 1.0 > births[1] and births[0] > 4.0 * births[2]
    assert deaths[2] > 2.0 > 1.0 > deaths[1] and deaths[2] > 4.0 * deaths[0]
    assert clutter[3] > 2.0 and clutter[:3].max() < 0.2


def test_without_gaps_a_scene_keeps_its_prior_of_occlusions() -> None:
    """One occlusion of 2 s, and a hundredth of two events, count in addition to the observations."""
    chains, identity = both_ways()
    found = learn_scene(chains, identity, gt.SceneParameters(), np.full(len(identity), np.nan), 0.4)
    assert found.occlusion_seconds == pytest.approx(2.0)
    assert found.occlusion_probability == pytest.approx(0.02 / ((identity >= 0).sum() + 2.0))


@pytest.mark.parametrize("number", [0, 4])
@pytest.mark.parametrize("other", [-1, 2])
def test_a_detection_near_a_longer_track_may_be_a_duplicate_of_it(number: int, other: int) -> None:
    """``number``: of a track of three detections; ``other``: of one detection near the last; −1: false."""
    scene = gt.SceneParameters(duplicate_rate=0.1, duplicate_spread=0.5)
    position = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.3, 0.4]])
    identity = np.array([number, number, number, other])
    density = duplicate_density(np.array([0, 1, 2, 2]), position, identity, scene)
    normal = stats.multivariate_normal([2.0, 0.0], 0.25 * np.eye(2))
    np.testing.assert_allclose(density, [0.0, 0.0, 0.0, 0.1 * normal.pdf(position[3])])


@pytest.mark.parametrize("k", [0, 7, 300])
def test_own_events_are_left_out_as_if_they_had_not_been(k: int) -> None:
    """Against a loop over all other events, blurred without a grid."""
    chains, identity = both_ways(seed=k)
    births, _, _ = own_rates(chains, identity)
    firsts = np.flatnonzero((chains.preceding < 0) & (identity >= 0) & (chains.frame > 3)).tolist()
    others = chains.position[[j for j in firsts if identity[j] != identity[k] or identity[k] < 0]]
    square = np.sum((others - chains.position[k]) ** 2, axis=1)
    peak = 1.0 / (2.0 * np.pi * SPREAD**2)
    low, high = np.quantile(chains.position, [0.005, 0.995], axis=0)
    mean = len(firsts) / np.prod(high - low)
    expected = (peak * np.exp(-0.5 * square / SPREAD**2).sum() + 2 * peak) / (mean + 2 * peak)
    # The grid has corners every half spread.
    assert births[k] == pytest.approx(expected, rel=0.2)


def test_of_two_in_one_place_the_one_who_goes_out_leaves_rather() -> None:
    """A street of 20 m with people both ways."""
    rows = [(16 * k + j, 0.5 * (j if k % 2 else 40 - j), k) for k in range(30) for j in range(41)]
    frame, x, identity = np.array(sorted(rows)).T
    nothing = np.full((len(frame), 2), np.nan)
    chains = unlinked(0.4 * frame, frame.astype(np.int64), np.column_stack([x, 0.0 * x]), nothing)
    link_by(chains, identity.astype(np.int64))
    chains.variance[:] = 0.01
    refresh(chains, 0, len(x), scene_of(gt.SceneParameters(), 0.4), 0)
    found = learn_ground_rates(chains, identity.astype(np.int64))
    here, speed = np.array([[19.5, 0.0]]), np.array([[1.25, 0.0]])
    out, back = (found.leaving_for(here + sign * AHEAD * speed) for sign in (1.0, -1.0))
    _, by_place, _ = found.at(here)
    assert out > 1.3 * by_place > 5.0 * back


def test_somebody_goes_on_being_there_as_often_as_where_it_is_played() -> None:
    """People stand still, and leave at a uniform rate; a person who has left is never detected again."""
    rng, scene = np.random.default_rng(0), gt.SceneParameters(death_rate=0.06, occlusion_probability=0.1)
    found = OnlineAssociation(scene)
    for frame in range(20):
        found.update(0.4 * frame, np.array([[0.0, 0.0]]))
    chance, hidden = 1.0 - scene.detection_probability, scene.occlusion_probability
    told: list[bool] = []
    missed, left = np.zeros(200_000, int), rng.geometric(-np.expm1(-0.4 * scene.death_rate), 200_000) - 1
    u = rng.random(len(missed))
    for k in range(1, 12):
        # For so many frames at least: by chance, or hidden.
        missed += u < chance**k + hidden * np.exp(-0.4 * k / scene.occlusion_seconds)
    for k in range(1, 12):
        found.update(0.4 * (19 + k), np.zeros((0, 2)))
        unseen = missed >= np.minimum(left, k)
        there = np.mean(left[unseen] >= k)
        told.append(bool(found.hidden()))
        if abs(there - REPORTED_FROM) > 0.02:
            assert told[-1] == (there > REPORTED_FROM)
    assert told[3] and not told[-1]


def test_observed_angles_are_the_given_ones_and_else_the_mean_of_class_likelihoods() -> None:
    classes, body = np.eye(8)[[2, 2]], np.array([0.1, np.nan])
    found = observed_angles({"body": body, "body_likelihood": classes}, 2)
    np.testing.assert_allclose(found, [[0.1, np.nan], [class_centres(8)[2], np.nan]], atol=1e-12)


VARIANCE = 0.5
"""Variance of an angle about the direction of travel, rad²."""


def walking(way: float, speed: float = 1.2) -> np.ndarray:
    """The state of a person who walks in a direction (rad)."""
    velocity = speed * math.cos(way), speed * math.sin(way)
    return np.array([(1.0, -2.0, *velocity, 0.02, 0.03, 0.09, *[0.0] * 4)], STATE)


def steered(state: np.ndarray, angle: float, outliers: float = 0.02) -> np.ndarray:
    after = state.copy()
    steer(angle, VARIANCE, outliers, after[0])
    return after


def test_a_small_turn_is_the_update_of_a_kalman_filter_by_the_velocity_across() -> None:
    state, angle = walking(0.0), 0.05
    mean, axis, direction = np.split(np.array(state[0].tolist()), [4, 7])
    covariance = np.kron(axis[[[0, 1], [1, 2]]], np.eye(2))
    across, speed = np.array([0.0, 0.0, 0.0, 1.0]), mean[2]
    gain = covariance @ across / (across @ covariance @ across + VARIANCE * speed**2)
    mean = mean + gain * speed * math.sin(angle)
    left = covariance - np.outer(gain, across @ covariance)
    after = np.array(steered(state, angle, outliers=1e-9)[0].tolist())
    axis = [(left[k, m] + left[k + 1, m + 1]) / 2 for k, m in ((0, 0), (0, 2), (2, 2))]
    np.testing.assert_allclose(after[:7], [*mean, *axis], rtol=1e-6)
    np.testing.assert_array_equal(after[7:], direction)


@pytest.mark.parametrize("turn", [0.2, 1.0, 2.0, 3.0])
def test_somebody_turns_towards_the_angle_never_past_it_and_alike_on_both_sides(turn: float) -> None:
    before, left, right = walking(0.0)[0], steered(walking(0.0), turn)[0], steered(walking(0.0), -turn)[0]
    assert 0.0 < math.atan2(left["vy"], left["vx"]) < turn
    assert math.atan2(right["vy"], right["vx"]) == pytest.approx(-math.atan2(left["vy"], left["vx"]))
    assert left["vv"] < before["vv"] and left["pp"] * left["vv"] > left["pv"] ** 2


@pytest.mark.parametrize(
    ("angle", "outliers", "speed"), [(math.nan, 0.02, 1.2), (0.5, 1.0, 1.2), (0.5, 0.02, 0.0)]
)
def test_what_says_nothing_changes_nothing(angle: float, outliers: float, speed: float) -> None:
    state = walking(0.3, speed)
    np.testing.assert_array_equal(steered(state, angle, outliers), state)


KNOWN = {"detection_probability": 0.6, "position_std": 0.2, "duplicate_rate": 0.3, "body_turn": 1.5}


def crowded(seed: int) -> tuple[Detections, np.ndarray]:
    return street(np.random.default_rng(seed), people=14, frames=80, miss=0.15, false=1.0)


@pytest.mark.slow
def test_what_is_known_is_kept_and_the_rest_is_learned() -> None:
    detections, _ = crowded(0)
    free = associate_detections(detections).scene
    association = OnlineAssociation(KNOWN)
    run_online(detections, association)
    for found in (associate_detections(detections, KNOWN).scene, association.scene):
        assert {name: getattr(found, name) for name in KNOWN} == KNOWN
        assert found.clutter_density == pytest.approx(free.clutter_density, rel=0.5)
        assert found.occlusion_probability != gt.SceneParameters().occlusion_probability


@pytest.mark.slow
def test_online_a_known_scene_is_used_from_the_first_frame_on() -> None:
    """Ten seconds of further recordings of a place, with and without parameters learned from one of them."""
    taught = associate_detections(crowded(10)[0]).scene
    scores = []
    for seed in range(11, 14):
        whole, owner = crowded(seed)
        first = np.flatnonzero(whole.t < whole.t[0] + 10.0)
        begun = Detections(whole.frame[first], whole.t[first], whole.position[first])
        both = OnlineAssociation(), OnlineAssociation(taught)
        scores.append([idf1(run_online(begun, one)[0], owner[first]) for one in both])
        assert both[1].scene == taught
    without, given = np.mean(scores, axis=0)
    assert given >= without


@pytest.mark.slow
def test_a_model_file_says_it_to_every_command(tmp_path: Path) -> None:
    detections, _ = street(np.random.default_rng(1), people=8, frames=40, miss=0.1)
    x, y = detections.position.T
    table = pd.DataFrame({"frame": detections.frame, "t": detections.t, "x": x, "y": y})
    source, file = tmp_path / "seen.csv", tmp_path / "model.toml"
    table.to_csv(source, index=False)
    # A missed detection is a death: tracks end at each gap.
    known = {"longest_gap": 0.5, "longest_filled": 0.0, "position_std": 0.23}
    gt.Model("position", scene=known).save(file)
    free = gt.associate(table)
    expected = gt.associate(table, scene=known)
    assert len(expected) > len(free)
    assert all(np.diff(track.frame).max(initial=1) == 1 for track in expected)
    std = {value for track in expected for value in track.position_std.tolist()}
    assert std == {0.23}
    for found in (
        gt.associate(source, model=file),
        gt.associate(source, {"position_std": 0.23}, model=gt.Model("joint", scene=known)),
        gt.read(source, scene=known),
        gt.smooth(source, file),
    ):
        assert [track.frame.tolist() for track in found] == [track.frame.tolist() for track in expected]
    out = ("-o", tmp_path / "out.csv")
    for command, *more in (("info",), ("smooth", *out), ("track", *out)):
        done = ran(command, source, "--model", file, *more, program="graphtrack")
        assert command == "track" or f"{len(expected)} people" in " ".join(done.stderr.split())
    assert len(gt.read(tmp_path / "out.csv")) > len(free)
    tracker = gt.OnlineTracker(file, scene={"longest_gap": 0.7})
    assert (tracker.scene.longest_gap, tracker.scene.position_std) == (0.7, 0.23)


def corridor(
    hz: float, seconds: float = 40.0, seed: int = 0, noise: float = 0.1
) -> tuple[Detections, np.ndarray]:
    """People who walk both ways through a dense corridor; 15 % are missed, 10 % of detections are false."""
    rng = np.random.default_rng(seed)
    rows, owners = [], []
    for person in range(round(1.5 * seconds)):
        t0, way = rng.uniform(-10.0, seconds), rng.choice([-1.0, 1.0])
        speed, x = rng.normal(1.3, 0.15), rng.uniform(0.0, 4.0)
        for k in range(max(0, int(np.ceil(t0 * hz))), int(min(seconds, t0 + 12.0 / speed) * hz)):
            if rng.random() > 0.15:
                y = (0.0 if way > 0.0 else 12.0) + way * speed * (k / hz - t0)
                rows.append((k, *rng.normal((x, y), noise)))
                owners.append(person)
    false = len(rows) // 10
    rows += [(k, *rng.uniform((0.0, 0.0), (4.0, 12.0))) for k in rng.integers(0, int(seconds * hz), false)]
    owners += [-1] * false
    table = np.array(rows)
    detections = Detections(table[:, 0].astype(np.int64), table[:, 0] / hz, table[:, 1:])
    return detections, np.array(owners)[detections.row]


@pytest.mark.parametrize("hz", [1.0, 2.0, 5.0, 25.0])
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_pairs_show_where_people_go(hz: float, turn: float) -> None:
    detections, _ = corridor(hz)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    position = detections.position @ axes
    found = velocities_of(detections.step, position, axes, 1.0 / hz, 0.1, 1.0)
    weight, along = found["weight"], np.column_stack([found["vx"], found["vy"]]) @ axes.T
    assert weight.sum() == pytest.approx(1.0)
    # Both ways, 1.3 m/s: much of the weight, and little across.
    both = np.abs(np.abs(along[:, 1]) - 1.3) < 0.4
    assert weight[both & (np.abs(along[:, 0]) < 0.6)].sum() > 0.55
    assert weight[both & (along[:, 1] > 0.0)].sum() == pytest.approx(0.4, abs=0.2)


@pytest.mark.parametrize("hz", [1.0, 2.0, 5.0, 25.0])
@pytest.mark.parametrize("noise", [0.05, 0.1, 0.3])
def test_triples_show_the_noise(hz: float, noise: float) -> None:
    detections, _ = corridor(hz, noise=noise)
    found = noise_of(detections.step, detections.position, 48.0, 1.0 / hz)
    assert 0.5 * noise < found < 1.8 * noise + 0.06


QUICK = [(1.0, 10, 40.0)]
SIZES = [*QUICK, (25.0, 100, 4.0), (2.5, 100, 40.0), (5.0, 10, 40.0), (25.0, 10, 20.0)]
CROWDS = [(hz, 1600, 20.0 / hz) for hz in (1.0, 5.0, 25.0)]


@pytest.mark.parametrize(("hz", "people", "seconds"), others_slow([*SIZES, *CROWDS], QUICK))
def test_what_is_learned_online_is_the_simulator(hz: float, people: int, seconds: float) -> None:
    frames = round(seconds * hz)
    detections, _ = packed_square(
        np.random.default_rng(1), people=people, frames=frames, step=1.0 / hz, square_metres=25.0
    )
    association = OnlineAssociation()
    run_online(detections, association)
    scene, square = association.scene, 25.0 * people
    assert association.learned >= (1 if people == 1600 else 2)
    # 10 % are missed; a false detection a frame for 50 people; nobody comes or leaves.
    assert 0.8 < scene.detection_probability < 0.97
    false = people / 50.0 / square
    watched = min(len(detections), 2000) / people * square  # m² · frames
    assert abs(scene.clutter_density - false) < 4.0 * np.sqrt(false / watched) + 3.0 / watched + 0.3 * false
    assert scene.position_std == pytest.approx(0.1, rel=0.35)
    assert scene.death_rate < 0.06


@pytest.mark.slow
def test_a_false_start_is_forgotten() -> None:
    """Half a minute of nothing but false detections, then people."""
    rng = np.random.default_rng(2)
    detections, whose = street(rng, people=30, frames=200, miss=0.1, false=0.3)
    frame = np.repeat(np.arange(75), 6)
    position = np.concatenate([rng.uniform(-8.0, 8.0, (len(frame), 2)), detections.position])
    both = np.concatenate([frame, detections.frame + 75])
    owners = np.concatenate([np.full(len(frame), -1), whose])
    together = Detections(both, 0.4 * both, position)
    _, last, _ = run_online(together)
    alone = run_online(detections)[1]
    late = both[together.row] >= 75 + 100
    found = idf1(last[late], owners[together.row][late])
    assert found > idf1(alone[detections.frame >= 100], whose[detections.frame >= 100]) - 0.05


@pytest.mark.parametrize(
    ("hz", "least"), others_slow([(1.3333, 0.55), (2.0, 0.7), (4.0, 0.85)], [(1.3333, 0.55)])
)
def test_a_dense_corridor_has_identities_at_low_rates(hz: float, least: float) -> None:
    detections, whose = corridor(hz)
    assert idf1(associate_detections(detections).identity, whose) > least
    assert idf1(run_online(detections)[1], whose) > least - 0.15


def test_few_detections_are_people_and_no_clutter() -> None:
    guess = first_guess(Detections(np.zeros(2, np.int64), np.zeros(2), np.array([[0.0, 0.0], [3.0, 0.0]])))
    assert guess.clutter_density < 0.01
