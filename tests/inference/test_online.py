from __future__ import annotations

import gc
import json
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import gtsam
import numpy as np
import pytest
from costs import build_graph
from reported_covariances import reported
from selection import others_slow
from walks import walk, without

from graphtrack.baselines.kalman import kalman_filter
from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import Estimate, SolverOptions, smooth_track
from graphtrack.inference.online import OnlineSolver
from graphtrack.inference.state import MarginalPrior, variable_keys
from graphtrack.model import Model, Observation, States, Step, Term
from graphtrack.model.observation import chain, observations
from graphtrack.model.term import Variable
from graphtrack.saved import packed
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track

EXACTLY = SolverOptions(max_iterations=300, relative_tolerance=0.0, step_tolerance=1e-10)
CONVERGED: dict[str, Any] = {"step_tolerance": 1e-7, "max_iterations": 200}
GTSAM_ENGINES = pytest.mark.parametrize("engine", ["fixed-lag", "isam2"])
EVERY_ENGINE = pytest.mark.parametrize("engine", ["chain", "fixed-lag", "isam2"])
PRESETS = ["position", "separate", "joint"]
EVERY_PRESET = pytest.mark.parametrize("preset", PRESETS)
# How far a smoother that was built again may be from one that was not (metres, m/s, radians; their squares).
REBUILT = {"fixed-lag": 1e-10, "isam2": 5e-3}


def run(smoother: OnlineSolver, seen: Sequence[Observation]) -> list[Estimate]:
    return [smoother.update(observation) for observation in seen]


def assert_same(found: Estimate, expected: Estimate, tolerance: float) -> None:
    assert found.t == expected.t and found.frame == expected.frame
    np.testing.assert_allclose(found.position, expected.position, atol=tolerance)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=tolerance)
    for a, b in ((found.body, expected.body), (found.head, expected.head)):
        assert np.isnan(a) == np.isnan(b)
        assert np.isnan(a) or abs(difference(a, b)) <= tolerance
    np.testing.assert_allclose(found.covariance, expected.covariance, atol=tolerance)


def differences(history: list[tuple[float, np.ndarray]], track: Track) -> np.ndarray:
    """Differences (n, 6) of a window's states from the last n of a smoothed track with both orientations."""
    states = np.array([state for _, state in history])
    n = len(states)
    found = np.hstack([states[:, :2] - track.position[-n:], states[:, 2:4] - track.velocity[-n:]])
    return np.column_stack(
        [found, difference(states[:, 4], track.body[-n:]), difference(states[:, 5], track.head[-n:])]
    )


def gauss_newton_covariance(smoothed: Track, track: Track, model: Model) -> np.ndarray:
    """Joint covariance (6, 6) of the last step, from the dense information matrix at a smoothed track."""
    states = States(smoothed.position, smoothed.velocity, smoothed.body, smoothed.head)
    steps = chain(track)
    graph, values = build_graph(steps, model, states)
    keys = [key for step in steps for key in variable_keys(step, model)]
    information = graph.linearize(values).hessian(gtsam.Ordering(keys))[0]
    return reported(np.linalg.inv(information)[-6:, -6:])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "constants"),
    [("chain", "default"), ("chain", "learn"), ("fixed-lag", "default"), ("isam2", "default")],
)
def test_steps_leave_nothing_in_memory(engine: Any, constants: str) -> None:
    """A service runs for months. Arrays are traced, those that only compiled code still refers to as well."""
    track = walk(60, seed=3)

    def kept() -> int:
        track_online(track, "joint", engine=engine, lag=0.5, constants=constants)
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        kept()
        assert kept() - kept() > -50_000
    finally:
        tracemalloc.stop()


# Against independent solutions.


@EVERY_ENGINE
@pytest.mark.parametrize("lag", [0.25, 2.0])
@pytest.mark.parametrize("uneven", [False, True], ids=["even", "uneven"])
@pytest.mark.parametrize("missing", [[], [4, 5, 6, 7, 8, 9, 10, 11, 25, 39]], ids=["whole", "gaps"])
def test_the_preset_position_equals_the_kalman_filter(
    engine: Any, lag: float, uneven: bool, missing: list[int]
) -> None:
    track = without(walk(40, seed=3, uneven=uneven), "position", missing)
    track = replace(track, position_std=np.linspace(0.03, 0.4, 40), body=None, head=None)
    found, expected = track_online(track, "position", engine=engine, lag=lag), kalman_filter(track)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-8)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-8)
    np.testing.assert_allclose(found.covariance[:, :4, :4], expected.covariance[:, :4, :4], atol=1e-8)
    assert np.isnan(found.covariance[:, 4:]).all()


