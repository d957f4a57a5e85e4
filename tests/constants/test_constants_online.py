"""Constants that are learned with every observation."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from noisy_walkers import sideways, walker
from selection import others_slow

import graphtrack as gt
from graphtrack.constants.commons import Commons
from graphtrack.constants.filters import motion_evidence, turning_evidence
from graphtrack.constants.online import Learner, OnlineSmoother
from graphtrack.constants.population import DENSITIES, DIFFUSIONS, Population
from graphtrack.errors import InputError
from graphtrack.geometry.angles import wrap
from graphtrack.model.observation import observations
from graphtrack.tracks.track import Track, TrackSet

ENGINES = ["chain", "fixed-lag", "isam2"]


def learned_of(track: Track, prior: Population | None = None) -> Learner:
    """The learner of a person after the observations of a track."""
    learner = Learner(gt.Model(), Population() if prior is None else prior)
    for one in observations(track):
        learner.observe(one)
    return learner


def followed(track: Track, **options: Any) -> tuple[OnlineSmoother, list[gt.Estimate]]:
    smoother = OnlineSmoother(**options)
    return smoother, [smoother.update(one) for one in observations(track)]


def test_the_evidence_is_that_of_the_whole_track_at_once() -> None:
    track, parameters = walker(3, n=80), gt.Model().parameters
    evidence = learned_of(track).evidence()
    density = motion_evidence([track], parameters, DENSITIES)[0][0]
    np.testing.assert_allclose(evidence.acceleration_density, density, rtol=1e-9)
    for name in ("body", "head"):
        turns = turning_evidence([track], name, parameters, DIFFUSIONS)[0]
        np.testing.assert_allclose(getattr(evidence, f"{name}_diffusion"), turns, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("engine", others_slow(ENGINES, ["chain", "isam2"]))
def test_who_faces_the_path_is_told_from_who_does_not(engine: Any) -> None:
    ahead, _ = followed(walker(1, n=150), engine=engine)
    aside, found = followed(sideways(2, n=150), engine=engine)
    names = [one for one in ahead.constants.coupling if one.startswith("body follows")]
    assert sum(ahead.constants.coupling[one] for one in names) > 0.9
    assert sum(aside.constants.coupling[one] for one in names) < 0.1
    track = sideways(2, n=150)
    fixed = gt.track_online(track, engine=engine, constants="default")
    off = [
        np.abs(wrap(np.array(body) - track.true_body))[50:].mean()
        for body in ([e.body for e in found], fixed.body)
    ]
    assert off[0] < 0.5 * off[1]


def test_alternatives_that_are_ruled_out_are_dropped() -> None:
    smoother, _ = followed(walker(1, n=3))
    assert len(smoother._solvers) == 4
    smoother, _ = followed(sideways(2, n=150))
    assert len(smoother._solvers) < 4


def test_an_alternative_that_was_ruled_out_comes_back() -> None:
    """Somebody who walks ahead for long, and then sideways."""
    first, second = walker(1, n=150, turn=0.1), sideways(2, n=400)
    shift = first.position[np.isfinite(first.position[:, 0])][-1]
    later = replace(second, t=second.t + first.t[-1] + 0.1, position=second.position + shift)
    smoother = OnlineSmoother()
    for one in observations(first):
        smoother.update(one)
    ahead = set(smoother._solvers)
    for one in observations(later):
        smoother.update(one)
    assert not set(smoother._solvers) <= ahead
    coupling = smoother.constants.coupling
    assert max(coupling, key=coupling.get) in ("free", "head follows body")


def test_a_state_of_other_constants_is_refused() -> None:
    learned, fixed = OnlineSmoother(), OnlineSmoother(constants="default")
    with pytest.raises(InputError, match="learned constants"):
        OnlineSmoother.from_state(learned.state(), constants="default")
    with pytest.raises(InputError, match="the constants of a model"):
        OnlineSmoother.from_state(fixed.state())


@pytest.mark.slow
def test_an_observation_that_fails_teaches_nothing() -> None:
    class Breaks(gt.Term):
        """A factor that raises when it is made in a frame with the input."""

        uses = frozenset({"body"})

        def cost(self, states: Any, track: Track, camera: Any = None) -> float:
            return 0.0

        def factors(self, step: Any) -> Any:
            if "breaks" in step.observation.inputs:
                raise ArithmeticError("breaks")
            return []

    smoother, _ = followed(walker(5, n=30), model=gt.Model(terms=[Breaks]), engine="fixed-lag")
    before, t = smoother.state(), smoother.window[1]
    one = gt.Observation(t=t + 0.1, position=(5.0, 5.0), inputs={"breaks": 1.0})
    assert smoother.update(one).status == "failed" and smoother.state() == before
    assert smoother.update(gt.Observation(t=t + 0.1, position=(0.0, 0.0))).status == "new"


def test_a_population_does_not_depend_on_the_order_of_its_people() -> None:
    people = [learned_of(walker(k, n=40 + 5 * k)) for k in range(6)]
    found = []
    for order in (people, people[::-1]):
        commons = Commons(Population())
        commons.refresh(0.0, dict(enumerate(order)))
        found.append(commons.population)
    assert found[0].people == pytest.approx(found[1].people)
    for name in ("acceleration_density", "body_diffusion", "head_diffusion", "coupling"):
        np.testing.assert_allclose(getattr(found[0], name), getattr(found[1], name), rtol=1e-12)


def test_those_who_left_are_the_prior_of_those_who_come() -> None:
    free = Population().coupling[0]
    commons = Commons(Population())
    for k in range(8):
        learner = learned_of(sideways(k, n=100), commons.population)
        commons.refresh(float(k), {0: learner})
        commons.leave(learner)
    commons.refresh(8.0, {})
    assert sum(commons.population.coupling[:2]) > 2.0 * free
    again = Commons(Population())
    again.restore(json.loads(json.dumps(commons.state())))
    assert again.population == commons.population and again.state() == commons.state()


@pytest.mark.slow
def test_a_recording_is_followed_in_the_order_of_time() -> None:
    """Who comes later has a prior of who was there; the first has none, whatever the order of the tracks."""
    first = [sideways(k, n=80, track_id=k) for k in range(4)]
    late = sideways(9, n=30, track_id=9)
    late = Track(
        9,
        late.frame,
        late.t + 60.0,
        late.position,
        **{
            name: getattr(late, name)
            for name in ("position_std", "body", "body_kappa", "head", "head_kappa", "true_body")
        },
    )
    both = gt.track_online(TrackSet((late, *first)))
    alone = gt.track_online(TrackSet((late,))).tracks[0]
    other = gt.track_online(TrackSet((*first[::-1], late)))
    np.testing.assert_allclose(both.by_id(9).position, other.by_id(9).position, atol=1e-9)
    assert np.abs(wrap(both.by_id(9).body - alone.body)).max() > 0.02
