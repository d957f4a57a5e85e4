"""Speed of the chain engine against peers on the same data in the same run: ratios of interleaved medians.

The baseline holds ratios of processor time, which other work on the machine hardly changes. Ratios of elapsed
time, where the chain engine has two threads, must reach a bar when the machine is otherwise idle.
"""

import os
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest
import simdkalman
from costs import build_graph
from filterpy.kalman import KalmanFilter
from walks import walk

from graphtrack.constant_velocity import process_noise, transition_matrix
from graphtrack.inference import Solution, smooth_track
from graphtrack.inference.chain.initialisation import initial_states
from graphtrack.model import Model
from graphtrack.model.observation import Step, chain
from graphtrack.smoothing import solve
from graphtrack.tracks.track import Track, TrackSet

pytestmark = pytest.mark.benchmark
TRACKS, STEPS, DT, ROUNDS = 1000, 200, 0.1, 7
Record = Callable[[str, float], None]
Figures = Callable[..., None]
Jacobians = list[np.ndarray] | None


def walks(count: int, steps: int = STEPS) -> list[Track]:
    """Tracks with ids of their own; a hundred different walks over and over."""
    different = [walk(steps, seed=seed, dt=DT) for seed in range(min(count, 100))]
    return [replace(different[k % len(different)], track_id=k) for k in range(count)]


def ours(tracks: list[Track], model: Model, constants: str = "default") -> None:
    """From tracks to tracks, with covariances, as users have it."""
    found = solve(TrackSet(tuple(tracks)), model, engine="chain", constants=constants)
    assert all(isinstance(result, Solution) and result.converged for result in found)


def seconds(*runs: Callable[[], object], rounds: int = ROUNDS) -> np.ndarray:
    """Median elapsed and processor seconds (runs, 2) of turns; the first is not counted."""
    took = np.zeros((rounds + 1, len(runs), 2))
    for turn in range(rounds + 1):
        for k, run in enumerate(runs):
            start = time.perf_counter(), time.process_time()
            run()
            took[turn, k] = time.perf_counter() - start[0], time.process_time() - start[1]
    return np.median(took[1:], axis=0)


def race(
    record: Record,
    figures: Figures,
    name: str,
    mine: tuple[Callable[[], object], int],
    theirs: tuple[Callable[[], object], int],
    least: float,
    rounds: int = ROUNDS,
) -> None:
    """Compare two runs, each with its number of frames, in person-frames a second."""
    idle = os.getloadavg()[0] < 0.5 * (os.cpu_count() or 1)
    took = seconds(mine[0], theirs[0], rounds=rounds)
    elapsed, processor = (np.array([[mine[1]], [theirs[1]]]) / took).T
    ratio, of_processors = elapsed[0] / elapsed[1], processor[0] / processor[1]
    print(f"\n{name}: {elapsed[0]:,.0f} and {elapsed[1]:,.0f} person-frames a second, {ratio:.2f} times;")
    print(f"in processor time {of_processors:.2f} times{'' if idle else ' (the machine is busy)'}")
    record(f"{name}, processor time", of_processors)
    row = {"race": name, "person-frames a second": float(elapsed[0]), "the peer's": float(elapsed[1])}
    figures("Throughput", {**row, "ratio": float(ratio), "ratio, processor time": float(of_processors)})
    assert max(ratio, of_processors) >= least or not idle


def simdkalman_run(tracks: list[Track]) -> Callable[[], object]:
    """Their linear 4-state smoother, all tracks at once."""
    smoother = simdkalman.KalmanFilter(
        transition_matrix(DT), process_noise(DT, 0.5), np.eye(2, 4), 0.01 * np.eye(2)
    )
    seen = np.stack([track.position for track in tracks])
    start = {"initial_value": np.zeros(4), "initial_covariance": 100.0 * np.eye(4)}
    return lambda: smoother.smooth(seen, **start)


@pytest.mark.parametrize(
    ("preset", "constants", "name", "least"),
    [
        ("joint", "learn", "joint, learned / simdkalman, linear", 0.5),
        ("joint", "default", "joint / simdkalman, linear", 2.0),
        ("position", "default", "position / simdkalman", 8.0),
    ],
)
def test_against_the_linear_smoother_of_simdkalman(
    preset: str, constants: str, name: str, least: float, record: Record, figures: Figures
) -> None:
    tracks, model, frames = walks(TRACKS), Model(preset), TRACKS * STEPS
    mine = (lambda: ours(tracks, model, constants)), frames
    race(record, figures, name, mine, (simdkalman_run(tracks), frames), least)


def filterpy_run(tracks: list[Track]) -> None:
    for track in tracks:
        smoother = KalmanFilter(dim_x=4, dim_z=2)
        smoother.F, smoother.Q = transition_matrix(DT), process_noise(DT, 0.5)
        smoother.H, smoother.R, smoother.P = np.eye(2, 4), 0.01 * np.eye(2), 100.0 * np.eye(4)
        means, covariances, *_ = smoother.batch_filter(track.position[:, :, None])
        smoother.rts_smoother(means, covariances)


def test_positions_against_filterpy(record: Record, figures: Figures) -> None:
    tracks, model, few = walks(TRACKS), Model("position"), walks(5)
    mine, theirs = (lambda: ours(tracks, model), TRACKS * STEPS), (lambda: filterpy_run(few), 5 * STEPS)
    race(record, figures, "position / FilterPy", mine, theirs, 90.0, rounds=3)


def optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """GTSAM's own Levenberg–Marquardt to convergence, and the covariance of every variable."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-9)
    parameters.setLinearSolverType("SEQUENTIAL_CHOLESKY")
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    marginals = gtsam.Marginals(graph, found)
    for key in found.keys():  # noqa: SIM118
        marginals.marginalCovariance(key)
    return found


def graph_of(track: Track, model: Model) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    return build_graph(chain(track), model, initial_states(track, model))


def test_against_gtsam_with_native_factors(record: Record, figures: Figures) -> None:
    """On the preset whose factors are all native: no callback into Python, and building the graph is free."""
    tracks, model = walks(TRACKS), Model("separate")
    graphs = [graph_of(track, model) for track in walks(5)]
    theirs = (lambda: [optimise(*graph) for graph in graphs]), 5 * STEPS
    mine = (lambda: ours(tracks, model)), TRACKS * STEPS
    race(record, figures, "separate / GTSAM, native factors", mine, theirs, 25.0, rounds=3)


def naive_von_mises(first: int, second: int | float, kappa: float) -> gtsam.CustomFactor:
    """κ·(1 − cos Δ) between two angles, or of one and a number, as one writes it first."""

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> np.ndarray:
        a = values.atRot2(this.keys()[0]).theta()
        b = values.atRot2(this.keys()[1]).theta() if len(this.keys()) == 2 else second
        if jacobians is not None:
            jacobians[0] = np.sqrt(kappa) * np.array([[-np.sin(a)], [np.cos(a)]])
            if len(this.keys()) == 2:
                jacobians[1] = np.sqrt(kappa) * np.array([[np.sin(b)], [-np.cos(b)]])
        return np.sqrt(kappa) * np.array([np.cos(a) - np.cos(b), np.sin(a) - np.sin(b)])

    keys = [first] if isinstance(second, float) else [first, second]
    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(2), keys, error)


def naive_motion(step: Step, kappa: float, threshold: float) -> gtsam.CustomFactor:
    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> np.ndarray:
        velocity, theta = values.atVector(this.keys()[0]), values.atRot2(this.keys()[1]).theta()
        speed = np.linalg.norm(velocity)
        along, body = velocity / speed, np.array([np.cos(theta), np.sin(theta)])
        excess = max(speed - threshold, 0.0)
        if jacobians is not None:
            across = (np.eye(2) - np.outer(along, along)) / speed
            bend = np.outer(body - along, along) * (excess > 0.0) - excess * across
            jacobians[0] = np.sqrt(kappa) * bend
            jacobians[1] = np.sqrt(kappa) * excess * np.array([[-np.sin(theta)], [np.cos(theta)]])
        return np.sqrt(kappa) * excess * (body - along)

    keys = [step.velocity_key, step.body_key]
    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(2), keys, error)


def naive_graph(track: Track, model: Model) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The joint model with Python factors for all that has to do with orientations."""
    steps, coupling = chain(track), model.parameters.coupling
    _, values = build_graph(steps, model, initial_states(track, model))
    graph, turning = gtsam.NonlinearFactorGraph(), model.parameters.orientation
    for step in steps:
        for factor in Model("position", model.parameters).factors(step):
            graph.push_back(factor)
        weight, seen = float(coupling.weights(step.dt)), step.observation
        assert seen.body is not None and seen.head is not None
        graph.push_back(naive_von_mises(step.body_key, seen.body, model.parameters.likelihood.body_kappa))
        graph.push_back(naive_von_mises(step.head_key, seen.head, model.parameters.likelihood.head_kappa))
        graph.push_back(naive_von_mises(step.head_key, step.body_key, coupling.head_body_kappa * weight))
        graph.push_back(naive_motion(step, coupling.motion_body_kappa * weight, coupling.speed_threshold))
        if step.previous is not None and step.dt is not None:
            before = step.previous
            turns = ((before.body_key, step.body_key, turning.body_diffusion),
                     (before.head_key, step.head_key, turning.head_diffusion))  # fmt: skip
            for first, second, diffusion in turns:
                graph.push_back(naive_von_mises(first, second, 1.0 / (diffusion * step.dt)))
    return graph, values


def test_against_a_graph_of_python_factors(record: Record, figures: Figures) -> None:
    tracks, model, (track,) = walks(TRACKS), Model("joint"), walks(1)
    graph, values = naive_graph(track, model)
    found, expected = optimise(graph, values), smooth_track(track, model).track
    # The same optimum, or the race is no race.
    places = np.array([found.atPoint2(step.position_key) for step in chain(track)])
    np.testing.assert_allclose(places, expected.position, atol=1e-3)
    mine, theirs = (lambda: ours(tracks, model), TRACKS * STEPS), (lambda: optimise(graph, values), STEPS)
    race(record, figures, "joint / GTSAM, Python factors", mine, theirs, 500.0, rounds=3)


def test_cost_grows_with_the_frames_and_no_faster(record: Record) -> None:
    model, sets = Model("joint"), {count: TrackSet(tuple(walks(count))) for count in (TRACKS, 5 * TRACKS)}
    runs = [(lambda tracks=tracks: solve(tracks, model, jobs=2)) for tracks in sets.values()]
    small, large = seconds(*runs, rounds=3)
    tracemalloc.start()
    solve(sets[5 * TRACKS], model, jobs=2)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    frames = sets[5 * TRACKS].n_frames
    print(f"\n{frames:,} person-frames in {large[0]:.1f} s, peak {peak / 2**20:.0f} MiB with the answer")
    print(f"{sets[TRACKS].n_frames:,} person-frames in {small[0]:.2f} s")
    growth = large[1] / small[1] / 5.0
    record("cost of a frame in 1,000,000 / in 200,000, processor time", growth)
    record("peak memory at 1,000,000 frames, bytes a frame", peak / frames)
    assert growth < 1.5
