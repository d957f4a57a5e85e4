"""The modes of `full` against the same model on GTSAM's hybrid factors, where all is inferred at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C
from hybrid import ALIGNED, ANEW, FREE, MODES, HybridTrack, state_hybrid
from hybrid_factors import body_coupling, head_coupling, offset_drawn, offset_kept
from hypotheses import HybridSolution, courses, smooth_by_gtsam, smooth_by_hypotheses

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, unit, wrap
from graphtrack.inference import smooth_track
from graphtrack.model import GaitParameters, Model, MotionParameters, Parameters, States, Step
from graphtrack.model.factors.custom import unit_noise
from graphtrack.model.observation import Observation
from graphtrack.model.terms.body_follows_motion import BodyFollowsMotion
from graphtrack.model.terms.head_follows_body import HeadFollowsBody
from graphtrack.simulation.degrade import add_noise
from graphtrack.tracks import Track, TrackSet

DT = 0.4
"""Seconds: beyond the time in which deviations persist, so that a frame counts once in both statements."""

PLAIN = GaitParameters(
    body_aligned=0.5,
    body_switching=0.1,
    body_strength=1.0,
    body_free_strength=1.0,
    body_lead=0.0,
    head_evidence=0.0,
    head_aligned=0.5,
    head_switching=0.1,
    head_strength=1.0,
    head_free_strength=1.0,
    head_lead=0.0,
    body_offset_kappa=0.0,
    head_offset_kappa=0.0,
)
"""What both statements have: no leads, and modes that differ by their offsets alone, of which any is as
likely. The head steers nobody."""


def person(offset: float, seed: int, n: int = 6, *, head: bool = True) -> Track:
    """Somebody who walks in a bend at 1.2 m/s with the body ``offset`` radians off the motion."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * DT
    course = rng.uniform(-np.pi, np.pi) + rng.uniform(-0.3, 0.3) * t
    body = wrap(course + offset)
    position = np.cumsum(1.2 * unit(course) * DT, axis=0)
    clean = TrackSet((Track(0, np.arange(n), t, position, body=body, head=body),))
    (track,) = add_noise(clean, position_std=0.1, body_kappa=4.0, head_kappa=6.0, rng=rng)
    return track if head else replace(track, head=None, head_kappa=None)


def model_of(**changes: float) -> Model:
    return Model("full", Parameters(MotionParameters(head_rate=0.0), gait=replace(PLAIN, **changes)))


def apart(exact: HybridSolution, found: Track) -> tuple[float, float, float, float]:
    """Greatest differences from the chain engine: probability, offset and body in degrees, metres."""
    return (
        float(np.abs(exact.aligned_p - found.aligned_p).max()),
        float(np.degrees(np.abs(difference(exact.gait_offset, found.gait_offset))).max()),
        float(np.degrees(np.abs(difference(exact.states.body, found.body))).max()),
        float(np.abs(exact.states.position - found.position).max()),
    )


@pytest.mark.parametrize("offset", [0.0, 0.5, 1.2, 2.5])
def test_modes_offsets_and_states_are_those_of_all_hypotheses(offset: float) -> None:
    # With nothing seen of the head, what is told of the body's mode is the same in both statements.
    tracks, model = [person(offset, seed, head=False) for seed in range(5)], model_of()
    found = [
        apart(smooth_by_hypotheses(track, model, max_changes=0), smooth_track(track, model).track)
        for track in tracks
    ]
    probability, degrees, body, position = np.median(found, axis=0)
    assert probability < 0.05 and degrees < 3.0 and body < 3.0 and position < 0.01
    # The most where the mode is in doubt.
    probability, degrees, body, position = np.max(found, axis=0)
    assert probability < 0.2 and degrees < 15.0 and body < 10.0 and position < 0.02


@pytest.mark.slow
def test_a_head_that_is_seen_tells_of_the_body_in_both() -> None:
    # The engine weighs what the head says of the body; all hypotheses together say how much that is.
    track = person(0.0, 1, 5)
    exact = smooth_by_hypotheses(track, model_of())
    said = [smooth_track(track, model_of(head_evidence=w)).track.aligned_p.mean() for w in (0.0, 0.5, 1.0)]
    assert said[0] < exact.aligned_p.mean() < said[2] + 0.1
    assert said[1] == pytest.approx(exact.aligned_p.mean(), abs=0.1)


