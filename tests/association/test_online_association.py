"""Online data association: at once, revised, saved, and the estimates that follow."""

import gc
import json
import resource
from pathlib import Path

import numpy as np
import pytest
from command import run as run_command
from crossing_people import frames_of, idf1, run_online, street
from selection import others_slow

import graphtrack as gt
from graphtrack.association.online import OnlineAssociation
from graphtrack.tracks.detections import Detections
from graphtrack.tracks.scene import SceneParameters

SCENE = SceneParameters(clutter_density=2e-3, birth_density=3e-3, death_rate=0.1)


@pytest.mark.slow
def test_most_identities_are_right_at_once_and_more_after_revision() -> None:
    once, last = [], []
    for seed in range(2):
        detections, whose = street(np.random.default_rng(seed), people=10, frames=50, miss=0.1, false=0.5)
        at_once, revised, _ = run_online(detections)
        once.append(idf1(at_once, whose))
        last.append(idf1(revised, whose))
    assert np.mean(once) > 0.75 and np.mean(last) > max(0.9, np.mean(once))


@pytest.mark.slow
def test_nobody_is_twice_in_a_frame_and_the_future_changes_nothing_said() -> None:
    detections, _ = street(np.random.default_rng(3), miss=0.1, false=1.0)
    _, _, decisions = run_online(detections)
    half = int(np.searchsorted(detections.frame, 30))
    begun = Detections(detections.frame[:half], detections.t[:half], detections.position[:half])
    for early, late in zip(run_online(begun)[2], decisions, strict=False):
        np.testing.assert_array_equal(early.identity, late.identity)
        known = late.identity[late.identity > 0]
        assert len(np.unique(known)) == len(known)
        assert ((late.probability > 0.0) & (late.probability <= 1.0)).all()


def test_empty_frames_and_changing_rates_are_fine_and_bad_ones_change_nothing() -> None:
    tracker = gt.OnlineTracker("position", scene=SCENE)
    t, told = 0.0, []
    for k, dt in enumerate([0.4, 0.1, 0.04, 0.4, 1.0, 0.4, 0.4, 0.2]):
        t += dt
        told.append(tracker.update(t, [] if k == 5 else [(1.2 * t, 0.0)]))
    assert {person.track_id for people in told[3:] for person in people} == {1}
    before = json.dumps(tracker.state())
    for wrong, expected in (((t, [(0.0, 0.0)]), "after"), ((np.nan, []), "seconds")):
        with pytest.raises(gt.InputError, match=expected):
            tracker.update(*wrong)
    with pytest.raises(gt.InputError, match="without a position"):
        tracker.update(t + 1.0, [gt.Observation(t=t + 1.0, head=1.0)])
    with pytest.raises(gt.InputError, match="position"):
        tracker.update(t + 1.0, [(np.nan, 0.0)])
    assert json.dumps(tracker.state()) == before
    assert tracker.update(t + 0.4, [(1.2 * (t + 0.4), 0.0)])[0].observed


def test_estimates_are_those_of_a_smoother_that_knew_who_is_who() -> None:
    """Online equals offline, revised identities included."""
    detections, _ = street(np.random.default_rng(5), people=6, frames=40, noise=0.05)
    tracker = gt.OnlineTracker("position", scene=SCENE)
    frames, owner = frames_of(detections), {}
    told = []
    for number, places in enumerate(frames):
        told = tracker.update(float(detections.t[places[0]]), detections.position[places])
        owner |= {(number, p): 0 for p in range(len(places))}
        owner |= {(number, one.detection): one.track_id for one in told if one.observed}
        owner |= {(one.frame, one.detection): one.after for one in tracker.revised}
    seen_now = [one for one in told if one.observed]
    assert seen_now
    for person in seen_now:
        smoother = gt.OnlineSmoother("position")
        for (number, place), track_id in sorted(owner.items()):
            if track_id == person.track_id:
                k = frames[number][place]
                position = tuple(detections.position[k].tolist())
                t = float(detections.t[k])
                expected = smoother.update(
                    gt.Observation(t, position=position, position_std=SCENE.position_std)
                )
        np.testing.assert_allclose(person.position, expected.position, atol=0.02)
        assert person.t == expected.t


def test_who_is_missed_is_told_where_the_model_expects_them() -> None:
    scene = SceneParameters(
        detection_probability=0.7, death_rate=0.02, clutter_density=1e-3, position_std=0.05
    )
    tracker = gt.OnlineTracker("position", scene=scene)
    for k in range(8):
        people = tracker.update(0.4 * k, [(0.5 * k, 0.0)])
    people = tracker.update(3.2, [(9.0, 9.0)])
    walker = next(person for person in people if person.track_id == 1)
    assert not walker.observed and np.isnan(walker.identity_p)
    np.testing.assert_allclose(walker.position, (4.0, 0.0), atol=0.1)
    for k in range(9, 30):
        people = tracker.update(0.4 * k, [(9.0, 9.0)])
    assert 1 not in [person.track_id for person in people]


