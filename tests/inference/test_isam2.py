"""iSAM2 in a window and over the full history; what it shares with the other engines is in `test_online`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from selection import others_slow
from walks import walk

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, unit
from graphtrack.inference import OnlineSmoother, SolverOptions, smooth_track
from graphtrack.inference.graph import isam
from graphtrack.inference.graph.isam import Isam2
from graphtrack.inference.graph.linearizers import Beginning, FactorLinearizer, KernelLinearizer
from graphtrack.inference.graph.links import Link
from graphtrack.model import LikelihoodParameters, Model, Parameters, presets
from graphtrack.model.factors.derived import COUPLED
from graphtrack.model.observation import chain, observations
from graphtrack.tracks import Track

EXACTLY = SolverOptions(max_iterations=300, relative_tolerance=0.0, step_tolerance=1e-10)
CONVERGED: dict[str, Any] = {"relinearize_threshold": 1e-4, "step_tolerance": 1e-7, "max_iterations": 200}
BOTH_MODES = pytest.mark.parametrize("lag", [2.0, None], ids=["window", "full history"])


def online(track: Track, model: Model | str, **options: Any) -> tuple[OnlineSmoother, np.ndarray, np.ndarray]:
    """The smoother at the end, and its estimates (n, 6) and covariances (n, 6, 6)."""
    smoother = OnlineSmoother(model, **options)
    found = [smoother.update(observation) for observation in observations(track)]
    assert {estimate.status for estimate in found} == {"new"}
    states = [[*e.position, *e.velocity, e.body, e.head] for e in found]
    return smoother, np.array(states), np.array([e.covariance for e in found])


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Differences of states (..., 6): metres, m/s, radians."""
    found = a - b
    found[..., 4:] = difference(a[..., 4:], b[..., 4:])
    return found


@pytest.mark.parametrize("preset", ["joint", "intentional", "joint-intentional"])
@pytest.mark.parametrize("robust", others_slow(["none", "huber"], ["huber"]))
def test_the_full_history_ends_at_the_batch_answer(preset: str, robust: Any) -> None:
    model = Model(preset, Parameters(likelihood=LikelihoodParameters(robust=robust)))
    track = walk(40, seed=8, noise=0.1, angle_kappa=4.0)
    smoother, _, _ = online(track, model, engine="isam2", lag=None, **CONVERGED)
    batch = smooth_track(track, model, options=EXACTLY, engine="gtsam").track
    assert batch.velocity is not None and batch.head is not None
    body = np.full(40, np.nan) if batch.body is None else batch.body
    expected = np.column_stack([batch.position, batch.velocity, body, batch.head])
    found = np.array([state for _, state in smoother.history()])
    assert np.nanmax(np.abs(apart(found, expected))) < 2e-4


@pytest.mark.parametrize("preset", others_slow(["separate", "joint"], ["joint"]))
def test_the_window_agrees_with_the_other_windows(preset: str) -> None:
    """They let frames go at the optimum; with the exact curvature there, the kernels' other, or GTSAM's."""
    track = walk(60, seed=2, noise=0.1, angle_kappa=3.0)
    _, found, covariance = online(track, preset, engine="isam2", lag=2.0, **CONVERGED)
    _, fixed, expected = online(track, preset, engine="fixed-lag", lag=2.0, **CONVERGED)
    _, chain, _ = online(track, preset, engine="chain", lag=2.0)
    assert np.abs(apart(found, fixed)).max() < 1e-3
    spread = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    assert np.abs((covariance - expected) / (spread[:, :, None] * spread[:, None])).max() < 0.05
    assert np.median(np.abs(apart(found, chain)) / spread) < 0.02
    assert np.quantile(np.abs(apart(found, chain)) / spread, 0.99) < 0.3


