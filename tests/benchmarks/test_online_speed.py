"""Online speed of the engines: ratios of processor time within one run."""

import time
from collections.abc import Callable
from typing import Literal

import gtsam
import numpy as np
import pytest
from walks import walk

from graphtrack import simulate
from graphtrack.constants.online import OnlineSmoother
from graphtrack.inference.state import variable_keys
from graphtrack.model import Model, Observation
from graphtrack.model.observation import Step, chain, observations

pytestmark = pytest.mark.benchmark
LAG = 2.0
Record = Callable[[str, float], None]
Figures = Callable[..., None]


def took_in(smoother: OnlineSmoother, observation: Observation) -> None:
    # A failed update is a fast one.
    assert smoother.update(observation).status == "new"


def milliseconds(action: Callable[[], object]) -> float:
    start = time.process_time()
    action()
    return 1e3 * (time.process_time() - start)


class GtsamFixedLag:
    """GTSAM's own fixed-lag smoother on the same factors, with the joint covariance of the newest step."""

    def __init__(self, model: Model) -> None:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(0.01)
        parameters.relinearizeSkip = 1
        parameters.findUnusedFactorSlots = True
        self.model = model
        self.smoother = gtsam.IncrementalFixedLagSmoother(LAG, parameters)

    def update(self, step: Step) -> np.ndarray:
        seen, keys = step.observation, variable_keys(step, self.model)
        assert seen.position is not None and seen.body is not None and seen.head is not None
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in self.model.factors(step):
            graph.push_back(factor)
        start = (np.array(seen.position), np.zeros(2), gtsam.Rot2(seen.body), gtsam.Rot2(seen.head))
        for key, value in zip(keys, start, strict=True):
            values.insert(key, value)
        self.smoother.update(graph, values, dict.fromkeys(keys, seen.t))
        return self.smoother.getISAM2().jointMarginalCovariance(keys).fullMatrix()


def show(
    figures: Figures,
    people: str,
    engine: str,
    median: float,
    last: float | None = None,
    *,
    time: str = "processor",
) -> None:
    """Print and record milliseconds of a step: the median, and the 99th percentile where it is known."""
    print(
        f"\n{people}, {engine}: {median:.3f} ms ({time})",
        "" if last is None else f"99th percentile {last:.3f}",
    )
    row = {"people": people, "engine": engine, "time": time, "median (ms)": float(median)}
    figures("Time of a step", {**row, "99th percentile (ms)": None if last is None else float(last)})


def test_a_step_of_the_chain_is_a_fraction_of_gtsams(record: Record, figures: Figures) -> None:
    """At 25 frames a second, 50 in the window, with the preset joint and its default constants."""
    seen = list(observations(walk(700, seed=1, dt=0.04)))
    ours, theirs = (
        OnlineSmoother("joint", engine=engine, constants="default") for engine in ("chain", "fixed-lag")
    )
    spent, elapsed = [], []
    for observation in seen:
        start = time.perf_counter()
        spent.append(milliseconds(lambda o=observation: took_in(ours, o)))
        elapsed.append(1e3 * (time.perf_counter() - start))
    peer = float(np.median([milliseconds(lambda o=o: took_in(theirs, o)) for o in seen][100:]))
    mine, (median, late) = float(np.median(spent[100:])), np.quantile(elapsed[100:], (0.5, 0.99))
    show(figures, "one, 25 Hz", "chain", median, late, time="elapsed")
    show(figures, "one, 25 Hz", "fixed-lag", peer)
    record("online step, GTSAM joint / chain joint, processor time", peer / mine)
    assert peer > 2.5 * mine


@pytest.mark.parametrize("constants", ["default", "learn"])
def test_no_step_of_twenty_people_takes_much_longer_than_others(
    constants: Literal["default", "learn"], figures: Figures
) -> None:
    """Processor time of this thread, garbage collection included."""
    people = simulate("joint", n_tracks=20, n_steps=1000, fps=25.0, rng=np.random.default_rng(1))
    smoothers = [OnlineSmoother("joint", constants=constants) for _ in people]
    spent = []
    for seen in zip(*map(observations, people), strict=True):
        start = time.thread_time()
        OnlineSmoother.update_together(smoothers, seen)
        spent.append(1e3 * (time.thread_time() - start))
    median, late = np.quantile(spent[100:], (0.5, 0.99))
    show(figures, "twenty, 25 Hz", f"chain, constants {constants}", median, late)
    assert late < 3.0 * median