@pytest.mark.parametrize("classes", [False, True], ids=["angles", "classes"])
@pytest.mark.parametrize("preset", others_slow(["separate", "joint"], ["joint"]))
def test_the_fixed_lag_tends_to_the_batch_answer_as_the_lag_grows(preset: str, classes: bool) -> None:
    model = Model(preset)
    seeds = range(1 if classes else 2)
    tracks = [walk(16, seed=seed, noise=0.1, angle_kappa=8.0, classes=classes) for seed in seeds]
    apart = []
    for lag in (0.15, 0.6, 10.0):
        far = []
        for track in tracks:
            batch = smooth_track(track, model, options=EXACTLY).track
            smoother = OnlineSolver(model, engine="fixed-lag", lag=lag, **CONVERGED)
            last = run(smoother, list(observations(track)))[-1]
            row = np.array([*last.position, *last.velocity, last.body, last.head])
            far.append(np.abs(differences([(last.t, row)], batch)).max())
            if lag == 10.0:
                assert np.abs(differences(smoother.history(), batch)).max() < 1e-5
                np.testing.assert_allclose(
                    last.covariance, gauss_newton_covariance(batch, track, model), rtol=1e-4, atol=1e-7
                )
        apart.append(np.mean(far))
    assert apart[0] > apart[1] > apart[2] and apart[2] < 1e-5


@EVERY_ENGINE
@pytest.mark.parametrize("known_position", [False, True])
def test_pixels_are_tracked_as_the_batch_smoother_does(engine: Any, known_position: bool) -> None:
    camera = GroundCamera.from_homography([[0.02, 0.001, -6.0], [0.0, -0.03, 14.0], [0.0, 0.0012, 1.0]])
    track = walk(30, seed=6, noise=0.0)
    track = replace(track, position=track.position - track.position.mean(axis=0))
    pixel = camera.ground_to_image(track.position) + np.random.default_rng(1).normal(0.0, 3.0, (30, 2))
    assert np.isfinite(pixel).all()
    track = replace(track, pixel=pixel, position=camera.image_to_ground(pixel))
    batch = smooth_track(track, Model("joint"), camera, EXACTLY).track
    smoother = OnlineSolver("joint", engine=engine, lag=100.0, camera=camera, **CONVERGED)
    seen = [o if known_position else replace(o, position=None) for o in observations(track)]
    assert {e.status for e in run(smoother, seen)} == {"new"}
    bound = 0.02 if engine == "isam2" else 1e-5
    assert np.abs(differences(smoother.history(), batch)).max() < bound


# Frames without observations, and people who enter without a position.


@EVERY_ENGINE
@EVERY_PRESET
def test_frames_without_observations_extrapolate_and_grow_uncertain(engine: Any, preset: str) -> None:
    smoother = OnlineSolver(preset, engine=engine, lag=1.0)
    seen = list(observations(walk(20)))
    before = run(smoother, seen)[-1]
    silent = [Observation(t=seen[-1].t + 0.1 * k) for k in range(1, 30)]
    found = run(smoother, silent)
    assert {e.status for e in found} == {"new"}
    if preset != "joint":  # there the orientations turn the velocity as they relax
        np.testing.assert_allclose(found[-1].velocity, before.velocity, atol=1e-6)
        np.testing.assert_allclose(found[-1].position, before.position + 2.9 * before.velocity, atol=1e-5)
    variances = np.array([np.diagonal(e.covariance) for e in [before, *found]])
    used = np.isfinite(variances[0])
    assert used.sum() == (4 if preset == "position" else 6)
    # The exact density of the extrapolated position; couplings to a constant velocity leave it alone.
    assert (np.diff(variances[:, :4], axis=0) > 0.0).all()
    assert (variances[-1, used] > 1.5 * variances[0, used]).all() or preset == "joint"


