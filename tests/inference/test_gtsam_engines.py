"""GTSAM's engines against the chain: iSAM2 in a window and over the full history."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from selection import others_slow
from walks import people, walk

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from graphtrack.inference import SolverOptions, smooth_track
from graphtrack.inference.online import OnlineSolver
from graphtrack.model import LikelihoodParameters, Model, Parameters, presets
from graphtrack.model.observation import observations
from graphtrack.tracks.track import Track

EXACTLY = SolverOptions(max_iterations=300, relative_tolerance=0.0, step_tolerance=1e-10)
CONVERGED: dict[str, Any] = {"relinearize_threshold": 1e-4, "step_tolerance": 1e-7, "max_iterations": 200}


def online(track: Track, model: Model | str, **options: Any) -> tuple[OnlineSolver, np.ndarray, np.ndarray]:
    """The smoother at the end, its estimates (n, 6), and covariances (n, 6, 6)."""
    smoother = OnlineSolver(model, **options)
    found = [smoother.update(observation) for observation in observations(track)]
    assert {estimate.status for estimate in found} == {"new"}
    states = [[*e.position, *e.velocity, e.body, e.head] for e in found]
    return smoother, np.array(states), np.array([e.covariance for e in found])


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Differences of states (..., 6): metres, m/s, radians."""
    found = a - b
    found[..., 4:] = difference(a[..., 4:], b[..., 4:])
    return found


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
    smoother, *_ = online(track, model, engine="isam2", lag=None, **options)
    batch = smooth_track(track, model, options=EXACTLY, engine="gtsam").track
    none = np.full(len(track), np.nan)
    angles = [none if a is None else a for a in (batch.body, batch.head)]
    expected = np.column_stack([batch.position, batch.velocity, *angles])
    found = np.array([state for _, state in smoother.history()])
    away = np.abs(apart(found, expected)) / np.sqrt(np.diagonal(batch.covariance, axis1=1, axis2=2))
    return away[np.isfinite(away)]


@pytest.mark.slow
@pytest.mark.parametrize(("model", "track"), problems())
def test_the_full_history_ends_at_the_batch_answer(model: Model, track: Track) -> None:
    away = in_sigmas(track, model, **CONVERGED)
    assert away.max() < 0.01
    away = in_sigmas(track, model)
    assert np.median(away) <= 0.03 and np.quantile(away, 0.99) <= 0.8


@pytest.mark.slow
@pytest.mark.parametrize("preset", others_slow(["separate", "joint"], ["joint"]))
def test_the_window_agrees_with_the_other_windows(preset: str) -> None:
    """They let frames go at the optimum; with the exact curvature there, or with GTSAM's."""
    track = walk(60, seed=2, noise=0.1, angle_kappa=3.0)
    _, found, covariance = online(track, preset, engine="isam2", lag=2.0, **CONVERGED)
    _, fixed, expected = online(track, preset, engine="fixed-lag", lag=2.0, **CONVERGED)
    _, chain, *_ = online(track, preset, engine="chain", lag=2.0)
    assert np.abs(apart(found, fixed)).max() < 1e-3
    spread = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    assert np.median(np.abs(apart(found, chain)) / spread) < 0.02
    assert np.quantile(np.abs(apart(found, chain)) / spread, 0.99) < 0.3
    assert np.abs((covariance - expected) / (spread[:, :, None] * spread[:, None])).max() < 1e-3


@pytest.mark.parametrize("engine", ["auto", "chain", "fixed-lag"])
def test_only_isam2_has_no_lag(engine: Any) -> None:
    with pytest.raises(InputError, match="isam2"):
        OnlineSolver("joint", engine=engine, lag=None)
    assert "lag none" in repr(OnlineSolver("joint", engine="isam2", lag=None))
    assert OnlineSolver("joint", engine="isam2").lag == OnlineSolver("joint", engine=engine).lag


@pytest.mark.slow
@pytest.mark.parametrize(("lag", "turn"), [(2.0, 2.0), (2.0, 3.1), (None, 3.1)])
def test_a_history_that_turns_round_is_followed(lag: float | None, turn: float) -> None:
    """Orientations that move far from their initial values must not be confused with others."""
    track, steps = walk(60, seed=3, noise=0.05, angle_kappa=20.0), np.arange(60)
    head = track.head + np.where(steps < 35, turn * steps / 17.0, 0.0)
    track = replace(track, head=head, head_kappa=np.where(steps < 35, 0.05, 30.0))
    _, found, *_ = online(track, "separate", engine="isam2", lag=lag, **CONVERGED)
    _, expected, *_ = online(track, "separate", engine="fixed-lag", lag=lag or 1e6, **CONVERGED)
    assert np.abs(apart(found[-10:], expected[-10:])).max() < 5e-3


