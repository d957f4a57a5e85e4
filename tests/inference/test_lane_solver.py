"""Tracks solved in lanes: which are, each as if it were alone, and as one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_tracks import contradicted, random_parameters, random_track
from walks import walk

import graphtrack as gt
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.inference import Solution
from graphtrack.inference.chain import batch
from graphtrack.inference.chain.batch import LARGE, LONGEST, fit_lanes, has_lanes, solve_packed
from graphtrack.inference.chain.initialisation import pack, pack_to_solve
from graphtrack.kernels.layout import LANES
from graphtrack.model import LikelihoodParameters, Model, MotionParameters, Parameters
from graphtrack.model.terms.conversation import FacesGroup
from graphtrack.model.terms.couplings import HeadFollowsBody
from graphtrack.smoothing import solve
from graphtrack.tracks.track import Track, TrackSet


def scene(seed: int) -> list[Track]:
    """More tracks than there are lanes, of 1 to 40 frames, with outliers and all kinds of missing data."""
    rng = np.random.default_rng(seed)
    tracks = [without_classes(random_track(rng)) for _ in range(2 * LANES)]
    tracks += [contradicted(rng, "flipped")]
    tracks = [track for track in tracks if np.isfinite(track.position).all(axis=1).any()]
    return [walk(1, seed=seed), *tracks]


def without_classes(track: Track) -> Track:
    return replace(track, body_likelihood=None, head_likelihood=None)


def relative(covariance: FloatArray, other: FloatArray) -> float:
    """The most by which covariances (N, 6, 6) differ, in products of standard deviations."""
    spread = np.sqrt(np.abs(np.einsum("nii->ni", covariance)))
    return float(np.nanmax(np.abs(other - covariance) / (spread[:, :, None] * spread[:, None, :])))


def test_the_size_of_the_work_decides_and_what_a_track_is_like() -> None:
    model, track = Model("social"), walk(25)
    few, many = [track] * (LARGE // 25 - 1), [track] * (LARGE // 25)
    assert not any(fit_lanes(few, model)) and all(fit_lanes(many, model))
    # A part of the work goes the way of the whole.
    assert fit_lanes([track], model, LARGE) == [True]
    assert fit_lanes(many, model, LARGE - 1) == [False] * len(many)
    mixed = [walk(30, classes=True), walk(LONGEST + 1), walk(LONGEST)]
    assert fit_lanes(mixed, model, LARGE) == [False, False, True]


class OwnCoupling(HeadFollowsBody):
    """A coupling whose kernel is of one's own."""

    kernels = (replace(HeadFollowsBody.kernels[0]),)


def test_a_model_has_lanes_where_all_its_kernels_take_them() -> None:
    assert all(
        has_lanes(Model(preset)) for preset in ("position", "separate", "joint-body", "joint", "social")
    )
    assert has_lanes(Model("joint", terms=[FacesGroup]))
    assert not has_lanes(Model("joint", terms=[OwnCoupling]))
    types = pack([walk(5)], Model("social")).records.dtype
    robust = replace(Model("position").parameters, likelihood=LikelihoodParameters(robust="cauchy"))
    for model in (Model("joint"), Model("position", robust)):  # the linear terms do not do
        assert pack_to_solve([walk(5)], model).records.dtype == types


@pytest.mark.parametrize("preset", ["joint", "joint-intentional"])
@pytest.mark.parametrize("seed", [2, 3, 4, 5])
def test_what_lanes_find_is_what_the_scalar_engine_finds(preset: str, seed: int) -> None:
    tracks, rng = scene(seed), np.random.default_rng(seed)
    parameters = random_parameters(rng) if seed in (3, 4) else None
    model = Model(preset, parameters)
    beside = solve_packed(pack(tracks, model), model, in_lanes=True)
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
    one_by_one, done = gt.smooth(TrackSet(tracks), "joint", constants="default"), []
    monkeypatch.setattr(batch, "LARGE", 1)
    beside = solve(TrackSet(tracks), "joint", constants="default", progress=done.append)
    assert sum(done) == sum(map(len, tracks))
    (alone,) = solve(TrackSet(tracks[3:4]), "joint", constants="default")  # the same to the last bit
    assert (alone.cost, alone.iterations) == (beside[3].cost, beside[3].iterations)
    np.testing.assert_array_equal(alone.track.covariance, beside[3].track.covariance)
    for k, (found, expected) in enumerate(zip(beside, one_by_one, strict=True)):
        assert isinstance(found, Solution) and found.track.track_id == k
        np.testing.assert_allclose(found.track.position, expected.position, atol=1e-6)
        if k % 3 == 1:
            np.testing.assert_array_equal(found.track.position, expected.position)


def test_positions_of_many_tracks_are_those_of_one() -> None:
    """In one pass, from records of the linear terms alone: as in two, from those of all terms."""
    unseen = replace(walk(3, seed=5), position=np.full((3, 2), np.nan))
    tracks = [*scene(3), unseen, replace(walk(2, seed=4), position_std=np.array([0.03, np.nan]))]
    for parameters in (Parameters(), Parameters(MotionParameters(acceleration_density=0.03))):
        model = Model("position", replace(parameters, likelihood=LikelihoodParameters(robust="none")))
        whole, lean = pack(tracks, model), pack_to_solve(tracks, model)
        assert lean.records.itemsize < whole.records.itemsize / 3
        expected = solve_packed(whole, model)
        found = solve_packed(lean, model)
        for name in ("states", "cost", "status", "covariance"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), rtol=1e-11, atol=1e-14, err_msg=name
            )
        assert np.isfinite(found.states[:, :4]).all() and np.isnan(found.states[:, 4:]).all()