@EVERY_ENGINE
def test_a_person_who_enters_without_a_position_waits_for_one(engine: Any) -> None:
    track = walk(25, seed=11)
    seen = list(observations(track))
    entering = [replace(o, position=None) for o in seen[:4]]
    smoother, fresh = (OnlineSolver("joint", engine=engine) for _ in range(2))
    for e in run(smoother, entering):
        assert e.status == "waiting" and np.isnan([*e.position, *e.velocity, e.body, e.head]).all()
        assert np.isnan(e.covariance).all()
    assert smoother.window is None and smoother.history() == []
    for observation in seen[4:]:
        assert_same(smoother.update(observation), fresh.update(observation), 0.0)
    assert smoother.window is not None


@EVERY_ENGINE
def test_orientations_never_seen_follow_the_motion_or_stay_unknown(engine: Any) -> None:
    track = replace(walk(30, seed=1), body=None, head=None)
    joint, separate = (track_online(track, preset, engine=engine) for preset in ("joint", "separate"))
    heading = np.arctan2(joint.velocity[-1, 1], joint.velocity[-1, 0])
    assert abs(difference(joint.body[-1], heading)) < 0.2
    uniform = np.pi / np.sqrt(3.0)
    np.testing.assert_allclose(np.sqrt(np.diagonal(separate.covariance[-1])[4:]), uniform)


# Late, repeated and useless observations.


@EVERY_ENGINE
@EVERY_PRESET
def test_late_observations_end_where_punctual_ones_do(engine: Any, preset: str) -> None:
    track = walk(20, seed=9, noise=0.1, angle_kappa=8.0)
    seen = list(observations(track))
    options: dict[str, Any] = {"engine": engine, "lag": 1.0, "relinearize_threshold": 1e-6} | CONVERGED
    punctual, late = OnlineSolver(preset, **options), OnlineSolver(preset, **options)
    run(punctual, seen[:8])
    shuffled = [seen[k] for k in (0, 2, 1, 5, 4, 3, 7, 6)]
    statuses = [e.status for e in run(late, shuffled)]
    assert statuses == ["new", "new", "late", "new", "late", "late", "new", "late"]
    for observation in seen[8:]:
        assert_same(late.update(observation), punctual.update(observation), 1e-4)


@EVERY_ENGINE
def test_a_late_observation_after_the_window_has_moved_equals_the_kalman_filter(engine: Any) -> None:
    track = replace(walk(40, seed=9, uneven=True), body=None, head=None)
    seen = list(observations(track))
    smoother = OnlineSolver("position", engine=engine, lag=1.0)
    run(smoother, [o for k, o in enumerate(seen[:36]) if k != 33])
    found = smoother.update(seen[33])
    expected = kalman_filter(track)
    assert found.status == "late" and (found.t, found.frame) == (seen[35].t, seen[35].frame)
    np.testing.assert_allclose(found.position, expected.position[35], atol=1e-8)
    np.testing.assert_allclose(found.covariance[:4, :4], expected.covariance[35, :4, :4], atol=1e-8)
    for k in range(36, 40):
        np.testing.assert_allclose(smoother.update(seen[k]).position, expected.position[k], atol=1e-8)


@EVERY_ENGINE
def test_duplicates_and_what_comes_too_late_change_nothing(engine: Any) -> None:
    seen = list(observations(walk(40, seed=13)))
    smoother, plain = (OnlineSolver("joint", engine=engine, lag=1.0) for _ in range(2))
    start = seen[0].t
    for observation in seen:
        estimate = smoother.update(observation)
        assert_same(estimate, plain.update(observation), 0.0)
        repeated = smoother.update(observation)
        again = smoother.update(Observation(t=observation.t, position=observation.position))
        old = smoother.update(Observation(t=start - 0.05, position=(0.0, 0.0)))
        assert (repeated.status, again.status, old.status) == ("duplicate", "duplicate", "too-late")
        for unchanged in (repeated, again, old):
            assert_same(unchanged, estimate, 0.0)
        window = smoother.window
        assert window[1] == observation.t
        oldest = max(start, observation.t - 1.0)
        assert oldest - 1e-9 <= window[0] <= oldest + 0.1 + 1e-9