@pytest.mark.slow
def test_a_late_observation_far_back_in_a_window_is_followed_to_the_end() -> None:
    """Farther back than steps are watched of a full history; only the oldest have far to go."""
    track, at = walk(200, seed=3, dt=0.02), np.arange(200) == 8
    track = replace(track, head=track.head + 3.0 * at, head_kappa=np.where(at, 500.0, 1.0))
    seen = list(observations(track))
    smoother = OnlineSolver("separate", engine="isam2", lag=20.0, **CONVERGED)
    assert [smoother.update(one).status for one in (*seen[:8], *seen[9:], seen[8])][-1] == "late"
    found = np.array([state for _, state in smoother.history()])
    batch = smooth_track(track, Model("separate"), options=EXACTLY).track
    assert np.abs(apart(found, states(batch))).max() < 1e-3


@pytest.mark.parametrize("preset", others_slow(sorted(presets), ["separate", "joint", "joint-intentional"]))
def test_every_preset_online_is_within_the_uncertainty_of_the_chain(preset: str) -> None:
    """With the defaults: the error of one Gauss–Newton step each, in standard deviations."""
    track = walk(40, seed=2, noise=0.1, angle_kappa=3.0)
    _, chained, covariance = online(track, preset, engine="chain", lag=2.0)
    known = np.isfinite(chained[-1])
    spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))[:, known]
    for engine, lag in (("isam2", 2.0), ("isam2", None), ("fixed-lag", 2.0)):
        _, found, *_ = online(track, preset, engine=engine, lag=lag)
        away = np.abs(apart(found, chained))[:, known] / spread
        assert np.median(away) < 0.03 and np.sqrt(np.mean(away**2)) < 0.1, (engine, lag)
        # A mode that is in doubt is so for longer where states are relinearised seldom.
        assert np.quantile(away, 0.99) < 0.6 and away.max() < 0.8, (engine, lag)


# Modes of the couplings.

GTSAM_ENGINES = pytest.mark.parametrize(
    ("engine", "lag"), [("fixed-lag", 1.0), ("isam2", 1.0), ("isam2", None)], ids=["fixed", "isam2", "full"]
)


def side_stepping(seconds: float = 2.0) -> Track:
    (track,) = people(np.radians(100.0), 1, seed=1, seconds=seconds)
    return track


def classified() -> Track:
    return walk(40, seed=5, noise=0.1, classes=True)


def unseen_for_a_while() -> Track:
    track = walk(60, seed=2, noise=0.1, angle_kappa=3.0)
    hidden = (np.arange(60) > 30) & (np.arange(60) < 45)
    return replace(track, position=np.where(hidden[:, None], np.nan, track.position))


TRACKS = pytest.mark.parametrize(
    "make", others_slow([side_stepping, classified, unseen_for_a_while], [classified, unseen_for_a_while])
)


def states(track: Track) -> np.ndarray:
    return np.column_stack([track.position, track.velocity, track.body, track.head])


@TRACKS
def test_offline_gtsam_ends_where_the_chain_does(make: Any) -> None:
    track = make()
    chain, graph = (smooth_track(track, Model("joint"), engine=engine) for engine in ("chain", "gtsam"))
    assert graph.converged
    spread = np.sqrt(np.diagonal(chain.track.covariance, axis1=1, axis2=2))
    assert np.abs(apart(states(graph.track), states(chain.track)) / spread).max() < 3e-3
    assert graph.cost == pytest.approx(chain.cost, abs=1e-3)


@pytest.mark.slow
@TRACKS
@GTSAM_ENGINES
def test_online_gtsam_is_within_the_uncertainty_of_the_chain(make: Any, engine: Any, lag: Any) -> None:
    """One Gauss–Newton step each leaves that much; with class likelihoods they converge slowly."""
    track = make()
    _, chain, covariance = online(track, "joint", engine="chain", lag=1.0)
    _, found, _ = online(track, "joint", engine=engine, lag=lag)
    # Before a second has passed velocities are hardly known.
    settled = track.t > track.t[0] + 1.0
    spread, classes = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)), make is classified
    away = np.abs(apart(found, chain) / spread)[settled]
    assert np.median(away) < (0.2 if classes else 0.05)
    assert np.sqrt(np.mean(away**2)) < (0.4 if classes else 0.2) and away.max() < 1.5
