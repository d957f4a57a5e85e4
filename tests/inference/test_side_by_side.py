"""Tracks solved side by side: as each by itself, and as the scalar engine solves them one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_tracks import contradicted, random_parameters, random_track
from walks import walk

from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.inference import Solution, solve
from graphtrack.inference.chain import groups
from graphtrack.inference.chain.engine import solve_packed
from graphtrack.inference.chain.lane_mode_memory import mode_memory
from graphtrack.inference.chain.lane_modes import renew_lanes
from graphtrack.inference.chain.modes import renew_tracks
from graphtrack.inference.chain.result import Result
from graphtrack.inference.chain.stating import state_tracks, stating_of
from graphtrack.inference.initial import empty_result, pack, problem_of
from graphtrack.inference.solution import seconds_to_ends, stated
from graphtrack.model import GaitParameters, Model, MotionParameters, OrientationParameters, Parameters
from graphtrack.model.kernels.lanes import LANES
from graphtrack.model.terms.gait_modes import gait_of
from graphtrack.tracks import Track, TrackSet


def scene(seed: int) -> list[Track]:
    """More tracks than there are lanes, of 1 to 40 frames, some seen wrongly, and all that can be missing."""
    rng = np.random.default_rng(seed)
    tracks = [random_track(rng) for _ in range(2 * LANES)]
    tracks += [contradicted(rng, kind) for kind in ("flipped", "classes")]
    tracks = [track for track in tracks if np.isfinite(track.position).all(axis=1).any()]
    return [walk(1, seed=seed), *tracks]


def without_classes(track: Track) -> Track:
    """What is seen of somebody, without what classifiers said."""
    return replace(track, body_likelihood=None, head_likelihood=None)


def solved(tracks: list[Track], model: Model) -> Result:
    return solve_packed(pack(tracks, model), model)


def relative(covariance: FloatArray, other: FloatArray) -> float:
    """The most by which covariances (N, 6, 6) differ, in products of standard deviations."""
    spread = np.sqrt(np.abs(np.einsum("nii->ni", covariance)))
    return float(np.nanmax(np.abs(other - covariance) / (spread[:, :, None] * spread[:, None, :])))


@pytest.mark.parametrize("preset", ["joint", "full"])
def test_a_track_is_solved_to_the_last_bit_as_if_it_were_alone(preset: str) -> None:
    model, tracks = Model(preset), scene(1)
    together = solve(TrackSet(tuple(replace(track, track_id=k) for k, track in enumerate(tracks))), model)
    for k in (0, 3, len(tracks) - 1):
        (alone,), beside = solve(TrackSet((tracks[k],)), model), together[k]
        assert isinstance(alone, Solution)
        assert isinstance(beside, Solution)
        assert (alone.cost, alone.iterations) == (beside.cost, beside.iterations)
        np.testing.assert_array_equal(alone.track.position, beside.track.position)
        np.testing.assert_array_equal(alone.track.covariance, beside.track.covariance)


@pytest.mark.parametrize("preset", ["joint", "full"])
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_what_lanes_find_is_what_the_scalar_engine_finds(
    preset: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracks, rng = scene(seed), np.random.default_rng(seed)
    model = Model(preset, random_parameters(rng) if seed > 2 else None)
    beside = solved(tracks, model)
    monkeypatch.setattr(groups, "LONGEST", 0)
    by_itself = solved(tracks, model)
    np.testing.assert_array_equal(beside.status, by_itself.status)
    sound = np.repeat(beside.status == 0, [len(track) for track in tracks])
    np.testing.assert_allclose(beside.cost, by_itself.cost, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(beside.states[sound, :4], by_itself.states[sound, :4], atol=1e-6)
    turned = difference(beside.states[sound, 4:], by_itself.states[sound, 4:])
    np.testing.assert_allclose(turned, 0.0, atol=1e-6)
    # The scalar engine's Hessians are those one small step before the end.
    assert relative(by_itself.covariance[sound], beside.covariance[sound]) < 1e-3


def test_modes_side_by_side_are_those_of_each_track() -> None:
    rng = np.random.default_rng(7)
    quick = GaitParameters(body_drift=2.0, head_drift=0.0)
    for parameters in (Parameters(), Parameters(gait=quick)):
        model = Model("full", parameters)
        tracks = [without_classes(random_track(rng)) for _ in range(LANES + 3)]
        packed = pack(tracks, model)
        packed.records["steer_gain"] = 0.0
        states = rng.normal(0.0, 1.0, (packed.offsets[-1], 6))
        found = []
        for side_by_side in (False, True):
            problem, result = problem_of(packed), empty_result(packed)
            problem = problem._replace(records=packed.records.copy())
            spread, gait = np.zeros((len(states), 2)), gait_of(model.parameters.gait)
            if side_by_side:
                order = np.arange(len(tracks))
                renew_lanes(problem, order, states, gait, mode_memory(40), result.modes, spread)
            else:
                renew_tracks(problem, states, gait, result.modes, spread)
            couplings = [
                problem.records[f"{name}_body_{of}"] for name in ("motion", "head") for of in _COUPLING
            ]
            steering = problem.records["steer_gain"]
            found.append(np.column_stack([result.modes[:, 0], spread, *couplings, steering]))
            found.append(result.modes[:, 1:])
        np.testing.assert_allclose(found[2], found[0], rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(difference(found[3], found[1]), 0.0, atol=1e-9)


_COUPLING = ("kappa", "cos", "sin")


def test_covariances_of_many_tracks_are_stated_as_those_of_one() -> None:
    rng, tracks = np.random.default_rng(3), [walk(9, seed=1), walk(30, seed=2, uneven=True)]
    roots = rng.normal(size=(39, 6, 6)) * 10.0 ** rng.uniform(-3.0, 1.0, (39, 1, 1))
    covariance, states = roots @ np.swapaxes(roots, 1, 2), rng.normal(size=(39, 6))
    covariance[9, 4], covariance[9, :, 4], covariance[12] = np.nan, np.nan, np.nan
    still = Parameters(MotionParameters(lasting_std=0.0), OrientationParameters(head_turn_rate=0.0))
    packed = pack(tracks, Model("joint"))
    for parameters in (Parameters(), still):
        ends = np.concatenate([seconds_to_ends(track.t) for track in tracks])
        expected, found = stated(covariance.copy(), states[:, 2:4], parameters, ends), covariance.copy()
        state_tracks(found, states, packed.offsets, packed.t, stating_of(parameters))
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-15)