def test_a_marginal_prior_owns_its_numbers() -> None:
    """GTSAM's linear term is a view of the factor, invalid after the factor is freed."""
    step, model = next(iter(chain(walk(3, seed=1)))), Model("position")
    values, linear = gtsam.Values(), np.array([1.0, -2.0])
    values.insert(step.position_key, np.array([3.0, 4.0]))
    values.insert(step.velocity_key, np.zeros(2))
    factor = gtsam.HessianFactor(step.position_key, 5.0 * np.eye(2), linear, 0.5)
    prior = MarginalPrior.of(factor, step, values, model)
    assert not np.shares_memory(prior.linear, factor.linearTerm())
    np.testing.assert_array_equal(prior.linear, [*linear, 0.0, 0.0, 0.0, 0.0])
    # ½·dᵀ·Λ·d − ηᵀ·d + ½·c, at d = (0.2, 0.1).
    values.update(step.position_key, np.array([3.2, 4.1]))
    expected = 0.5 * 5.0 * 0.05 - 0.0 + 0.5 * 0.5
    assert prior.factor(step, model).error(values) == pytest.approx(expected)


# Failures.


class Failing(Term):
    """Fails in one of several ways at the frames 90 and up, or anywhere when it is ``broken``."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})
    broken: ClassVar[bool] = False

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        frame, key = step.observation.frame, step.position_key
        if frame == 90:
            raise RuntimeError("no factors today")

        def callback(_this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> np.ndarray:
            if frame == 91 or type(self).broken:
                raise RuntimeError("the residual cannot be had")
            at = values.atPoint2(key)
            if jacobians is not None:
                jacobians[0] = 0.01 * np.diag(np.cos(at))
            return np.full(2, np.nan if frame == 93 else 0.0) if frame >= 90 else 0.01 * np.sin(at)

        return [gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(2), [key], callback)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        return 0.0


@GTSAM_ENGINES
@pytest.mark.parametrize("way", [90, 91, 93], ids=["no factors", "raises", "not finite"])
@pytest.mark.parametrize(
    ("after", "whole"),
    others_slow([(0, False), (1, False), (12, False), (25, False), (25, True)], [(0, False), (25, True)]),
)
def test_a_failed_update_is_reported_and_leaves_no_trace(
    engine: Any, way: int, after: int, whole: bool
) -> None:
    model = Model("joint", terms=[Failing])
    seen = list(observations(walk(32, seed=14)))
    lag = None if whole and engine == "isam2" else 1.0
    smoother, plain = (OnlineSolver(model, engine=engine, lag=lag) for _ in range(2))
    before = run(smoother, seen[:after])
    run(plain, seen[:after])
    times = [seen[after].t - 0.05]  # new, as new after all steps have left the window, and late
    times += [seen[after].t + 5.0] * bool(before) + [seen[after].t - 0.15] * (after > 2)
    for t in times:
        failed = smoother.update(Observation(t=t, frame=way, position=seen[after].position))
        assert failed.status == "failed" and failed.reason and "\n" not in failed.reason
        if before:
            assert_same(failed, before[-1], 0.0)
        else:
            assert smoother.window is None and np.isnan(failed.position).all()
    for observation in seen[after:]:
        assert_same(smoother.update(observation), plain.update(observation), REBUILT[engine])


@pytest.mark.parametrize(("engine", "lag"), [("fixed-lag", 1.0), ("isam2", 1.0), ("isam2", None)])
def test_a_factor_that_breaks_later_is_rolled_back_too(
    engine: Any, lag: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = Model("joint", terms=[Failing])
    seen = list(observations(walk(30, seed=15)))
    options: dict[str, Any] = {"engine": engine, "lag": lag, "relinearize_threshold": 1e-9}
    smoother, plain = (OnlineSolver(model, **options) for _ in range(2))
    run(smoother, seen[:20])
    run(plain, seen[:20])
    with monkeypatch.context() as patch:
        patch.setattr(Failing, "broken", True)
        assert [e.status for e in run(smoother, seen[20:22])] == ["failed"] * 2
    for observation in seen[22:]:
        assert_same(smoother.update(observation), plain.update(observation), REBUILT[engine])


def test_a_pixel_above_the_horizon_is_refused() -> None:
    camera = GroundCamera.from_homography([[0.02, 0.0, -6.0], [0.0, -0.03, 14.0], [0.0, 0.01, -1.0]])
    smoother = OnlineSolver("joint", engine="fixed-lag", camera=camera)
    with pytest.raises(InputError, match="horizon"):
        smoother.update(Observation(t=0.0, pixel=(320.0, 50.0)))
    assert smoother.window is None


# Saved state.


def through_json(state: dict[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps(state, allow_nan=False))


@pytest.mark.slow
@pytest.mark.parametrize("preset", others_slow(PRESETS, ["joint"]))
@pytest.mark.parametrize("lag", [1.0, None])
def test_isam2_goes_on_from_any_step_within_its_threshold(preset: str, lag: float | None) -> None:
    """GTSAM does not give its Bayes tree away; for the other engines see `test_resume`."""
    track = without(
        walk(26, seed=17, uneven=True, noise=0.1, classes=True), "position", [0, 1, 12, 13, 14, 15]
    )
    seen = list(observations(track))
    seen[18], seen[19] = seen[19], seen[18]
    options: dict[str, Any] = {"engine": "isam2", "lag": lag}
    whole = OnlineSolver(preset, **options)
    expected, states = [], [whole.state()]
    for observation in seen:
        expected.append(whole.update(observation))
        states.append(through_json(whole.state()))
    assert expected[19].status == "late"
    for k in range(len(seen)):
        resumed = OnlineSolver.from_state(through_json(states[k]), preset, **options)
        if k:
            assert_same(replace(resumed.update(seen[k - 1]), status="new"), expected[k - 1], 0.0)
        for step in range(k, min(k + 4, len(seen))):
            found = resumed.update(seen[step])
            assert found.status == expected[step].status
            # Steps with class likelihoods are re-linearised beyond a tenth of the threshold, 0.01 rad.
            assert_same(found, expected[step], 0.01)


@pytest.mark.parametrize("first, second", [("fixed-lag", "chain"), ("chain", "fixed-lag")])
def test_one_engine_goes_on_from_the_state_of_another(first: Any, second: Any) -> None:
    seen = list(observations(walk(60, seed=3)))
    smoother = OnlineSolver("joint", engine=first, lag=1.0, **CONVERGED)
    run(smoother, seen[:30])
    state = through_json(smoother.state())
    resumed = OnlineSolver.from_state(state, "joint", engine=second, lag=1.0, **CONVERGED)
    # Engines differ in the curvature with which they let frames go, so only nearly the same.
    for observation in seen[30:]:
        a, b = smoother.update(observation), resumed.update(observation)
        np.testing.assert_allclose(b.position, a.position, atol=2e-3)
        assert abs(difference(b.head, a.head)) < 0.02


def test_the_fixed_lag_keeps_no_more_than_its_window() -> None:
    smoother = OnlineSolver("joint", engine="fixed-lag", lag=1.0)
    run(smoother, list(observations(walk(120))))
    assert len(smoother.history()) == len(smoother.state()["steps"]) <= 12
    assert smoother._smoother.steps[-1].previous.previous is None


def test_the_compiled_window_equals_the_batch_within_the_lag() -> None:
    for preset in ("separate", "joint"):
        track = walk(200, seed=6, dt=0.04)
        smoother = OnlineSolver(preset, engine="chain", lag=2.0)
        run(smoother, list(observations(track)))
        batch = smooth_track(track, Model(preset)).track
        assert np.abs(differences(smoother.history(), batch)).max() < 1e-3


def damage(change: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
    smoother = OnlineSolver("joint", engine="fixed-lag", lag=1.0)
    run(smoother, list(observations(walk(30))))
    state = through_json(smoother.state())
    change(state)
    return state


@pytest.mark.parametrize(
    "change",
    [
        lambda state: state.pop("version"),
        lambda state: state.pop("steps"),
        lambda state: state["steps"].pop(),
        lambda state: state["steps"][2].update(starts="many"),
        lambda state: state["window"].update(states=packed(np.zeros((2, 6)))),
        lambda state: state["steps"][2]["observation"].update(colour="red"),
        lambda state: state["window"]["prior"].update(information="x"),
        lambda state: state["window"]["prior"].update(information=packed(np.ones((1, 1)))),
        lambda state: state["last"].pop("covariance"),
        lambda state: state.update(next_index=None),
        lambda state: state["arrays"].pop("search_from"),
        lambda state: state["arrays"].update(search_from=[[1], "f", "AAAA"]),
        lambda state: state["arrays"].update(search_from=[[1], "f", "?"]),
    ],
)
def test_damaged_states_are_refused(change: Callable[[dict[str, Any]], Any]) -> None:
    with pytest.raises(InputError, match="state"):
        OnlineSolver.from_state(damage(change), "joint", engine="fixed-lag", lag=1.0)