def test_a_file_of_detections_is_tracked_on_the_command_line(tmp_path) -> None:
    detections, _ = street(np.random.default_rng(7), people=8, frames=40)
    x, y = detections.position.T
    rows = zip(detections.frame, detections.t, x, y, strict=True)
    source, target = tmp_path / "detections.csv", tmp_path / "online.csv"
    lines = ["frame,t,x,y", *(f"{f},{t:.9g},{a:.9g},{b:.9g}" for f, t, a, b in rows)]
    source.write_text("\n".join(lines) + "\n")
    command = ("track", source, "-o", target, "--model", "position")
    done = run_command(*command, program="graphtrack")
    assert done.returncode == 0 and f"associated {len(detections)} detections online" in done.stderr
    tracks = gt.read(target)
    assert 8 <= len(tracks) <= 12
    assert all(track.identity_p is not None and track.observed is not None for track in tracks)
    refused = run_command(*command, "--associate", "never", program="graphtrack")
    assert refused.returncode == 2 and "associate" in refused.stderr


@pytest.mark.slow
def test_a_few_seconds_of_walking_straight_do_not_say_that_nobody_turns() -> None:
    rng, density, sizes = np.random.default_rng(0), [], []
    start, velocity = 10.0 * rng.uniform(-1.0, 1.0, (10, 2)), rng.normal(0.0, 1.0, (10, 2))
    first = SceneParameters().acceleration_density
    for known in ({}, {"acceleration_density": 0.02}):
        association = OnlineAssociation(known)
        for k in range(40 if known else 200):
            seen = start + 0.1 * k * velocity + 0.02 * rng.standard_normal((10, 2))
            association.update(0.1 * k, seen)
            density.append(association.scene.acceleration_density)
            sizes.append(len(association.chains.t))
    assert 0.5 * first < density[40] < first and density[199] < 0.9 * density[40]
    assert set(density[200:]) == {0.02}
    assert max(sizes[100:200]) <= max(sizes[:100]) + 10  # dropped detections bound the memory


def resident_mebibytes() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_the_memory_of_a_tracker_stays_flat(capsys: pytest.CaptureFixture[str]) -> None:
    """20,000 frames in which people come and go, some of them missed."""
    rng, tracker, sizes, used = np.random.default_rng(0), gt.OnlineTracker("position"), [], []
    position, velocity = rng.uniform(-8.0, 8.0, (8, 2)), rng.normal(0.0, 1.0, (8, 2))
    people = set[int]()
    for k in range(20_000):
        position = position + 0.1 * velocity
        gone = np.abs(position).max(axis=1) > 8.0
        count = int(gone.sum())
        position[gone] = np.column_stack([rng.choice([-8.0, 8.0], count), rng.uniform(-8.0, 8.0, count)])
        velocity[gone] = np.column_stack([-np.sign(position[gone, 0]), rng.normal(0.0, 0.3, count)])
        seen = position[rng.random(8) > 0.1]
        people |= {one.track_id for one in tracker.update(0.1 * k, seen + rng.normal(0.0, 0.05, seen.shape))}
        if k + 1 in (5_000, 10_000, 20_000):
            gc.collect()
            sizes.append(len(json.dumps(tracker.state())) / 2**20)
            used.append(resident_mebibytes())
    with capsys.disabled():
        print(f"\n{len(people)} people; MiB: state {np.round(sizes, 2)}, process {np.round(used, 1)}")
    assert len(people) > 500 and len(tracker) < 40
    assert sizes[-1] < 1.2 * sizes[0]
    assert used[-1] - used[0] < 8.0


@pytest.mark.parametrize(
    ("hz", "noise"),
    others_slow([(hz, std) for hz in (5.0, 10.0, 50.0) for std in (0.01, 0.1)], [(5.0, 0.1)]),
)
def test_two_people_far_apart_keep_their_identities_however_short_the_lag(hz: float, noise: float) -> None:
    rng, seconds = np.random.default_rng(5), 6.0
    t = np.arange(round(seconds * hz)) / hz
    places = np.stack(
        [np.column_stack([1.2 * t, 0 * t]), np.column_stack([9.0 - 1.2 * t, 3.0 + 0 * t])], axis=1
    )
    places += rng.normal(0.0, noise, places.shape)
    for lag in (0.01 / hz, 0.5 / hz, 0.99 / hz):
        tracker = gt.OnlineTracker("position", lag=lag)
        found = [tracker.update(now, some) for now, some in zip(t.tolist(), places, strict=True)]
        late = {one.track_id for people in found[round(3.0 * hz) :] for one in people}
        assert len(late) == 2 and len(found[-1]) == 2
