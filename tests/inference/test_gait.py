"""Coupling modes: people who side-step, people who do not, and the recursion."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mode_recursions import both_ways
from scipy import special
from walks import FPS, errors, people

import graphtrack as gt
from graphtrack.baselines.particle_model import transition
from graphtrack.geometry.angles import class_kappa, difference, direction, unit, wrap
from graphtrack.inference import smooth_track
from graphtrack.inference.chain.initialisation import pack
from graphtrack.kernels.compilation import compiled
from graphtrack.model import GaitParameters, Model, MotionParameters, Parameters
from graphtrack.model.coupling_modes import AHEAD_BODY, AHEAD_VX, AHEAD_VY, look_ahead, loosened
from graphtrack.model.terms.couplings import (
    BASE,
    BINS,
    NEAR,
    ROW,
    angle_information,
    class_information,
    gait_of,
)
from graphtrack.model.terms.motion import steer
from graphtrack.simulation.degrade import add_noise, withhold
from graphtrack.smoothing import solve, track_online
from graphtrack.tracks.track import Track, TrackSet

GAIT = gait_of(Parameters().gait)


def smoothed(tracks: TrackSet, model: str) -> list[Track]:
    return [result.track for result in solve(tracks, model, constants="default")]


# People.


@pytest.mark.parametrize("degrees", [40.0, -75.0, 120.0, 180.0])
def test_the_offset_of_people_who_side_step_is_found(degrees: float) -> None:
    found = smoothed(people(np.radians(degrees), 8, seed=1), "full")
    offsets = np.concatenate([one.gait_offset[15:-15] for one in found])
    assert np.degrees(np.abs(difference(offsets, np.radians(degrees)))).mean() < 12.0
    assert np.mean([one.aligned_p.mean() for one in found]) < 0.2
    for one in found:
        implied = one.body - direction(one.velocity)
        assert np.degrees(np.abs(difference(implied, np.radians(degrees)))).mean() < 20.0


@pytest.mark.parametrize("degrees", [60.0, -100.0, 180.0])
def test_side_stepping_is_never_worse_than_separate_and_joint_is(degrees: float) -> None:
    tracks = people(np.radians(degrees), 12, seed=2)
    full, separate, joint = (errors(tracks, smoothed(tracks, m)) for m in ("full", "separate", "joint"))
    assert (full < separate).all() and joint[0] > 2.0 * separate[0]


def test_a_head_that_looks_aside_does_not_turn_the_body() -> None:
    tracks = people(0.0, 12, seed=4, head=np.radians(80.0))
    full, joint = (errors(tracks, smoothed(tracks, m)) for m in ("full", "joint"))
    assert (full < 0.8 * joint).all()


@pytest.mark.parametrize(("degrees", "low", "high"), [(0.0, 0.5, 1.0), (120.0, 0.0, 0.1)])
def test_heads_alone_tell_of_the_mode_of_the_body(degrees: float, low: float, high: float) -> None:
    tracks = people(np.radians(degrees), 4, seed=9)
    unseen = tracks.map(lambda track: replace(track, body=None, body_kappa=None))
    assert low <= np.mean([one.aligned_p.mean() for one in smoothed(unseen, "full")]) <= high


def test_a_change_of_mode_is_followed() -> None:
    first, second = people(0.0, 6, seed=5), people(np.radians(150.0), 6, seed=6)
    for one, other in zip(first, second, strict=True):
        n = len(one)
        shift = one.true_position[-1] - other.true_position[0]
        names = ("position_std", "body", "body_kappa", "head", "head_kappa")
        joined = {name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in names}
        position = np.vstack([one.position, other.position + shift])
        both = Track(0, np.arange(2 * n), np.arange(2 * n) / FPS, position, **joined)
        found = smooth_track(both, Model("full")).track
        assert found.aligned_p[n + 30 :].mean() < 0.3
        assert found.aligned_p[: n - 30].mean() > found.aligned_p[n + 30 :].mean() + 0.2


def test_without_anything_seen_of_the_body_it_follows_the_motion() -> None:
    track = replace(
        next(iter(people(0.0, 1, seed=7))), body=None, body_kappa=None, head=None, head_kappa=None
    )
    found = smooth_track(track, Model("full")).track
    assert np.degrees(np.abs(difference(found.body, direction(found.velocity)))).max() < 20.0
    np.testing.assert_allclose(found.aligned_p, Parameters().gait.body_aligned, atol=1e-6)


# Online.


def test_online_the_offset_is_found_from_the_past() -> None:
    tracks = people(np.radians(100.0), 6, seed=13)
    full = [track_online(track, "full") for track in tracks]
    joint = [track_online(track, "joint") for track in tracks]
    assert errors(tracks, full)[0] < 0.7 * errors(tracks, joint)[0]
    ends = np.concatenate([one.gait_offset[-60:] for one in full])
    assert np.degrees(np.abs(difference(ends, np.radians(100.0)))).mean() < 20.0


def test_the_past_of_a_window_is_not_forgotten() -> None:
    # After a window without observations of body and head the mode is known from before.
    (track,) = people(np.radians(100.0), 1, seed=15, seconds=8.0)
    hidden = np.arange(len(track)) >= 150
    channels = {name: np.where(hidden, np.nan, getattr(track, name)) for name in ("body", "head")}
    found = track_online(replace(track, **channels), "full", lag=1.0)
    assert found.aligned_p[149] < 0.1 and found.aligned_p[-1] < 0.3
    assert abs(difference(found.gait_offset[-1], found.gait_offset[149])) < np.radians(15.0)


@pytest.mark.parametrize("offset", [0.0, 100.0])
def test_the_head_steers_people_who_look_where_they_go_and_no_others(offset: float) -> None:
    """A turn in a gap that only the head reveals; bodies and heads of other people point elsewhere."""
    rng, tracks = np.random.default_rng(17), []
    for i in range(6):
        t = np.arange(150) / FPS
        turn = rng.choice([-1.0, 1.0]) * 1.8 * np.clip((t - 3.0) / 0.8, 0.0, 1.0)
        aim = rng.uniform(-np.pi, np.pi) + turn
        course = aim - turn + np.interp(t - 0.4, t, turn)
        position = np.cumsum(1.2 * unit(course) / FPS, axis=0)
        body, head = wrap(course + np.radians(offset)), wrap(aim + np.radians(offset))
        tracks.append(Track(i, np.arange(150), t, position, body=body, head=head))
    noisy = add_noise(TrackSet(tuple(tracks)), position_std=0.05, body_kappa=4.0, head_kappa=4.0, rng=rng)
    gap = (np.arange(150) >= 100) & (np.arange(150) < 130)
    hidden = [withhold(track, gap) for track in noisy]
    full = Model("full").parameters
    unsteered = Model("full", replace(full, motion=replace(full.motion, head_rate=0.0)))

    def error(model: Model) -> float:
        found = [track_online(track, model).position - track.true_position for track in hidden]
        return float(np.sqrt(np.mean([np.sum(one[gap] ** 2, axis=1) for one in found])))

    assert error(Model("full")) < (0.8 if offset == 0.0 else 1.1) * error(unsteered)


# The recursion and the kernels, against their documentation.


@compiled
def steer_all(records: np.ndarray, rate: float) -> None:
    for k in range(len(records)):
        steer(records[k], rate)


@compiled
def loosen(kappa: float, excess: float, missing: float, weight: float, diffusion: float) -> float:
    return kappa * loosened(kappa, excess, missing, weight, diffusion)


@pytest.mark.parametrize("dt", [1e-3, 1 / 30, 1.0, 100.0])
def test_switching_is_diffusion_and_a_change_drawn_from_the_long_run(dt: float) -> None:
    matrix = transition(GAIT.body, dt)[:BASE, :BASE]
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-12)
    assert (matrix >= 0.0).all()
    longrun = np.r_[(1 - GAIT.body.aligned) * GAIT.body.anywhere, GAIT.body.aligned * GAIT.body.share]
    still, kept = transition(GAIT.body._replace(drift=0.0), dt), np.exp(-GAIT.body.switching * dt)
    np.testing.assert_allclose(still[:BASE, :BASE], kept * np.eye(BASE) + (1.0 - kept) * longrun, atol=1e-12)
    # Diffusion is symmetric, and leaves the aligned mode alone.
    drifted = (matrix - (1.0 - kept) * longrun) / kept
    np.testing.assert_allclose(drifted, drifted.T, atol=1e-9 / kept)
    np.testing.assert_allclose(drifted[BINS:], np.eye(BASE)[BINS:], atol=1e-9 / kept)


@pytest.mark.parametrize("dt", [1e-3, 1 / 30, 1.0, 100.0])
def test_glances_begin_and_end_at_their_rates_and_are_forgotten(dt: float) -> None:
    modes = GAIT.head._replace(drift=0.0)
    matrix, share = transition(modes, dt), modes.glance_share
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-12)
    base = np.r_[(1 - modes.aligned) * modes.anywhere, modes.aligned * modes.share]
    longrun = np.r_[(1 - share) * base, share * modes.glance]
    np.testing.assert_allclose(longrun @ matrix, longrun, atol=1e-12)
    # A glance lasts its mean duration; a later one is another.
    kept = np.exp(-dt / Parameters().gait.glance_time)
    stays = share + (1.0 - share) * np.exp(-dt / (Parameters().gait.glance_time * (1.0 - share)))
    other = (stays - kept) * np.tile(modes.glance, (BINS, 1))
    np.testing.assert_allclose(matrix[BASE:, BASE:], kept * np.eye(BINS) + other, atol=1e-12)
    np.testing.assert_allclose(matrix[BASE:, :BASE], (1.0 - stays) * np.tile(base, (BINS, 1)), atol=1e-12)
    # In two steps or in one.
    np.testing.assert_allclose(transition(modes, 0.3 * dt) @ transition(modes, 0.7 * dt), matrix, atol=1e-12)


@pytest.mark.parametrize("kappa", [0.0, 5.0])
def test_offsets_are_drawn_about_0_with_their_concentration(kappa: float) -> None:
    modes = gait_of(GaitParameters(head_offset_kappa=kappa)).head
    assert modes.anywhere.sum() == pytest.approx(1.0)
    mean = modes.anywhere @ np.stack([modes.cos[:BINS], modes.sin[:BINS]], axis=1)
    np.testing.assert_allclose(mean, [special.i1(kappa) / special.i0(kappa), 0.0], atol=1e-9)
    beyond = modes.cos[:BINS] < np.cos(np.radians(95.0))  # the reach of the neck
    assert (GAIT.head.glance[beyond] == 0.0).all() and (GAIT.head.glance[~beyond] > 0.0).all()


@pytest.mark.parametrize("dt", [1e-6, 1 / 30, 0.7])
@pytest.mark.parametrize("rate", [1e-4, 0.02, 2.0, 50.0])
def test_a_step_that_is_steered_anew_is_as_one_that_was_packed(dt: float, rate: float) -> None:
    track = Track(0, np.arange(2), np.array([0.0, dt]), np.zeros((2, 2)))
    motion = MotionParameters(acceleration_density=0.3, head_rate=rate)
    packed = pack([track], Model("intentional", Parameters(motion))).records[1]
    found = pack([track], Model("intentional", Parameters(replace(motion, head_rate=1.0)))).records[1:]
    steer_all(found, rate)
    for name in ("gain", "reach", "place", "cross", "spread"):
        assert found[f"steer_{name}"][0] == pytest.approx(packed[f"steer_{name}"], rel=1e-9)
    steer_all(found, 0.0)
    assert found["steer_gain"][0] == 0.0


def test_a_lead_that_is_not_known_adds_its_variance() -> None:
    missing = loosen(8.0, 1.0, 0.5, 1.0, 0.2)
    assert 1.0 / missing == pytest.approx(1.0 / 8.0 + 0.5 * 0.2)
    assert loosen(8.0, 1.0, 0.0, 1.0, 0.2) == 8.0
    # The weight of a frame scales its cost, not its concentration.
    assert loosen(0.8, 1.0, 0.5, 0.1, 0.2) == pytest.approx(0.1 * missing)


def test_drift_has_the_variance_it_says() -> None:
    row = transition(GAIT.body._replace(switching=0.0, drift=0.05), 2.0)[0, :BINS]
    # A diffused point has the mean resultant length exp(−variance/2), up to the width of a bin.
    mean = row @ np.cos(2.0 * np.pi * np.arange(BINS) / BINS)
    assert np.log(mean) == pytest.approx(-0.5 * 0.05 * 2.0, rel=0.02)


@pytest.mark.parametrize("coupling", ["body", "head"])
def test_modes_are_those_of_summing_over_all_courses(coupling: str) -> None:
    rng = np.random.default_rng(1)
    n, modes = 6, getattr(GAIT, coupling)._replace(switching=0.8, drift=0.3)
    dt = np.r_[0.0, rng.uniform(0.02, 1.5, n - 1)]
    of_offsets = rng.normal(0.0, 2.0, (n, BASE))
    logs = np.hstack([of_offsets, of_offsets[:, :BINS]])
    base = np.r_[(1 - modes.aligned) * modes.anywhere, modes.aligned * modes.share]
    start = np.r_[(1 - modes.glance_share) * base, modes.glance_share * modes.glance]
    matrices = [transition(modes, step) for step in dt[1:]]
    forward = [start * np.exp(logs[0])]
    for k in range(1, n):
        forward.append((forward[-1] @ matrices[k - 1]) * np.exp(logs[k]))
    backward = [np.ones(ROW)]
    for k in range(n - 1, 0, -1):
        backward.insert(0, matrices[k - 1] @ (np.exp(logs[k]) * backward[0]))
    filtered, smoothed_p = both_ways(dt, of_offsets, modes, np.zeros(ROW))
    for k in range(n):
        np.testing.assert_allclose(filtered[k], forward[k] / forward[k].sum(), rtol=1e-9)
        both = forward[k] * backward[k]
        np.testing.assert_allclose(smoothed_p[k], both / both.sum(), rtol=1e-9)
    # In two parts, the second from the filtered result of the first.
    second, _ = both_ways(dt[3:], of_offsets[3:], modes, filtered[2])
    np.testing.assert_allclose(second, filtered[3:], rtol=1e-9)


@pytest.mark.parametrize("lead", [0.0, 0.2, 1.7, -0.4, 50.0])
def test_states_a_lead_later_are_interpolated_and_end_with_the_last(lead: float) -> None:
    rng = np.random.default_rng(2)
    dt = np.r_[0.0, rng.uniform(0.02, 0.5, 30)]
    t, states = np.cumsum(dt), rng.normal(0.0, 0.5, (31, 6))
    smooth = states[:, 4].copy()
    states[:, 4] += 2.0 * np.pi * rng.integers(-1, 2, 31)
    ahead = np.empty((31, 3))
    look_ahead(31, 31.0, states, lead, False, dt, ahead)
    look_ahead(31, 31.0, states, lead, True, dt, ahead)
    np.testing.assert_allclose(
        difference(ahead[:, AHEAD_BODY], np.interp(t + lead, t, smooth)), 0.0, atol=1e-9
    )
    velocity = np.stack([np.interp(t + lead, t, states[:, 2 + axis]) for axis in range(2)], axis=1)
    np.testing.assert_allclose(ahead[:, [AHEAD_VX, AHEAD_VY]], velocity, atol=1e-9)


def test_information_is_the_variance_of_the_slope() -> None:
    kappa, angles = 1.7, 2.0 * np.pi * np.arange(4000) / 4000
    density = np.exp(kappa * np.cos(angles))
    expected = np.sum((kappa * np.sin(angles)) ** 2 * density) / density.sum()
    assert angle_information(np.array([kappa]))[0] == pytest.approx(expected, rel=1e-9)
    one = np.zeros((1, 9))
    one[0, 3] = 1.0
    assert class_information(one)[0] == pytest.approx(
        angle_information(np.array([class_kappa(8)]))[0], rel=1e-6
    )
    assert class_information(np.full((1, 9), np.nan))[0] == 0.0
    assert NEAR % 2 == 1  # or no small offset is 0


# Real people.


def test_people_of_every_gait_on_motion_capture(data_dir: Path) -> None:
    clips = gt.read(data_dir / "mocap" / "tracks_30hz.csv.gz")
    odd = [one for i, one in enumerate(clips) if i % 2]

    def is_ordinary(track: Track) -> bool:
        kind = track.label.split("_")[1]
        return kind in ("walk", "run") or kind.startswith(("walk-turn", "run-turn"))

    for ordinary in (True, False):
        tracks = clips.with_tracks(one for one in odd if is_ordinary(one) == ordinary)
        noisy = add_noise(
            tracks, position_std=0.1, body_kappa=1.2, head_kappa=2.3, rng=np.random.default_rng(11)
        )
        found = smoothed(noisy, "full")
        full = errors(noisy, found)
        joint, separate = (errors(noisy, smoothed(noisy, m)) for m in ("joint", "separate"))
        assert (full <= separate).all() and (full <= joint).all()
        medians = np.median([errors([t], [e]) for t, e in zip(noisy, found, strict=True)], axis=0)
        assert (medians <= ((5.7, 6.2) if ordinary else (8.7, 6.1))).all()
        apart = [e.position - t.true_position for t, e in zip(noisy, found, strict=True)]
        distance = np.median([np.sqrt(np.mean(np.sum(one**2, axis=1))) for one in apart])
        assert distance <= (0.038 if ordinary else 0.0425)