@pytest.mark.parametrize("offset", [0.0, 1.2])
@pytest.mark.slow
def test_gtsam_eliminates_to_what_the_hypotheses_say_one_by_one(offset: float) -> None:
    track, model = person(offset, 0, 3), model_of()
    one_by_one, eliminated = smooth_by_hypotheses(track, model, max_changes=2), smooth_by_gtsam(track, model)
    np.testing.assert_allclose(eliminated.aligned_p, one_by_one.aligned_p, atol=0.05)
    np.testing.assert_allclose(eliminated.head_aligned_p, one_by_one.head_aligned_p, atol=0.05)
    offsets = difference(eliminated.gait_offset, one_by_one.gait_offset)
    assert np.degrees(np.abs(offsets)).max() < 5.0
    np.testing.assert_allclose(eliminated.states.position, one_by_one.states.position, atol=0.01)


def whole(stated: HybridTrack) -> gtsam.HybridNonlinearFactorGraph:
    graph = gtsam.HybridNonlinearFactorGraph()
    for k in range(len(stated.steps)):
        graph.push_back(stated.hybrid_graph_of(k))
    return graph


def possible(stated: HybridTrack) -> Iterator[np.ndarray]:
    """Courses of the modes that have a probability."""
    n = len(stated.steps)
    for both in product(product(range(MODES), repeat=n), repeat=2):
        if all(one[0] != FREE and (ALIGNED, FREE) not in pairwise(one) for one in both):
            yield np.array(both)


def test_gtsam_s_posterior_is_the_evidence_of_each_linearised_graph() -> None:
    stated = state_hybrid(
        person(0.8, 3, 2), model_of(body_strength=2.0, head_free_strength=0.3, head_offset_kappa=2.0)
    )
    graph = whole(stated)
    marginal = graph.linearize(stated.values).eliminateSequential().discreteMarginal()
    mine, theirs = [], []
    for course in possible(stated):
        chosen = gtsam.DiscreteValues()
        for k in range(2):
            chosen[C(k)] = int(course[0, k] * MODES + course[1, k])
        plain, cost = stated.graph_of(course)
        error = graph.error(gtsam.HybridValues(chosen, stated.values))
        assert error == pytest.approx(plain.error(stated.values) + cost, rel=1e-9)
        linear = plain.linearize(stated.values)
        network = linear.eliminateSequential()
        mine.append(-cost - linear.error(network.optimize()) - network.logDeterminant())
        theirs.append(np.log(marginal.evaluate(chosen)))
    normaliser = np.array(mine) - theirs
    np.testing.assert_allclose(normaliser, normaliser[0], atol=1e-6)


def test_the_chains_are_those_of_the_recursion() -> None:
    stated = state_hybrid(person(0.0, 0, 3), model_of(body_switching=0.7, body_aligned=0.2))
    np.testing.assert_allclose(stated.first.sum(axis=1), 1.0)
    np.testing.assert_allclose(stated.transitions.sum(axis=3), 1.0)
    kept = np.exp(-0.7 * DT)
    matrix = stated.transitions[0, 0]
    assert matrix[ALIGNED, ALIGNED] == pytest.approx(kept + (1.0 - kept) * 0.2)
    assert matrix[FREE, FREE] == matrix[ANEW, FREE] == pytest.approx(kept)
    assert matrix[ALIGNED, FREE] == 0.0
    # In the long run the share of the aligned mode is its probability.
    longrun = np.linalg.matrix_power(matrix, 200)
    np.testing.assert_allclose(longrun[:, ALIGNED], 0.2, rtol=1e-9)


def test_courses_are_all_that_are_possible() -> None:
    stated = {
        one
        for one in product(range(MODES), repeat=4)
        if one[0] != FREE and (ALIGNED, FREE) not in pairwise(one)
    }
    every = list(courses(4, 9))
    assert set(every) == stated and len(every) == len(stated)
    # Two that stay as they are, and at each of three places one change of the aligned, two of the free.
    few = list(courses(4, 1))
    assert set(few) <= stated and len(set(few)) == len(few) == 2 + 3 * 3