@BOTH_MODES
def test_a_step_touches_no_more_of_a_long_track(lag: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    track = walk(500, seed=1, noise=0.1, angle_kappa=2.0)
    exchanged: list[int] = []
    eliminated: list[int] = []
    update = Isam2._update

    def spy(self: Isam2, gaussians: Any, new: Any = None) -> None:
        update(self, gaussians, new)
        exchanged.append(len(gaussians))
        eliminated.append(len(self._links) - max(0, self._changed - self._links[0].serial))

    monkeypatch.setattr(Isam2, "_update", spy)
    smoother, _, _ = online(track, "joint", engine="isam2", lag=lag)
    for counts in (exchanged, eliminated):
        young, old = np.mean(counts[100:300]), np.mean(counts[-150:])
        assert old < 1.3 * young
    assert max(eliminated[30:]) < 40
    assert (len(smoother.history()) == 500) == (lag is None)


@BOTH_MODES
@pytest.mark.parametrize("turn", others_slow([2.0, 3.1], [3.1]))
@pytest.mark.slow
def test_a_history_that_turns_round_is_followed(lag: float | None, turn: float) -> None:
    """Orientations that turn out to be far from where they began must not be mistaken for others."""
    track = walk(60, seed=3, noise=0.05, angle_kappa=20.0)
    assert track.head is not None
    head, kappa = track.head.copy(), np.full(60, 0.05)
    head[:35] += turn * np.linspace(0.0, 2.0, 35)
    kappa[35:] = 30.0
    track = replace(track, head=head, head_kappa=kappa)
    smoother, found, _ = online(track, "separate", engine="isam2", lag=lag, **CONVERGED)
    _, expected, _ = online(track, "separate", engine="fixed-lag", lag=2.0 if lag else 1e6, **CONVERGED)
    assert np.abs(apart(found[-10:], expected[-10:])).max() < 5e-3
    assert smoother.window is not None


@BOTH_MODES
def test_the_default_threshold_costs_little_accuracy(lag: float | None) -> None:
    """The default threshold stays far within the uncertainty of what exchanging all finds."""
    track = walk(80, seed=4, noise=0.1, angle_kappa=2.0)
    _, found, _ = online(track, "joint", engine="isam2", lag=lag)
    _, exact, covariance = online(track, "joint", engine="isam2", lag=lag, relinearize_threshold=1e-6)
    spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.sqrt(np.mean((apart(found, exact) / spread) ** 2)) < 0.1


@pytest.mark.parametrize("engine", ["auto", "chain", "fixed-lag"])
def test_only_isam2_has_no_lag(engine: Any) -> None:
    with pytest.raises(InputError, match="isam2"):
        OnlineSmoother("joint", engine=engine, lag=None)
    assert "lag none" in repr(OnlineSmoother("joint", engine="isam2", lag=None))
    assert OnlineSmoother("joint", engine="isam2").lag == OnlineSmoother("joint", engine=engine).lag


# Both ways to the Gaussians.


@BOTH_MODES
@pytest.mark.parametrize("seen", others_slow(["angles", "classes"], ["angles"]))
def test_kernels_and_factors_lead_to_the_same_estimates(
    lag: float | None, seen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where their curvatures differ, the steps to the optimum do; it is the same in the end."""
    track = walk(30, seed=6, noise=0.1, angle_kappa=4.0, classes=seen == "classes", uneven=True)
    _, kernels, spread = online(track, "joint-intentional", engine="isam2", lag=lag, **CONVERGED)
    monkeypatch.setattr(isam, "has_own_kernels", lambda model: True)
    smoother, factors, other = online(track, "joint-intentional", engine="isam2", lag=lag, **CONVERGED)
    assert isinstance(smoother._smoother._graph._linearizer, FactorLinearizer)
    assert np.abs(apart(kernels, factors)).max() < 1e-3
    deviations = [np.sqrt(np.diagonal(one, axis1=1, axis2=2)) for one in (spread, other)]
    np.testing.assert_allclose(*deviations, rtol=0.1)


@pytest.mark.parametrize("preset", sorted(presets))
def test_kernels_and_factors_have_the_same_gradient(preset: str) -> None:
    """Anywhere, of each step's own terms and of those that link it to the one before."""
    model, rng = Model(preset), np.random.default_rng(5)
    doubt, steering = 0.3, dict(zip(COUPLED[7:], (0.3, 0.05, 20.0, -4.0, 2.0), strict=True))
    couplings = {
        k: (1.5, *body, 0.7, *head, doubt, *steering.values())
        for k, (body, head) in enumerate(unit(rng.uniform(-np.pi, np.pi, (8, 2))))
    }
    track = walk(8, seed=5, classes=True, uneven=True)
    track = replace(track, head=track.true_head + rng.normal(0.0, 0.5, 8))
    found = []
    for kind in (KernelLinearizer, FactorLinearizer):
        linearizer, links = kind(model, couplings if model.has_modes else None), []
        beginning = Beginning((30.0, -20.0), (0.4, -0.3))
        linearizer.begin((), beginning)
        for serial, step in enumerate(chain(track)):
            state = np.random.default_rng(serial).normal((30.0, -20.0, 0.0, 0.0, 0.0, 0.0), 1.0)
            link = Link(step, beginning.coordinates(state.tolist(), model), serial)
            linearizer.add(link, links)
            links.append(link)
        linearizer.linearise(range(8), links)
        found.append([one.factor() for link in links for one in link.gaussians if one is not None])
    assert len(found[0]) == 15
    for kernels, factors in zip(*found, strict=True):
        # Linearised where the steps began, so that the linear part is the gradient there.
        np.testing.assert_allclose(kernels.linearTerm(), factors.linearTerm(), rtol=1e-9, atol=1e-9)
        assert np.linalg.eigvalsh(kernels.information()).min() > -1e-9
