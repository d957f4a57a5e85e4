"""Modes of the couplings with GTSAM: engine against engine, offline and online."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gaits import people
from walks import walk

from graphtrack.geometry.angles import difference
from graphtrack.inference import OnlineSmoother, smooth_track
from graphtrack.model import Model, Step, Term
from graphtrack.model.factors import von_mises_prior
from graphtrack.model.observation import observations
from graphtrack.tracks.track import Track

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


TRACKS = pytest.mark.parametrize("make", [side_stepping, classified, unseen_for_a_while])


def states(track: Track) -> np.ndarray:
    return np.column_stack([track.position, track.velocity, track.body, track.head])


def in_sigmas(a: np.ndarray, b: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Differences of states (n, 6), over their standard deviations."""
    found = a - b
    found[:, 4:] = difference(a[:, 4:], b[:, 4:])
    return np.abs(found) / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


def online(track: Track, **options: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimates (n, 6), covariances (n, 6, 6), and probability and offset (n, 2) of the modes."""
    smoother = OnlineSmoother("full", **options)
    found = [smoother.update(observation) for observation in observations(track)]
    assert {estimate.status for estimate in found} == {"new"}
    rows = np.array([[*e.position, *e.velocity, e.body, e.head] for e in found])
    modes = np.array([[e.aligned_p, e.gait_offset] for e in found])
    return rows, np.array([e.covariance for e in found]), modes


@TRACKS
def test_offline_gtsam_ends_where_the_chain_does(make: Any) -> None:
    track = make()
    chain, graph = (smooth_track(track, Model("full"), engine=engine) for engine in ("chain", "gtsam"))
    assert graph.converged
    assert in_sigmas(states(graph.track), states(chain.track), chain.track.covariance).max() < 2e-3
    assert graph.cost == pytest.approx(chain.cost, abs=1e-3)
    np.testing.assert_allclose(graph.track.aligned_p, chain.track.aligned_p, atol=1e-4)
    assert np.abs(difference(graph.track.gait_offset, chain.track.gait_offset)).max() < 1e-3


@TRACKS
@GTSAM_ENGINES
def test_online_gtsam_is_within_the_uncertainty_of_the_chain(make: Any, engine: Any, lag: Any) -> None:
    """One Gauss–Newton step each leaves that much; with class likelihoods they converge slowly."""
    track = make()
    chain, covariance, modes = online(track, engine="chain", lag=1.0)
    found, _, found_modes = online(track, engine=engine, lag=lag)
    # Before a second has passed modes are judged by velocities of which hardly anything is known.
    settled = track.t > track.t[0] + 1.0
    found, chain, covariance, found_modes, modes = (
        rows[settled] for rows in (found, chain, covariance, found_modes, modes)
    )
    apart, classes = in_sigmas(found, chain, covariance), make is classified
    assert np.median(apart) < (0.2 if classes else 0.05)
    assert np.sqrt(np.mean(apart**2)) < (0.4 if classes else 0.2)
    assert apart.max() < 1.5
    # Of a full history they are inferred in more than 1 s.
    assert np.abs(found_modes[:, 0] - modes[:, 0]).max() < 0.05
    assert np.abs(difference(found_modes[:, 1], modes[:, 1])).max() < 0.05


@GTSAM_ENGINES
def test_late_observations_and_saved_states_keep_the_modes(engine: Any, lag: Any) -> None:
    track = side_stepping(3.0)
    seen = list(observations(track))
    seen[60], seen[61] = seen[61], seen[60]
    options: dict[str, Any] = {"engine": engine, "lag": lag}
    smoother = OnlineSmoother("full", **options)
    whole = [smoother.update(observation) for observation in seen]
    assert whole[61].status == "late"
    smoother = OnlineSmoother("full", **options)
    for k, observation in enumerate(seen):
        found = smoother.update(observation)
        if k in (40, 70):
            smoother = OnlineSmoother.from_state(smoother.state(), "full", **options)
    np.testing.assert_allclose(found.position, whole[-1].position, atol=1e-3)
    assert abs(difference(found.body, whole[-1].body)) < 1e-2
    assert found.aligned_p == pytest.approx(whole[-1].aligned_p, abs=1e-3)


class Aside(Term):
    """A custom factor without a kernel: the head is near a direction of its own, with κ = 20."""

    uses = frozenset({"head"})

    def cost(self, states: Any, track: Track, camera: Any = None) -> float:
        return float(20.0 * np.sum(1.0 - np.cos(states.head - 2.6)))

    def factors(self, step: Step) -> Sequence[Any]:
        return [von_mises_prior(step.head_key, 2.6, 20.0)]


@GTSAM_ENGINES
def test_a_term_without_a_kernel_pulls_beside_modes(engine: Any, lag: Any) -> None:
    track, model = side_stepping(1.0), Model("full", terms=[Aside])
    with_it = [OnlineSmoother(m, engine=engine, lag=lag) for m in (model, Model("full"))]
    for seen in observations(track):
        pulled, free = (smoother.update(seen) for smoother in with_it)
    assert abs(difference(pulled.head, 2.6)) < 0.5 * abs(difference(free.head, 2.6))
    assert OnlineSmoother(model).engine == "isam2"  # the chain cannot follow it