def test_a_step_costs_less_than_with_gtsams_fixed_lag(record: Record, figures: Figures) -> None:
    """At 10 frames a second, 20 in the window, all in turn; GTSAM's own with the factors of the model."""
    model, track = Model("joint"), walk(500, seed=1, noise=0.1, angle_kappa=2.0)
    isam2, fixed, chained = (
        OnlineSmoother(model, engine=engine, lag=LAG) for engine in ("isam2", "fixed-lag", "chain")
    )
    theirs = GtsamFixedLag(model)
    spent = np.array(
        [
            [
                *(milliseconds(lambda s=s, o=o: took_in(s, o)) for s in (isam2, fixed, chained)),
                milliseconds(lambda s=step: theirs.update(s)),
            ]
            for o, step in zip(observations(track), chain(track), strict=True)
        ]
    )[100:]
    mine, ours, compiled, peer = np.median(spent, axis=0)
    names = ("isam2", "fixed-lag", "chain", "GTSAM's fixed lag")
    for name, value in zip(names, (mine, ours, compiled, peer), strict=True):
        show(figures, "one, 10 Hz, in turn", name, value)
    record("online step, GTSAM's fixed lag / isam2 window, processor time", peer / mine)
    record("online step, fixed-lag / isam2 window, processor time", ours / mine)
    record("online step, isam2 window / chain, processor time", mine / compiled)
    # The fixed lag iterates each observation to convergence; GTSAM's own updates once.
    assert mine < peer and ours < 1.4 * peer


@pytest.mark.parametrize(
    ("lag", "count", "growth"),
    [(LAG, 4_000, 1.3), (LAG, 20_000, 1.3), (None, 4_000, 10.0)],
    ids=["window", "window for long", "full history"],
)
def test_the_cost_of_a_late_step(
    lag: float | None, count: int, growth: float, record: Record, figures: Figures
) -> None:
    """Old and young smoothers of both engines take the same observations in turn."""
    seen = list(observations(walk(count + 100, seed=1, noise=0.1, angle_kappa=2.0)))
    old, young = (OnlineSmoother("joint", engine="isam2", lag=lag) for _ in range(2))
    fixed_old, fixed_young = (OnlineSmoother("joint", engine="fixed-lag", lag=LAG) for _ in range(2))
    for k, observation in enumerate(seen[: count - 100]):
        for smoother in (old, fixed_old, *((young, fixed_young) if k >= count - 300 else ())):
            smoother.update(observation)
    spent = np.empty((200, 4))
    for k, o in enumerate(seen[count - 100 :]):
        # In alternation, since the run after the fixed lag finds its data in the caches.
        for i in ((0, 1, 2, 3), (1, 0, 3, 2))[k % 2]:
            smoother = (old, young, fixed_old, fixed_young)[i]
            spent[k, i] = milliseconds(lambda s=smoother, o=o: took_in(s, o))
    late, at_200, fixed, fixed_at_200 = np.median(spent, axis=0)
    mode = "full history" if lag is None else "window"
    show(figures, f"one, 10 Hz, step {count:,}", f"isam2, {mode}", late)
    show(figures, f"one, 10 Hz, step 200, with {count:,}", f"isam2, {mode}", at_200)
    show(figures, f"one, 10 Hz, step {count:,}", f"fixed-lag, in turn with isam2, {mode}", fixed)
    record(f"isam2 {mode}, step {count:,} / step 200, processor time", late / at_200)
    record(f"online step {count:,}, fixed-lag / isam2 {mode}, processor time", fixed / late)
    # GTSAM visits its whole tree wherever a variable is linearised again: of a full history that is linear in
    # the steps, here half as much.
    assert late < growth * at_200 and fixed < 1.3 * fixed_at_200
