"""Tracks solved side by side: which are, each as if it were alone, and as by the scalar engine."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from random_tracks import contradicted, random_parameters, random_track
from walks import walk

import graphtrack as gt
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.inference import Solution, solve
from graphtrack.inference.chain import side_by_side
from graphtrack.inference.chain.engine import solve_packed
from graphtrack.inference.chain.lane_mode_memory import mode_memory
from graphtrack.inference.chain.lane_modes import renew_lanes
from graphtrack.inference.chain.lane_newton import lane_memory
from graphtrack.inference.chain.lane_stating import state_tracks
from graphtrack.inference.chain.modes import renew_tracks
from graphtrack.inference.chain.result import Result
from graphtrack.inference.chain.side_by_side import LARGE, LONGEST, has_lanes, those_beside
from graphtrack.inference.chain.stating import stating_of
from graphtrack.inference.initial import empty_result, pack, pack_to_solve, problem_of
from graphtrack.inference.solution import seconds_to_ends, stated
from graphtrack.inference.warm import lane_rehearsal, offline_rehearsal, solver_rehearsals
from graphtrack.model import (
    GaitParameters,
    LikelihoodParameters,
    Model,
    MotionParameters,
    OrientationParameters,
    Parameters,
)
from graphtrack.model.kernels.lanes import LANES
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import ROW, Gait, gait_of
from graphtrack.model.terms.place import PlacePrior
from graphtrack.tracks import Track, TrackSet


def scene(seed: int) -> list[Track]:
    """More tracks than there are lanes, of 1 to 40 frames, some seen wrongly, and all that can be missing."""
    rng = np.random.default_rng(seed)
    tracks = [without_classes(random_track(rng)) for _ in range(2 * LANES)]
    tracks += [contradicted(rng, "flipped")]
    tracks = [track for track in tracks if np.isfinite(track.position).all(axis=1).any()]
    return [walk(1, seed=seed), *tracks]


def without_classes(track: Track) -> Track:
    """What is seen of somebody, without what classifiers said."""
    return replace(track, body_likelihood=None, head_likelihood=None)


def relative(covariance: FloatArray, other: FloatArray) -> float:
    """The most by which covariances (N, 6, 6) differ, in products of standard deviations."""
    spread = np.sqrt(np.abs(np.einsum("nii->ni", covariance)))
    return float(np.nanmax(np.abs(other - covariance) / (spread[:, :, None] * spread[:, None, :])))


def test_the_size_of_the_work_decides_and_what_a_track_is_like() -> None:
    model, track = Model("full"), walk(25)
    few, many = [track] * (LARGE // 25 - 1), [track] * (LARGE // 25)
    assert not any(those_beside(few, model))
    assert all(those_beside(many, model))
    # A part of the work goes the way of the whole.
    assert those_beside([track], model, LARGE) == [True]
    assert those_beside(many, model, LARGE - 1) == [False] * len(many)
    mixed = [walk(30, classes=True), walk(LONGEST + 1), walk(LONGEST)]
    assert those_beside(mixed, model, LARGE) == [False, False, True]


class Uphill(PlacePrior):
    """A place whose kernel is of one's own."""

    kernels = (replace(PlacePrior.kernels[0]),)


def test_a_model_has_lanes_where_all_its_kernels_take_them() -> None:
    assert all(has_lanes(Model(preset)) for preset in ("position", "separate", "joint-body", "joint", "full"))
    assert not has_lanes(Model("joint", terms=[PlacePrior]))
    assert not has_lanes(Model("joint", terms=[Uphill]))


def test_each_way_makes_ready_what_it_calls() -> None:
    model = Model("full")
    alone, beside = offline_rehearsal(model).name, lane_rehearsal(model).name
    assert alone != beside
    for ways, expected in (((False,), [alone]), ((True,), [beside]), ((True, False), [alone, beside])):
        assert [one.name for one in solver_rehearsals(model, "chain", beside=ways)] == expected
    assert len(solver_rehearsals(model, "gtsam", beside=(True, False))) == 1


