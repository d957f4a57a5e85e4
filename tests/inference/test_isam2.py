"""iSAM2 in a window and over the full history; what it shares with the other engines is in `test_online`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from selection import others_slow
from walks import walk

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from graphtrack.inference import OnlineSmoother, SolverOptions, smooth_track
from graphtrack.model import LikelihoodParameters, Model, Parameters, presets
from graphtrack.model.observation import observations
from graphtrack.tracks.track import Track

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


# Where it ends.


def problems() -> list[Any]:
    def of(preset: str, **likelihood: Any) -> Model:
        return Model(preset, Parameters(likelihood=LikelihoodParameters(**likelihood)))

    angles = walk(40, seed=8, noise=0.1, angle_kappa=4.0)
    leaping = replace(angles, position=angles.position + 3.0 * (np.arange(40) % 13 == 7)[:, None])
    classes = walk(40, seed=8, noise=0.1, classes=True)
    return [
        pytest.param(of("joint"), angles, id="angles"),
        pytest.param(of("joint", robust="huber"), angles, id="huber"),
        pytest.param(of("joint", robust="cauchy"), leaping, id="cauchy with outliers"),
        pytest.param(of("intentional"), angles, id="intentional"),
        pytest.param(of("joint-intentional"), angles, id="joint-intentional"),
        pytest.param(of("joint"), classes, id="classes"),
    ]


def in_sigmas(track: Track, model: Model, **options: Any) -> np.ndarray:
    """Differences between the full history and the batch, in standard deviations."""
    smoother, _, _ = online(track, model, engine="isam2", lag=None, **options)
    batch = smooth_track(track, model, options=EXACTLY, engine="gtsam").track
    none = np.full(len(track), np.nan)
    angles = [none if a is None else a for a in (batch.body, batch.head)]
    expected = np.column_stack([batch.position, batch.velocity, *angles])
    found = np.array([state for _, state in smoother.history()])
    away = np.abs(apart(found, expected)) / np.sqrt(np.diagonal(batch.covariance, axis1=1, axis2=2))
    return away[np.isfinite(away)]


@pytest.mark.parametrize(("model", "track"), problems())
def test_the_full_history_ends_at_the_batch_answer(model: Model, track: Track) -> None:
    away = in_sigmas(track, model, **CONVERGED)
    assert away.max() < 0.01
    away = in_sigmas(track, model)
    assert np.median(away) <= 0.03 and np.quantile(away, 0.99) <= 0.8


@pytest.mark.parametrize("preset", others_slow(["separate", "joint"], ["joint"]))
def test_the_window_agrees_with_the_other_windows(preset: str) -> None:
    """They let frames go at the optimum; with the exact curvature there, or with GTSAM's."""
    track = walk(60, seed=2, noise=0.1, angle_kappa=3.0)
    _, found, covariance = online(track, preset, engine="isam2", lag=2.0, **CONVERGED)
    _, fixed, expected = online(track, preset, engine="fixed-lag", lag=2.0, **CONVERGED)
    _, chain, _ = online(track, preset, engine="chain", lag=2.0)
    assert np.abs(apart(found, fixed)).max() < 1e-3
    spread = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    assert np.median(np.abs(apart(found, chain)) / spread) < 0.02
    assert np.quantile(np.abs(apart(found, chain)) / spread, 0.99) < 0.3
    assert np.abs((covariance - expected) / (spread[:, :, None] * spread[:, None])).max() < 1e-3


@pytest.mark.parametrize("engine", ["auto", "chain", "fixed-lag"])
def test_only_isam2_has_no_lag(engine: Any) -> None:
    with pytest.raises(InputError, match="isam2"):
        OnlineSmoother("joint", engine=engine, lag=None)
    assert "lag none" in repr(OnlineSmoother("joint", engine="isam2", lag=None))
    assert OnlineSmoother("joint", engine="isam2").lag == OnlineSmoother("joint", engine=engine).lag


def test_likelihoods_of_classes_are_followed_as_closely_as_by_the_chain() -> None:
    """Their peaks are sharper than what an angle says: relinearised as seldom, the head would be 5° away."""
    away = []
    for seed in range(3):
        track = walk(100, seed=seed, classes=True)
        found, chained = (online(track, "joint", engine=engine, lag=2.0)[1] for engine in ("isam2", "chain"))
        away.append(np.degrees(np.abs(apart(found, chained))[:, 4:]).mean(axis=0))
    assert np.all(np.mean(away, axis=0) < (0.4, 1.5))


@pytest.mark.slow
@pytest.mark.parametrize(("lag", "turn"), [(2.0, 2.0), (2.0, 3.1), (None, 3.1)])
def test_a_history_that_turns_round_is_followed(lag: float | None, turn: float) -> None:
    """Orientations that turn out to be far from where they began must not be mistaken for others."""
    track, steps = walk(60, seed=3, noise=0.05, angle_kappa=20.0), np.arange(60)
    head = track.head + np.where(steps < 35, turn * steps / 17.0, 0.0)
    track = replace(track, head=head, head_kappa=np.where(steps < 35, 0.05, 30.0))
    _, found, _ = online(track, "separate", engine="isam2", lag=lag, **CONVERGED)
    _, expected, _ = online(track, "separate", engine="fixed-lag", lag=lag or 1e6, **CONVERGED)
    assert np.abs(apart(found[-10:], expected[-10:])).max() < 5e-3


@pytest.mark.parametrize("preset", sorted(presets))
def test_every_preset_online_is_within_the_uncertainty_of_the_chain(preset: str) -> None:
    """With the defaults: what one Gauss–Newton step each leaves, in standard deviations."""
    track = walk(40, seed=2, noise=0.1, angle_kappa=3.0)
    _, chained, covariance = online(track, preset, engine="chain", lag=2.0)
    known = np.isfinite(chained[-1])
    spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))[:, known]
    for engine, lag in (("isam2", 2.0), ("isam2", None), ("fixed-lag", 2.0)):
        _, found, _ = online(track, preset, engine=engine, lag=lag)
        away = np.abs(apart(found, chained))[:, known] / spread
        assert np.median(away) < 0.03 and np.sqrt(np.mean(away**2)) < 0.1, (engine, lag)
        # A mode that is in doubt is so for longer where states are relinearised seldom.
        assert np.quantile(away, 0.99) < 0.6 and away.max() < 0.8, (engine, lag)