@pytest.mark.parametrize("seed", range(3))
def test_couplings_cost_what_the_terms_say_about_the_offset(seed: int) -> None:
    rng = np.random.default_rng(seed)
    step = Step(0, Observation(0.0))
    velocity, (body, head, phi, psi) = rng.normal(0.0, 1.0, 2), rng.uniform(-np.pi, np.pi, 4)
    values = gtsam.Values()
    values.insert(step.velocity_key, velocity)
    factors = [
        body_coupling(step, 3.0, 0.2),
        head_coupling(step, 2.0),
        offset_drawn([step.body_key, step.head_key], 0.4, 0.3, 1.7),
        offset_kept([step.body_key, step.head_key], 0.3),
    ]
    for key, angle in zip(
        (step.body_key, step.head_key, factors[0].keys()[2], factors[1].keys()[2]),
        (body, head, phi, psi),
        strict=True,
    ):
        values.insert(key, gtsam.Rot2(angle))
    coupling = replace(Parameters().coupling, motion_body_kappa=3.0, speed_threshold=0.2, head_body_kappa=2.0)
    parameters, track = Parameters(coupling=coupling), person(0.0, 0, 1)

    def cost(term: type, body: float, head: float) -> float:
        states = States(np.zeros((1, 2)), velocity[None], np.array([body]), np.array([head]))
        return float(term(parameters).cost(states, track))

    assert factors[0].error(values) == pytest.approx(cost(BodyFollowsMotion, body - phi, head))
    assert factors[1].error(values) == pytest.approx(cost(HeadFollowsBody, body, head - psi))
    about = 1.7 * (1.0 - np.cos(head))
    assert factors[2].error(values) == pytest.approx(0.5 * (wrap(head - 0.4) / 0.3) ** 2 + about)
    assert factors[3].error(values) == pytest.approx(0.5 * (wrap(head - body) / 0.3) ** 2)
    for factor in factors:
        gaussian = factor.linearize(values)
        matrix, right = gaussian.jacobian()
        at = 0
        for key in factor.keys():  # noqa: SIM118
            for axis in range(2 if key == step.velocity_key else 1):
                sides = []
                for sign in (1.0, -1.0):
                    delta = gtsam.VectorValues()
                    delta.insert(key, sign * 1e-6 * np.eye(2 if key == step.velocity_key else 1)[axis])
                    sides.append(factor.whitenedError(values.retract(delta)))
                np.testing.assert_allclose((sides[0] - sides[1]) / 2e-6, matrix[:, at], atol=1e-5)
                at += 1
        np.testing.assert_allclose(-right, factor.whitenedError(values), atol=1e-12)
    assert unit_noise(2).dim() == 2


def test_what_is_no_short_track_of_full_is_refused() -> None:
    with pytest.raises(InputError, match="full"):
        state_hybrid(person(0.0, 0, 3), Model("joint"))
    with pytest.raises(InputError, match="13 frames"):
        smooth_by_hypotheses(person(0.0, 0, 13), Model("full"))
    with pytest.raises(InputError, match="5 frames"):
        smooth_by_gtsam(person(0.0, 0, 5), Model("full"))


@pytest.mark.slow
def test_table_of_the_agreement(capsys: pytest.CaptureFixture[str]) -> None:
    """Prints the table of docs/model.md: greatest differences in a track, median and most of 16 tracks."""
    people = [(offset, seed) for offset in (0.0, 0.5, 1.2, 2.5) for seed in range(10, 14)]
    cases: dict[str, tuple[bool, Model]] = {"head not seen": (False, model_of())}
    cases |= {f"head_evidence {w}": (True, model_of(head_evidence=w)) for w in (0.0, 0.2, 0.5, 1.0)}
    exact = {
        (head, one): smooth_by_hypotheses(person(*one, head=head), model_of())
        for head in (False, True)
        for one in people
    }
    with capsys.disabled():
        print("\n| | aligned_p | offset | body | position |\n|---|---|---|---|---|")
        for name, (head, model) in cases.items():
            found = [
                apart(exact[head, one], smooth_track(person(*one, head=head), model).track) for one in people
            ]
            p, degrees, body, position = np.median(found, axis=0)
            most = np.max(found, axis=0)
            print(
                f"| {name} | {p:.3f} ({most[0]:.2f}) | {degrees:.1f}° ({most[1]:.0f}°) "
                f"| {body:.1f}° ({most[2]:.0f}°) | {position:.4f} m ({most[3]:.3f} m) |"
            )
            assert np.isfinite(found).all()
