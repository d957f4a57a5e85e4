"""The head that steers the velocity, in both engines and online."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from costs import cost_around, free, hessian, moved, states_of
from walks import walk, without

from graphtrack.baselines.intentional import GrowingRate, intentional_tracker, mean_deviation
from graphtrack.baselines.kalman import kalman_filter, rauch_tung_striebel
from graphtrack.baselines.particle_filter import ParticleOptions, particle_filter
from graphtrack.geometry.angles import unit
from graphtrack.inference import SolverOptions, smooth_track
from graphtrack.inference.chain.initialisation import pack, problem_of
from graphtrack.inference.chain.newton import workspace
from graphtrack.inference.chain.window_kernels import condense
from graphtrack.io import read_identified
from graphtrack.model import Model, MotionParameters, OrientationParameters, Parameters, States
from graphtrack.model.terms.couplings import BodyFollowsMotion, HeadFollowsBody
from graphtrack.simulation.degrade import add_noise, occlude, withhold
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track

EXACTLY = SolverOptions(max_iterations=2000, relative_tolerance=0.0, step_tolerance=1e-11)
STEERED = pytest.mark.parametrize("preset", ["intentional", "joint-intentional"])
UNSTEERED = Parameters(MotionParameters(head_rate=0.0))


def test_without_a_rate_it_is_white_noise_acceleration() -> None:
    track = walk(20, uneven=True)
    steered = smooth_track(track, Model("joint-intentional", UNSTEERED)).track
    plain = smooth_track(track, Model("joint")).track
    np.testing.assert_array_equal(steered.position, plain.position)
    np.testing.assert_array_equal(steered.head, plain.head)
    tiny = Parameters(MotionParameters(head_rate=1e-7))
    nearly = smooth_track(track, Model("joint-intentional", tiny)).track
    np.testing.assert_allclose(nearly.position, plain.position, atol=1e-6)


def test_somebody_who_looks_aside_is_expected_to_go_there() -> None:
    n, dt = 30, 0.1
    t = dt * np.arange(n)
    track = replace(
        walk(n), t=t, position=1.2 * t[:, None] * unit(0.0), head=np.where(t < 1.5, 0.0, 1.2), body=None
    )
    hidden = withhold(track, t > 1.5)
    ahead, steered = (track_online(hidden, preset) for preset in ("position", "intentional"))
    assert abs(ahead.position[-1, 1]) < 1e-3 and steered.position[-1, 1] > 0.3
    assert smooth_track(hidden, Model("intentional")).track.position[-1, 1] > 0.3


@pytest.mark.slow
@STEERED
def test_what_leaves_the_window_is_what_elimination_leaves(preset: str) -> None:
    """The prior on the second of two frames against the Schur complement of the curvature of both."""
    model, both = Model(preset), walk(2, seed=4)
    for name in ("position", "body", "head"):
        both = without(both, name, [1])  # the second frame has no terms but its links, and no couplings:
    found, memory = smooth_track(both, model, None, EXACTLY).track, workspace(2)
    here, columns = states_of(found), free(model)
    packed = pack([both], model)
    states = np.column_stack(
        [here.position - packed.origin, here.velocity, np.nan_to_num(here.body), here.head]
    )
    assert condense(problem_of(packed)._replace(prior=np.zeros((8, 6))), states, True, memory)

    def cost(vector: np.ndarray) -> float:
        # Without the couplings of the second frame itself.
        return cost_around(here, both, model)(vector) - couplings(vector)

    def couplings(vector: np.ndarray) -> float:
        offset = np.zeros((2, 6))
        offset[:, columns] = vector.reshape(2, len(columns))
        there = moved(here, offset)
        total = 0.0
        for term in model.terms:
            if isinstance(term, BodyFollowsMotion | HeadFollowsBody):
                alone = States(*(value[:1] for value in vars(there).values()))
                first = Track(1, both.frame[:1], both.t[:1], both.position[:1])
                total += term.cost(there, both) - term.cost(alone, first)
        return total

    whole, n = hessian(cost, 2 * len(columns)), len(columns)
    expected = whole[n:, n:] - whole[n:, :n] @ np.linalg.solve(whole[:n, :n], whole[:n, n:])
    left = memory.hessian[1][np.ix_(columns, columns)]
    np.testing.assert_allclose(np.tril(left), np.tril(expected), rtol=1e-3, atol=1e-4 * expected.max())


@pytest.mark.slow
def test_the_head_tells_of_a_turn_that_is_not_seen(data_dir: Path) -> None:
    """Turning walks of motion capture, a second withheld at the sharpest turn: docs/results/model.md.

    Every method has the parameters that were best on the even clips.
    """
    clips = read_identified(data_dir / "mocap" / "tracks_30hz.csv.gz").select("*walk*turn*")
    noisy = add_noise(clips, position_std=0.05, head_kappa=4.0, rng=np.random.default_rng(0))
    hidden = occlude(noisy, 1.0)
    odd = list(hidden.tracks)[1::2]

    def error(estimates: Iterable[Track]) -> np.ndarray:
        pairs = zip(estimates, odd, strict=True)
        off = [(one.position - true.true_position)[hidden.windows[true.track_id]] for one, true in pairs]
        squares = [np.sum(each**2, axis=1) for each in off]
        whole = np.sqrt(np.concatenate(squares).mean())
        return np.array([whole, np.median([np.sqrt(square.mean()) for square in squares])])

    def motion(density: float, rate: float = 0.0, diffusion: float = 0.11) -> Parameters:
        return Parameters(
            MotionParameters(density, head_rate=rate), OrientationParameters(head_diffusion=diffusion)
        )

    online, ahead = Model("intentional", motion(0.03, 1.3)), motion(0.2)
    offline, between = Model("intentional", motion(0.02, 4.0, 0.5)), motion(0.15)
    steered = error(track_online(track, online, lag=0.5) for track in odd)
    kalman = error(kalman_filter(track, ahead) for track in odd)
    smoothed = error(smooth_track(track, offline).track for track in odd)
    rts = error(rauch_tung_striebel(track, between) for track in odd)
    print(f"online {steered} against {kalman}, offline {smoothed} against {rts}")
    assert steered[0] < 0.55 * kalman[0] and steered[1] <= 0.135 and (smoothed < rts).all()


def straight(head: np.ndarray, dt: float = 0.1) -> Track:
    """A person who walks along x at 1 m/s, without noise."""
    n = len(head)
    path = np.column_stack([dt * np.arange(n), np.zeros(n)])
    return Track(track_id=1, frame=np.arange(n), t=dt * np.arange(n), position=path, head=head)


def test_deviations_to_either_side_cancel_and_heads_that_are_missing_count_as_none() -> None:
    aside = np.radians(40.0) * np.where(np.arange(40) % 2, 1.0, -1.0)
    np.testing.assert_allclose(mean_deviation(straight(aside), 1.0)[12:], 0.0, atol=1e-9)
    head = np.where(np.arange(40) % 2, np.radians(40.0), np.nan)
    np.testing.assert_allclose(mean_deviation(straight(head), 1.0)[12:], np.radians(20.0), atol=1e-9)
    assert not mean_deviation(straight(np.full(40, np.nan)), 1.0).any()
    for degrees in (35.0, -170.0):
        found = mean_deviation(straight(np.full(30, np.radians(degrees))), 1.0)
        np.testing.assert_allclose(found[12:], np.radians(abs(degrees)), atol=1e-9)


def test_only_what_was_observed_before_a_step_counts_for_it() -> None:
    track = walk(30, uneven=True)
    after = np.arange(30) >= 17
    later = replace(track, position=track.position + np.outer(after, [3.0, 5.0]), head=track.head + after)
    found, other = mean_deviation(track, 1.0), mean_deviation(later, 1.0)
    np.testing.assert_array_equal(found[:18], other[:18])
    assert not np.allclose(found[18:], other[18:])


def test_the_rate_goes_with_the_deviation() -> None:
    deviation = np.radians(np.linspace(0.0, 180.0, 50))
    np.testing.assert_allclose(GrowingRate(1.3, 0.0).of(deviation), 1.3)
    grows, falls = GrowingRate(1.3, 2.0, 0.6), GrowingRate(1.3, -2.0, 0.6)
    assert (np.diff(grows.of(deviation)) > 0.0).all() and (np.diff(falls.of(deviation)) < 0.0).all()
    assert grows.of(np.array([0.6])) == pytest.approx(1.3)
    np.testing.assert_allclose(grows.of(deviation) + falls.of(deviation), 2.6)
    # Eq. 3 of the paper: α at ŝ = 0 and 1 with ρ = 1.5 and τ = −1.5.
    np.testing.assert_allclose(
        GrowingRate(0.5, 1.5, -1.5).of(np.array([0.0, 1.0])), [0.905, 0.977], atol=5e-4
    )
    assert np.isfinite(GrowingRate(1.3, 1e4, 0.6).of(deviation)).all()


@pytest.mark.parametrize("preset", ["joint-intentional"])
def test_the_parameters_own_rate_as_data_changes_nothing_on_any_engine(preset: str) -> None:
    track, model = walk(25, uneven=True), Model(preset)
    rate = model.parameters.motion.head_rate
    given = replace(track, inputs={"head_rate": np.full(25, rate)})

    def estimates(track: Track) -> list[Track]:
        found = [smooth_track(track, model, engine=engine).track for engine in ("chain", "gtsam")]
        found += [track_online(track, model, engine=e) for e in ("chain", "isam2", "fixed-lag")]
        found.append(particle_filter(track, model, options=ParticleOptions(particles=50)).track)
        found.append(intentional_tracker(track, model.parameters))
        return found

    for found, expected in zip(estimates(given), estimates(track), strict=True):
        np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
        np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-9)


def test_engines_agree_on_rates_that_change() -> None:
    track, model = without(walk(40), "position", [15, 16, 17, 18]), Model("joint-intentional")
    given = GrowingRate(2.0, 3.0, 0.2).given_to(track)
    assert np.ptp(given.inputs["head_rate"]) > 0.1
    by_chain, by_gtsam = (smooth_track(given, model, engine=engine).track for engine in ("chain", "gtsam"))
    np.testing.assert_allclose(by_chain.position, by_gtsam.position, atol=1e-4)
    online = track_online(given, model, engine="chain", lag=60.0)
    np.testing.assert_allclose(online.position[-1], by_chain.position[-1], atol=1e-4)
    assert not np.allclose(by_chain.position, smooth_track(track, model).track.position, atol=1e-3)
