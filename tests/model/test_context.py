"""Inputs of a frame that loosen the couplings: on every engine alike, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack.baselines.particle_model import prepare
from graphtrack.experiments import Settings
from graphtrack.experiments.behaviour import context
from graphtrack.geometry.angles import difference
from graphtrack.model.terms.couplings import BODY_FREE, HEAD_FREE, held
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks.track import Track


def person(**inputs: float) -> Track:
    (track,) = simulate("joint", n_tracks=1, n_steps=30, rng=np.random.default_rng(2))
    return replace(track, inputs={name: np.full(len(track), share) for name, share in inputs.items()})


@given(st.floats(0.0, 1.0))
def test_an_absent_input_holds_and_a_share_is_taken_off(share: float) -> None:
    np.testing.assert_allclose(held(np.array([share, np.nan])), [1.0 - share, 1.0])
    assert held(None) == 1.0


@pytest.mark.parametrize("engine", ["chain", "gtsam"])
def test_fully_free_couplings_are_the_preset_without_them(engine: str) -> None:
    free, plain = person(head_free=1.0, body_free=1.0), person()
    options = {"constants": "default", "engine": engine}
    found, separate = gt.smooth(free, "joint", **options), gt.smooth(plain, "separate", **options)
    coupled = gt.smooth(plain, "joint", **options)
    for name in ("body", "head"):
        apart = np.abs(difference(getattr(found, name), getattr(separate, name)))
        assert apart.max() < np.radians(0.05)
        assert np.abs(difference(getattr(coupled, name), getattr(separate, name))).max() > np.radians(1.0)


@pytest.mark.parametrize("engine", ["chain", "isam2", "fixed-lag"])
def test_online_engines_read_the_inputs_frame_by_frame(engine: str) -> None:
    track = person()
    half = np.where(np.arange(len(track)) < 15, 0.0, 1.0)
    loosened = replace(track, inputs={HEAD_FREE: half, BODY_FREE: half})
    options = {"constants": "default", "engine": engine}
    before, after = (gt.track_online(one, "joint", **options) for one in (track, loosened))
    assert np.abs(difference(before.head[:15], after.head[:15])).max() < 1e-9
    assert np.abs(difference(before.head[15:], after.head[15:])).max() > np.radians(0.5)


def test_the_particle_filter_has_the_same_strengths() -> None:
    model = gt.Model("joint")
    plain, loosened = (
        prepare(one, model, None, "smooth", False).motion for one in (person(), person(head_free=0.75))
    )
    np.testing.assert_allclose(loosened.head_body_kappa, 0.25 * plain.head_body_kappa)
    np.testing.assert_allclose(loosened.motion_body_kappa, plain.motion_body_kappa)


def test_a_share_outside_of_0_to_1_is_one_error() -> None:
    with pytest.raises(gt.InputError, match=r"share -0\.5 of a free orientation"):
        gt.smooth(person(head_free=-0.5), "joint", constants="default")


@pytest.mark.slow
def test_who_looks_into_a_shop_window_is_better_predicted_with_the_window_known() -> None:
    shoppers = context.window_shoppers(Settings(quick=True))
    share = context.chosen_share(shoppers.people, shoppers.free, shoppers.inputs)
    known = context.informed(shoppers.people, shoppers.free, shoppers.inputs, share)
    assert share > 0.0
    gain = context.hidden_density(known).mean() - context.hidden_density(shoppers.people).mean()
    assert gain > 0.0