def test_small_work_imports_nothing_of_lanes() -> None:
    code = """
import sys, graphtrack as gt
gt.smooth(gt.simulate("full", n_tracks=2, n_steps=9), "full")
gt.OnlineSmoother("full")
print(*sorted(name.rpartition(".")[2] for name in sys.modules if name.startswith("graphtrack.")))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    imported = done.stdout.split()
    assert "side_by_side" in imported
    # What machine code on disk is for is told by types, those of lanes among them.
    of_lanes = {one for one in imported if one.startswith("lane")} - {"lane_types"}
    assert not of_lanes and "vector_math" not in imported


@pytest.mark.parametrize("preset", ["joint", "full"])
def test_a_track_is_solved_to_the_last_bit_as_if_it_were_alone(
    preset: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(side_by_side, "LARGE", 0)
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
def test_what_lanes_find_is_what_the_scalar_engine_finds(preset: str, seed: int) -> None:
    tracks, rng = scene(seed), np.random.default_rng(seed)
    model = Model(preset, random_parameters(rng) if seed > 2 else None)
    beside = solve_packed(pack(tracks, model), model, side_by_side=True)
    by_itself = solve_packed(pack(tracks, model), model)
    np.testing.assert_array_equal(beside.status, by_itself.status)
    sound = np.repeat(beside.status == 0, [len(track) for track in tracks])
    np.testing.assert_allclose(beside.cost, by_itself.cost, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(beside.states[sound, :4], by_itself.states[sound, :4], atol=1e-6)
    turned = difference(beside.states[sound, 4:], by_itself.states[sound, 4:])
    np.testing.assert_allclose(turned, 0.0, atol=1e-6)
    # The scalar engine's Hessians are those one small step before the end.
    assert relative(by_itself.covariance[sound], beside.covariance[sound]) < 1e-3


def test_tracks_of_both_ways_come_back_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    tracks = tuple(walk(5 + k, seed=k, track_id=k, classes=k % 3 == 1) for k in range(2 * LANES))
    one_by_one, done = gt.smooth(TrackSet(tracks), "joint"), []
    monkeypatch.setattr(side_by_side, "LARGE", 1)
    beside = solve(TrackSet(tracks), "joint", progress=done.append)
    assert sum(done) == sum(map(len, tracks))
    for k, (found, expected) in enumerate(zip(beside, one_by_one, strict=True)):
        assert isinstance(found, Solution)
        assert found.track.track_id == k
        np.testing.assert_allclose(found.track.position, expected.position, atol=1e-6)
        if k % 3 == 1:
            np.testing.assert_array_equal(found.track.position, expected.position)


def renew_beside(
    problem: Problem, states: FloatArray, gait: Gait, spread: FloatArray, result: Result
) -> None:
    """`renew_tracks` by groups of lanes; couplings are put back into the records."""
    longest, numbers = (
        int(np.diff(problem.offsets).max()),
        problem.records.view(float).reshape(len(states), -1),
    )
    memory, rows = lane_memory(longest, numbers.shape[1]), mode_memory(longest)
    for begin in range(0, len(problem.offsets) - 1, LANES):
        memory.lengths[:], memory.frames[:], memory.states[:] = 0.0, 0.0, 0.0
        places = [slice(a, b) for a, b in pairwise(problem.offsets[begin : begin + LANES + 1])]
        for lane in range(LANES):
            memory.tracks[lane] = begin + lane if lane < len(places) else -1
        for lane, place in enumerate(places):
            n = memory.lengths[0, lane] = place.stop - place.start
            memory.frames[: int(n), :, lane], memory.states[: int(n), :, lane] = numbers[place], states[place]
        renew_lanes(problem, longest, gait, False, memory, rows, result)
        on_the_way = memory.frames.copy()
        renew_lanes(problem, longest, gait, True, memory, rows, result)
        np.testing.assert_array_equal(memory.frames, on_the_way)
        for lane, place in enumerate(places):
            n = place.stop - place.start
            numbers[place], spread[place] = memory.frames[:n, :, lane], rows.spread[:n, :, lane]


def test_modes_side_by_side_are_those_of_each_track() -> None:
    rng = np.random.default_rng(7)
    quick = GaitParameters(body_drift=2.0, head_drift=0.0)
    softened = Model("full").parameters
    for parameters, within in ((Parameters(), 1e-9), (Parameters(gait=quick), 1e-9), (softened, 1e-6)):
        model = Model("full", parameters)
        tracks = [without_classes(random_track(rng)) for _ in range(LANES + 3)]
        packed = pack(tracks, model)
        packed.records["steer_gain"] = 0.0
        states = rng.normal(0.0, 1.0, (packed.offsets[-1], 6))
        found = []
        for together in (False, True):
            problem, result = problem_of(packed), empty_result(packed)
            problem = problem._replace(records=packed.records.copy())
            spread, gait = np.zeros((len(states), 2)), gait_of(model.parameters.gait)
            if together:
                renew_beside(problem, states, gait, spread, result)
            else:
                renew_tracks(
                    problem, states, gait, np.zeros((2, ROW)), result.modes, spread, np.empty((2, 0, ROW))
                )
            couplings = [
                problem.records[f"{name}_body_{of}"] for name in ("motion", "head") for of in _COUPLING
            ]
            steering = problem.records["steer_gain"]
            found.append(np.column_stack([result.modes[:, 0], spread, *couplings, steering]))
            found.append(result.modes[:, 1:])
        np.testing.assert_allclose(found[2], found[0], rtol=within, atol=1e-2 * within)
        np.testing.assert_allclose(difference(found[3], found[1]), 0.0, atol=within)


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


def test_positions_of_many_tracks_are_those_of_one_and_stated_as_such() -> None:
    """In one pass, from records of the linear terms alone: as in two, from those of all terms."""
    unseen = replace(walk(3, seed=5), position=np.full((3, 2), np.nan))
    tracks = [*scene(3), unseen, replace(walk(2, seed=4), position_std=np.array([0.03, np.nan]))]
    lasting = Parameters(MotionParameters(lasting_std=0.4))
    for parameters in (Model("position").parameters, lasting):
        model = Model("position", replace(parameters, likelihood=LikelihoodParameters(robust="none")))
        whole, lean = pack(tracks, model), pack_to_solve(tracks, model)
        assert lean.records.itemsize < whole.records.itemsize / 3
        expected = solve_packed(whole, model)
        ends = np.concatenate([seconds_to_ends(track.t) for track in tracks])
        stated(expected.covariance, expected.states[:, 2:4], model.parameters, ends)
        found = solve_packed(lean, model, stating=stating_of(model.parameters))
        for name in ("states", "cost", "status", "covariance"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), rtol=1e-11, atol=1e-14, err_msg=name
            )
        assert np.isfinite(found.states[:, :4]).all() and np.isnan(found.states[:, 4:]).all()


def test_records_of_all_terms_are_packed_where_the_linear_ones_do_not_do() -> None:
    tracks = [walk(5)]
    types = pack(tracks, Model("full")).records.dtype
    assert pack_to_solve(tracks, Model("joint")).records.dtype == types
    robust = replace(Model("position").parameters, likelihood=LikelihoodParameters(robust="cauchy"))
    assert pack_to_solve(tracks, Model("position", robust)).records.dtype == types
    assert pack_to_solve(tracks, Model("position")).records.dtype != types
