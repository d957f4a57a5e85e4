"""Terms from one function: derivatives, density, factor and answers, against independent ones."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
import sympy
from kernels import evaluate, packed_alone, rows_of
from selection import others_slow
from walks import walk

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from graphtrack.inference.chain.initialisation import initial_states
from graphtrack.kernels.layout import BODY, HEAD
from graphtrack.model.function_term import FunctionTerm
from graphtrack.model.generator import program_of
from graphtrack.model.observation import States


def looks_at(now: Any, x: float, y: float, kappa: float) -> Any:
    """The head turns to a point."""
    return gt.chord(kappa, now.head - sympy.atan2(y - now.y, x - now.x))


def keeps_speed(before: Any, now: Any, std: float) -> Any:
    """The speed changes by a random walk."""
    speeds = [sympy.sqrt(one.vx**2 + one.vy**2 + 0.01) for one in (before, now)]
    return (speeds[1] - speeds[0]) / (std * sympy.sqrt(now.dt))


def told(now: Any, std: float) -> Any:
    """The position is an input, and the body at least half as far as the head from another."""
    x, y = now.input("told", 2)
    return [(now.x - x) / std, (now.y - y) / std, sympy.Max(0, now.body - now.head / 2 - now.input("turn"))]


def turns_with(before: Any, now: Any, kappa: float) -> Any:
    """The head turns as the body does."""
    return gt.chord(kappa, (now.head - before.head) - (now.body - before.body))


def with_inputs(n: int = 12) -> gt.Track:
    track = walk(n, seed=2)
    told = track.position + 0.3
    told[::4] = np.nan
    return replace(track, inputs={"told": told, "turn": np.linspace(-1.0, 1.0, n)})


TERMS = [
    gt.term(looks_at, x=3.0, y=4.0, kappa=2.0),
    gt.term(keeps_speed, std=0.3),
    gt.term(told, std=0.5),
    gt.term(turns_with, kappa=3.0),
]


@pytest.mark.slow
@pytest.mark.parametrize("term", others_slow(TERMS, TERMS[1:3]), ids=repr)
def test_derivatives_are_those_of_the_cost(term: FunctionTerm) -> None:
    track = with_inputs()
    packed, rng = packed_alone(term, track), np.random.default_rng(0)
    rows = np.nan_to_num(rows_of(initial_states(track, gt.Model("joint"))))
    rows[:, BODY : HEAD + 1] += rng.normal(0.0, 0.4, (len(rows), 2))
    rows[:, 2:4] += 0.3
    for k in (1, 5, 8):
        ends = np.concatenate([rows[k - 1], rows[k]])

        def cost(both: np.ndarray, k: int = k) -> float:
            return float(evaluate(term, packed, k, both[:6], both[6:])[0])

        found = evaluate(term, packed, k, rows[k - 1], rows[k])
        steps = 1e-5 * np.eye(12)
        slope = np.array([(cost(ends + one) - cost(ends - one)) / 2e-5 for one in steps])
        np.testing.assert_allclose(found[1], slope, atol=2e-6, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("term", others_slow(TERMS, [TERMS[0], TERMS[3]]), ids=repr)
def test_the_factors_and_the_density_have_one_cost(term: FunctionTerm) -> None:
    track, model = with_inputs(), gt.Model("joint", terms=[term])
    graph, values = gt.graph_of(track, model)
    plain = gt.graph_of(track, "joint")[0].error(values)
    found = gt.tracks_of(values, track, model)[0]
    assert found.velocity is not None and found.body is not None and found.head is not None
    states = States(found.position, found.velocity, found.body, found.head)
    assert graph.error(values) - plain == pytest.approx(model.terms[-1].cost(states, track), rel=1e-9)
    assert graph.error(values) > plain


def test_a_term_without_derivatives_is_that_of_gtsams_own_factor() -> None:
    """A person near a point, as `PriorFactorPoint2` has it."""

    def near(now: Any, x: float, y: float, std: float) -> Any:
        return [(now.x - x) / std, (now.y - y) / std]

    track = walk(8, seed=1)
    graph, values = gt.graph_of(track, gt.Model("position", terms=[gt.term(near, x=1.0, y=2.0, std=0.4)]))
    plain, _ = gt.graph_of(track, "position")
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 0.4)
    for k in range(8):
        plain.push_back(gtsam.PriorFactorPoint2(gt.key_of("position", 1, k), np.array([1.0, 2.0]), noise))
    assert graph.error(values) == pytest.approx(plain.error(values), rel=1e-12)
    both = [gtsam.LevenbergMarquardtOptimizer(one, values).optimize() for one in (graph, plain)]
    one, two = (gt.tracks_of(found, track, "position")[0].position for found in both)
    np.testing.assert_allclose(one, two, atol=1e-6)


def test_two_of_one_function_are_two_terms() -> None:
    model = gt.Model("joint", terms=[gt.term(looks_at, x=k, y=4.0, kappa=1.0) for k in (0.0, 9.0)])
    one, two = model.terms[-2:]
    assert not {f.name for f in one.fields} & {f.name for f in two.fields}
    assert one.kernels[0].function is two.kernels[0].function
    assert repr(model) == "Model('joint', looks_at(x=0, y=4, kappa=1), looks_at(x=9, y=4, kappa=1))"
    again = pickle.loads(pickle.dumps(model))
    assert repr(again) == repr(model) and [t.label for t in again.terms] == [t.label for t in model.terms]


def test_names_of_numbers_and_inputs_do_not_collide() -> None:
    def near(now: Any, gate: float, x_0: float, x: float) -> Any:
        return [now.x - gate - now.input("x"), now.y - x - x_0]

    (term,) = gt.Model("position", terms=[gt.term(near, gate=1.0, x_0=2.0, x=3.0)]).terms[-1:]
    names = [field.name for field in (*term.fields, *term.shared)]
    assert len(names) == len(set(names)) == 5


# An engine of its own takes a minute to compile.


@pytest.mark.slow
def test_every_engine_has_one_answer() -> None:
    track = with_inputs(30)
    model = gt.Model(
        "joint", terms=[gt.term(looks_at, x=0.0, y=0.0, kappa=3.0), gt.term(keeps_speed, std=0.3)]
    )
    found = [gt.solve(track, model, engine=engine, constants="default")[0] for engine in ("chain", "gtsam")]
    one, two = (solution for solution in found if isinstance(solution, gt.Solution))
    assert one.cost == pytest.approx(two.cost, rel=1e-7)
    assert one.track.covariance is not None and two.track.covariance is not None
    np.testing.assert_allclose(difference(one.track.head, two.track.head), 0.0, atol=1e-4)
    np.testing.assert_allclose(one.track.covariance, two.track.covariance, atol=1e-6)
    for engine in ("chain", "isam2", "fixed-lag"):
        last = gt.track_online(track, model, engine=engine, lag=100.0, constants="default")
        assert difference(last.head[-1], one.track.head[-1]) == pytest.approx(0.0, abs=0.02)


def test_what_is_no_term_is_told() -> None:
    with pytest.raises(InputError, match=r"numbers x, y for looks_at.* x, y, kappa"):
        gt.term(looks_at, x=1.0, y=2.0)
    with pytest.raises(InputError, match="kappa = nan of looks_at"):
        gt.term(looks_at, x=1.0, y=2.0, kappa=float("nan"))
    with pytest.raises(InputError, match="by def"):
        gt.term(lambda now: now.x)

    def constant(now: Any, std: float) -> Any:
        return std

    with pytest.raises(InputError, match="constant of no variable"):
        gt.term(constant, std=1.0)
    with pytest.raises(InputError, match="a term"):
        gt.Model("joint", terms=[looks_at])  # type: ignore[list-item]
    track = replace(walk(5), inputs={"told": np.zeros(5), "turn": np.zeros(5)})
    with pytest.raises(InputError, match="input 'told' of one number"):
        gt.solve(track, gt.Model("joint", terms=[TERMS[2]]), engine="gtsam")


def favours_east(now: Any) -> Any:
    """The body likes to point to +x."""
    return gt.chord(1, now.body)


def test_a_term_brings_its_orientation_into_the_model() -> None:
    model = gt.Model("position", terms=[gt.term(favours_east)])
    (found,) = gt.solve(walk(8), model, engine="gtsam")
    assert isinstance(found, gt.Solution)
    assert found.track.body is not None and found.track.covariance is not None
    np.testing.assert_allclose(found.track.body, 0.0, atol=1e-4)
    assert found.track.head is None
    # The density is exp(cos θ), whose curvature at its top is 1.
    np.testing.assert_allclose(found.track.covariance[:, 4, 4], 1.0, rtol=1e-3)


def skewed(now: Any, low: float) -> Any:
    """A loss that only counts below a speed, with heavy tails."""
    speed = sympy.sqrt(now.vx**2 + now.vy**2 + 1e-6)
    return gt.Cost([low - speed], loss=lambda c: sympy.log(1 + c), where=speed < low)


@pytest.mark.slow
def test_a_cost_may_have_a_loss_and_a_condition() -> None:
    track = walk(8, seed=3)
    term, states = gt.term(skewed, low=1.5), initial_states(track, gt.Model("joint"))
    speed = np.sqrt(np.sum(states.velocity**2, axis=1) + 1e-6)
    expected = np.where(speed < 1.5, np.log1p(0.5 * (1.5 - speed) ** 2), 0.0)
    packed, rows = packed_alone(term, track), np.nan_to_num(rows_of(states))
    costs = [evaluate(term, packed, k, rows[k - 1], rows[k])[0] for k in range(8)]
    assert term.cost(states, track) == pytest.approx(expected.sum(), rel=1e-12)
    np.testing.assert_allclose(costs, expected, rtol=1e-12)


def named(name: str, place: float) -> Any:
    """A function of a given name."""

    def cost(now: Any, std: float) -> Any:
        return (now.x - place) / std

    cost.__name__ = name
    return cost


def test_functions_of_one_name_are_different_terms() -> None:
    """Also where the package has a cost function of that name."""
    track = walk(6, seed=2)
    terms = [gt.term(named("turning", place), std=0.5) for place in (0.0, 4.0)]
    model = gt.Model("joint", terms=terms)
    source = program_of(model).source()
    assert len(set(re.findall(r"def (add_turning\w*)\(", source))) == 2
    states = initial_states(track, gt.Model("joint"))
    expected = [np.sum(0.5 * ((states.position[:, 0] - place) / 0.5) ** 2) for place in (0.0, 4.0)]
    assert [one.cost(states, track) for one in model.terms[-2:]] == pytest.approx(expected)
    graph, values = gt.graph_of(track, model)
    plain = gt.graph_of(track, "joint")[0].error(values)
    assert graph.error(values) - plain == pytest.approx(sum(expected), rel=1e-9)


def test_an_angle_without_a_name_is_refused() -> None:
    for function in (unnamed_angle, unnamed_angle_before):
        with pytest.raises(InputError, match=r"now\.body or now\.head"):
            gt.term(function)


def unnamed_angle(now: Any) -> Any:
    """Of an angle that no kernel names."""
    return gt.chord(1, now.angle)


def unnamed_angle_before(before: Any, now: Any) -> Any:
    """The same in the previous frame."""
    return gt.chord(1, now.body, before.angle)
