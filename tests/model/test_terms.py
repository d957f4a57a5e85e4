"""One battery for all terms: a new term is one line in `CASES`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B
from hypothesis import given, settings
from hypothesis import strategies as st
from kernels import called, empty_sums, evaluate, packed_alone, rows_of
from scipy import stats
from scipy.linalg import expm
from walks import scores

from graphtrack.geometry.angles import class_kappa, highest_log_density, mixture_log_density
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.basin_search import add_grid_costs
from graphtrack.inference.chain.initialisation import pack, problem_of
from graphtrack.inference.state import values_of
from graphtrack.kernels.arithmetic import note_turns
from graphtrack.kernels.layout import BODY, BOTH, HEAD, STATE_SLICES, Chain
from graphtrack.model import (
    CouplingParameters,
    LikelihoodParameters,
    Model,
    MotionParameters,
    Parameters,
    States,
    Term,
    presets,
    program,
)
from graphtrack.model.generator import OF_PRESETS, package_source
from graphtrack.model.model import every_term
from graphtrack.model.observation import chain
from graphtrack.model.packing import PackedTracks
from graphtrack.model.parameters import SocialParameters
from graphtrack.model.term import filled
from graphtrack.model.terms.conversation import FacesGroup, OrientationPersistence
from graphtrack.model.terms.couplings import BodyFollowsMotion, HeadFollowsBody
from graphtrack.model.terms.motion import IntentionalMotion, Motion
from graphtrack.model.terms.orientation import (
    Anchor,
    BodyDynamics,
    BodyLikelihood,
    HeadDynamics,
    HeadLikelihood,
)
from graphtrack.model.terms.position import PositionLikelihood
from graphtrack.tracks.track import Track

PI = float(np.pi)
CAMERA = GroundCamera(np.array([[0.02, 0.001, -9.0], [0.0005, -0.03, 14.0], [0.0, 0.0008, 1.0]]))
DensityOf = Callable[[States, Track, Parameters], float]


# The densities once more, from SciPy and straight from the definitions.


def motion_density(states: States, track: Track, parameters: Parameters) -> float:
    """The acceleration is white: mean and covariance of a step by the matrix exponential (Van Loan)."""
    drift, diffusion = np.zeros((4, 4)), np.zeros((4, 4))
    drift[:2, 2:] = np.eye(2)
    diffusion[2:, 2:] = parameters.motion.acceleration_density * np.eye(2)
    state = np.hstack([states.position, states.velocity])
    total = np.sum(stats.norm.logpdf(states.velocity[0], scale=parameters.motion.initial_speed_std))
    for k, dt in enumerate(np.diff(track.t)):
        both = expm(np.block([[-drift, diffusion], [np.zeros((4, 4)), drift.T]]) * dt)
        transition = both[4:, 4:].T
        noise = transition @ both[:4, 4:]
        deviation = state[k + 1] - transition @ state[k]
        total += -0.5 * deviation @ np.linalg.solve(noise, deviation)
    return float(total)


def steered_density(states: States, track: Track, parameters: Parameters) -> float:
    """The noise of position and velocity about an aim that holds for the step, by the matrix exponential."""
    epsilon, given = 0.01, track.inputs.get("head_rate", np.full(len(track), np.nan))
    drift, diffusion = np.zeros((6, 6)), np.zeros((6, 6))
    diffusion[2:4, 2:4] = parameters.motion.acceleration_density * np.eye(2)
    total = np.sum(stats.norm.logpdf(states.velocity[0], scale=parameters.motion.initial_speed_std))
    for k, dt in enumerate(np.diff(track.t)):
        rate = given[k + 1] if np.isfinite(given[k + 1]) else parameters.motion.head_rate
        drift[:2, 2:4], drift[2:4, 2:4], drift[2:4, 4:] = np.eye(2), -rate * np.eye(2), rate * np.eye(2)
        both = expm(np.block([[-drift, diffusion], [np.zeros((6, 6)), drift.T]]) * dt)
        transition = both[6:, 6:].T
        noise = (transition @ both[:6, 6:])[:4, :4]
        speed = np.hypot(np.linalg.norm(states.velocity[k]), epsilon) - epsilon
        aim = speed * np.array([np.cos(states.head[k]), np.sin(states.head[k])])
        before = np.concatenate([states.position[k], states.velocity[k], aim])
        after = np.concatenate([states.position[k + 1], states.velocity[k + 1]])
        deviation = after - (transition @ before)[:4]
        total += -0.5 * deviation @ np.linalg.solve(noise, deviation)
    return float(total)


def turning_density(name: str) -> DensityOf:
    def density(states: States, track: Track, parameters: Parameters) -> float:
        diffusion = getattr(parameters.orientation, f"{name}_diffusion")
        turn = np.diff(getattr(states, name))
        return float(np.sum(stats.vonmises.logpdf(turn, 1.0 / (diffusion * np.diff(track.t)))))

    return density


def metres_density(states: States, track: Track, parameters: Parameters) -> float:
    std = parameters.likelihood.position_std
    return float(np.sum(stats.norm.logpdf(states.position - track.position, scale=std)))


def ellipse_density(states: States, track: Track, parameters: Parameters) -> float:
    noise = parameters.likelihood.position_scale**2 * track.position_covariance
    misses = states.position - track.position
    return float(sum(stats.multivariate_normal.logpdf(m, cov=c) for m, c in zip(misses, noise, strict=True)))


def velocity_density(states: States, track: Track, parameters: Parameters) -> float:
    """Of the velocities; that of positions is stated elsewhere."""
    covariance = track.observed_velocity_covariance
    if covariance is None:
        covariance = np.tile(parameters.likelihood.velocity_std**2 * np.eye(2), (len(track), 1, 1))
    misses = states.velocity - track.observed_velocity
    of_velocities = (
        stats.multivariate_normal.logpdf(m, cov=c) for m, c in zip(misses, covariance, strict=True)
    )
    return float(sum(of_velocities)) + metres_density(states, track, parameters)


def axis_density(states: States, track: Track, parameters: Parameters) -> float:
    """Von Mises of twice the angle, of a curvature κ at either end."""
    deviation = 2.0 * (states.body - track.body_axis)
    return float(np.sum(stats.vonmises.logpdf(deviation, parameters.likelihood.body_kappa / 4.0)))


def pixels_density(states: States, track: Track, parameters: Parameters) -> float:
    miss = CAMERA.ground_to_image(states.position) - track.pixel
    return float(np.sum(stats.norm.logpdf(miss, scale=parameters.likelihood.pixel_std)))


def angle_density(name: str) -> DensityOf:
    def density(states: States, track: Track, parameters: Parameters) -> float:
        kappa = getattr(parameters.likelihood, f"{name}_kappa")
        deviation = getattr(states, name) - getattr(track, name)
        outlier = parameters.likelihood.outliers(name)
        return float(
            np.sum(np.log(outlier / (2 * PI) + (1 - outlier) * stats.vonmises.pdf(deviation, kappa)))
        )

    return density


def class_density(name: str) -> DensityOf:
    def density(states: States, track: Track, parameters: Parameters) -> float:
        weights = getattr(track, f"{name}_likelihood")
        n = weights.shape[1]
        outlier = parameters.likelihood.class_outlier_probability
        deviation = getattr(states, name)[:, None] - 2 * PI * np.arange(n) / n
        shares = weights / weights.sum(axis=1, keepdims=True)
        common = shares.min(axis=1)
        own = np.sum((shares - common[:, None]) * stats.vonmises.pdf(deviation, (n / PI) ** 2), axis=1)
        return float(np.sum(np.log((outlier + (1 - outlier) * n * common) / (2 * PI) + (1 - outlier) * own)))

    return density


@dataclass(frozen=True)
class Case:
    """A term in the battery.

    Attributes
    ----------
    term, parameters : what is tested
    density : the log density up to a constant, stated independently; None: not stated
    channels : the channels of the track that the term sees
    rates : the input ``head_rate`` of the three frames, if it is given
    """

    name: str
    term: type[Term]
    parameters: Parameters = Parameters()  # noqa: RUF009
    density: DensityOf | None = None
    channels: tuple[str, ...] = ("position",)
    rates: tuple[float, ...] = ()


def likelihood(**values: Any) -> Parameters:
    return Parameters(likelihood=LikelihoodParameters(**values))


def coupling(**values: Any) -> Parameters:
    return Parameters(coupling=CouplingParameters(**values))


def steering(rate: float) -> Parameters:
    return Parameters(MotionParameters(head_rate=rate))


SHARP = likelihood(body_kappa=1e4, head_kappa=1e4, body_outliers=0.05, head_outliers=0.05)
OUTLIERS = likelihood(body_outliers=0.1, head_outliers=0.1)
PERSISTENT = likelihood(class_correlation_time=1.0)
NO_CLASS_OUTLIERS = likelihood(class_outlier_probability=0.0)
STEERED: dict[str, Any] = {"density": steered_density}
MIXED_8: dict[str, Any] = {"channels": ("body_likelihood",)}
MIXED_12: dict[str, Any] = {"channels": ("head_likelihood",)}
ELLIPSES: dict[str, Any] = {"channels": ("position", "position_covariance")}
VELOCITIES = ("position", "observed_velocity", "observed_velocity_covariance")
SEEN_BODY: dict[str, Any] = {"channels": ("body",)}
SEEN_HEAD: dict[str, Any] = {"channels": ("head",)}

CASES = [
    Case("motion", Motion, density=motion_density),
    Case("steered", IntentionalMotion, **STEERED),
    Case("steered strongly", IntentionalMotion, steering(20.0), **STEERED),
    Case("steered weakly", IntentionalMotion, steering(1e-3), **STEERED),
    Case("steered by nothing", IntentionalMotion, steering(0.0), density=motion_density),
    Case("steered, a rate for each step", IntentionalMotion, rates=(9.0, 0.0, 4.0), **STEERED),
    Case("steered, a rate for one step", IntentionalMotion, rates=(math.nan, 0.3, math.nan), **STEERED),
    Case("body dynamics", BodyDynamics, density=turning_density("body")),
    Case("head dynamics", HeadDynamics, density=turning_density("head")),
    Case("body follows motion", BodyFollowsMotion),
    Case("body follows motion, each frame", BodyFollowsMotion, coupling(correlation_time=0.0)),
    Case("body follows any motion", BodyFollowsMotion, coupling(speed_threshold=0.0)),
    Case("body follows motion, sharp", BodyFollowsMotion, coupling(motion_body_kappa=1e4)),
    Case("body follows no motion", BodyFollowsMotion, coupling(motion_body_kappa=0.0)),
    Case("head follows body", HeadFollowsBody),
    Case("head follows body, sharp", HeadFollowsBody, coupling(head_body_kappa=1e4)),
    Case("head follows no body", HeadFollowsBody, coupling(head_body_kappa=0.0)),
    Case("metres", PositionLikelihood, density=metres_density),
    Case("metres, Huber", PositionLikelihood, likelihood(robust="huber")),
    Case("metres, Cauchy", PositionLikelihood, likelihood(robust="cauchy")),
    Case("ellipses", PositionLikelihood, density=ellipse_density, **ELLIPSES),
    Case("scaled ellipses", PositionLikelihood, likelihood(position_scale=3.0), ellipse_density, **ELLIPSES),
    Case("ellipses, Cauchy", PositionLikelihood, likelihood(robust="cauchy"), **ELLIPSES),
    Case("velocities", PositionLikelihood, density=velocity_density, channels=VELOCITIES[:2]),
    Case("velocities, ellipses", PositionLikelihood, density=velocity_density, channels=VELOCITIES),
    Case("body axis", BodyLikelihood, density=axis_density, channels=("body_axis",)),
    Case("body axis, sharp", BodyLikelihood, likelihood(body_kappa=1e4), channels=("body_axis",)),
    Case("body axis and angle", BodyLikelihood, OUTLIERS, channels=("body_axis", "body")),
    Case("pixels", PositionLikelihood, density=pixels_density, channels=("position", "pixel")),
    Case("pixels, Cauchy", PositionLikelihood, likelihood(robust="cauchy"), channels=("position", "pixel")),
    Case("body angle", BodyLikelihood, density=angle_density("body"), **SEEN_BODY),
    Case("head angle", HeadLikelihood, density=angle_density("head"), **SEEN_HEAD),
    Case("body angle, outliers", BodyLikelihood, OUTLIERS, angle_density("body"), **SEEN_BODY),
    Case("body angle, sharp, outliers", BodyLikelihood, SHARP, angle_density("body"), **SEEN_BODY),
    Case("body angle, sharp", BodyLikelihood, likelihood(body_kappa=1e4), **SEEN_BODY),
    Case("body angle without weight", BodyLikelihood, likelihood(body_kappa=0.0), **SEEN_BODY),
    Case("8 body classes", BodyLikelihood, density=class_density("body"), **MIXED_8),
    Case("12 head classes", HeadLikelihood, density=class_density("head"), **MIXED_12),
    Case("8 body classes that persist", BodyLikelihood, PERSISTENT, **MIXED_8),
    Case("12 head classes that persist", HeadLikelihood, PERSISTENT, **MIXED_12),
    Case("faces companions", FacesGroup),
    Case("holds still", OrientationPersistence),
    Case("holds still, firmly", OrientationPersistence, Parameters(social=SocialParameters(body_hold=100.0))),
    Case("faces companions, sharp", FacesGroup, Parameters(social=SocialParameters(1e3, 1e3, 0.05))),
    Case("8 body classes, no outliers", BodyLikelihood, NO_CLASS_OUTLIERS, class_density("body"), **MIXED_8),
]


def every(cases: list[Case]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("case", cases, ids=lambda case: case.name)


EVERY_CASE = every(CASES)
DEFINED = every([case for case in CASES if case.density is not None])
SEARCHED = every([case for case in CASES if any(kernel.orientation for kernel in case.term.kernels)])
OF_OBSERVATIONS = every(
    [case for case in CASES if case.term in (PositionLikelihood, BodyLikelihood, HeadLikelihood)]
)
SPEEDS = np.array([0.05, 0.12, 0.129, 0.131, 0.14, 1e-3])
DEVIATIONS = np.array([0.0, PI, PI - 1e-9, -PI + 1e-9, PI - 1e-3, 1e-6])
"""Values at which something changes its sign or its kind."""


def somewhere(
    rng: np.random.Generator, special: np.ndarray, low: float, high: float, shape: Any
) -> np.ndarray:
    """Uniform numbers, a third of them among the special ones."""
    return np.where(rng.random(shape) < 1 / 3, rng.choice(special, shape), rng.uniform(low, high, shape))


def situation(seed: int, n: int = 3) -> tuple[States, Track]:
    """States and observations of a few frames, anywhere: far from the optimum, opposite, slow."""
    rng = np.random.default_rng(seed)
    directions, speeds = rng.uniform(-PI, PI, n), somewhere(rng, SPEEDS, 0.02, 4.0, n)
    deviations = somewhere(rng, DEVIATIONS, -PI, PI, (4, n))
    body = directions + deviations[0]
    body[1:] = np.where(rng.random(n - 1) < 0.5, body[:-1] + deviations[3, 1:], body[1:])
    head = body + deviations[1]
    position = rng.normal(0.0, 2.0, (n, 2))
    classes = [scores(angle + deviations[2], k, rng) for angle, k in ((body, 8), (head, 12))]
    if rng.random() < 0.5:
        classes = [np.where(rng.random(c.shape) < 0.7, 0.0, c) for c in classes]
        for c in classes:
            c[np.arange(n), rng.integers(c.shape[1], size=n)] = 1.0
    elsewhere = position + rng.choice([0.01, 1.0, 20.0]) * rng.normal(0.0, 0.1, (n, 2))
    seen = {"body": body + deviations[2], "head": head + deviations[2]}
    seen |= {"body_likelihood": classes[0], "head_likelihood": classes[1]}
    t, pixel = np.cumsum(rng.uniform(0.02, 0.5, n)), CAMERA.ground_to_image(elsewhere)
    group = np.column_stack([rng.normal(0.0, 2.0, (n, 2)), rng.uniform(0.1, 1.0, n)])
    roots = rng.normal(0.0, 0.3, (2, n, 2, 2)) + 0.1 * np.eye(2)
    position_covariance, velocity_covariance = np.einsum("knab,kncb->knac", roots, roots) + 1e-3 * np.eye(2)
    seen |= {"position_covariance": position_covariance, "body_axis": body + 0.5 * deviations[2]}
    seen |= {"observed_velocity": elsewhere, "observed_velocity_covariance": velocity_covariance}
    track = Track(1, np.arange(n), t, elsewhere, pixel=pixel, inputs={"group": group}, **seen)
    velocity = speeds[:, None] * np.column_stack([np.cos(directions), np.sin(directions)])
    return States(position, velocity, body, head), track


def every_situation(case: Case, count: int) -> Iterator[tuple[States, Track]]:
    """Situations of a case, away from the kink of the coupling where differences would reach across it."""
    for seed in range(count):
        states, track = situation(seed)
        off = np.linalg.norm(states.velocity, axis=1) - case.parameters.coupling.speed_threshold
        if case.term is not BodyFollowsMotion or np.all(np.abs(off) > 3e-4):
            yield states, seen_by(case, track)


def seen_by(case: Case, track: Track) -> Track:
    """The track with no orientations but those that the case sees."""
    channels = (
        "pixel",
        "body",
        "head",
        "body_likelihood",
        "head_likelihood",
        "body_axis",
        *ELLIPSES["channels"],
    )
    channels += VELOCITIES[1:]
    inputs = track.inputs | ({"head_rate": np.array(case.rates, float)} if case.rates else {})
    unseen = {name: None for name in channels if name not in (*case.channels, "position")}
    return replace(track, inputs=dict(inputs), **unseen)


def factors_of(case: Case, track: Track) -> list[gtsam.NonlinearFactor]:
    term = case.term(case.parameters)
    return [factor for step in chain(track, CAMERA) for factor in term.factors(step)]


def derivative(function: Callable[[np.ndarray], Any], at: np.ndarray, step: float = 1e-4) -> np.ndarray:
    """By differences of fourth order, one row for each number of ``at``."""
    rows = []
    for unit_vector in step * np.eye(len(at)):
        a, b, c, d = (np.asarray(function(at + k * unit_vector)) for k in (-2, -1, 1, 2))
        rows.append((a - 8.0 * b + 8.0 * c - d) / (12.0 * step))
    return np.array(rows)


@EVERY_CASE
def test_the_kernels_add_up_to_the_density_with_a_curvature_that_is_never_negative(case: Case) -> None:
    term = case.term(case.parameters)
    for states, track in every_situation(case, 8):
        packed, rows, total = packed_alone(term, track, CAMERA), rows_of(states), 0.0
        for k in range(len(track)):
            cost, gradient, block = evaluate(term, packed, k, rows[k - 1], rows[k], False)
            total += cost
            values, axes = np.linalg.eigh(block)
            assert values.min() >= -1e-12 * (1.0 + values.max())
            real = values > 1e-13 * (1.0 + values.max())
            along = axes.T @ gradient
            # The gradient lies in the block, and with it explains no more than there is.
            # Its square over a curvature that rounding hides is part of the cost.
            np.testing.assert_allclose(along[~real], 0.0, atol=1e-6 * (1.0 + values.max()))
            assert 0.5 * np.sum(along[real] ** 2 / values[real]) <= cost * (1.0 + 1e-8) + 1e-9
        assert total == pytest.approx(term.cost(states, track, CAMERA), rel=1e-9, abs=1e-9)


@EVERY_CASE
def test_gradient_and_curvature_are_the_derivatives_of_the_cost(case: Case) -> None:
    term = case.term(case.parameters)
    for states, track in every_situation(case, 4):
        packed, rows = packed_alone(term, track, CAMERA), rows_of(states)
        both = np.concatenate([rows[0], rows[1]])

        def at(both: np.ndarray, exact: bool = True, packed: Any = packed) -> Any:
            return evaluate(term, packed, 1, both[:6], both[6:], exact)

        cost, gradient, hessian = at(both)
        # Steps that are short compared with the angles and the speeds over which a sharp cost changes.
        step = 1e-4 / (1.0 + np.sqrt(np.abs(hessian).max()) / 30.0)
        expected = derivative(lambda x: at(x)[0], both, step)
        allowed = 1e-6 * (1.0 + np.abs(expected).max()) + 1e-11 * (1.0 + cost) / step
        np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=allowed)
        np.testing.assert_allclose(at(both, False)[1], gradient, rtol=1e-12, atol=1e-12)
        assert at(both, False)[0] == pytest.approx(cost, rel=1e-13)
        expected = derivative(lambda x: at(x)[1], both, step)
        allowed = 1e-6 * (1.0 + np.abs(expected).max()) + 1e-11 * (1.0 + np.abs(gradient).max()) / step
        np.testing.assert_allclose(hessian, expected, rtol=1e-5, atol=allowed)


@EVERY_CASE
def test_the_factors_have_the_cost_and_the_gradient_of_the_kernels(case: Case) -> None:
    term = case.term(case.parameters)
    for states, track in every_situation(case, 8):
        packed, rows = packed_alone(term, track, CAMERA), rows_of(states)
        steps = chain(track, CAMERA)
        values = values_of(steps, rows, Model("separate"))
        for k, step in enumerate(steps):
            cost, gradient, block = evaluate(term, packed, k, rows[k - 1], rows[k], False)
            error, found, curvature, derived = 0.0, np.zeros(12), np.zeros((12, 12)), True
            for factor in term.factors(step):
                error += factor.error(values)
                jacobian, right = factor.linearize(values).jacobian()
                places = np.concatenate([place_of(key, k) for key in factor.keys()])  # noqa: SIM118
                found[places] -= jacobian.T @ right
                curvature[np.ix_(places, places)] += jacobian.T @ jacobian
                derived = derived and isinstance(factor, gtsam.CustomFactor)
            size = 1.0 + np.abs(block).max()
            assert error == pytest.approx(cost, rel=1e-9, abs=1e-9)
            np.testing.assert_allclose(found, gradient, atol=1e-8 * size)
            # GTSAM's own factors may have another curvature of Gauss–Newton's kind.
            if derived:
                np.testing.assert_allclose(curvature, block, atol=1e-8 * size)


def place_of(key: int, k: int) -> np.ndarray:
    """Indices of a variable of frame k or of the previous one among 12 numbers."""
    symbol = gtsam.Symbol(key)
    first = {"x": 0, "v": 2, "b": 4, "h": 5}[chr(symbol.chr())] + 6 * (symbol.index() - k + 1)
    return np.arange(first, first + (2 if chr(symbol.chr()) in "xv" else 1))


@DEFINED
def test_the_written_density_is_the_one_of_the_definition(case: Case) -> None:
    term = case.term(case.parameters)
    for seed, (states, track) in enumerate(every_situation(case, 12)):
        rng = np.random.default_rng(seed)
        moved = States(*(value + rng.normal(0.0, 0.5, value.shape) for value in vars(states).values()))
        written = term.cost(moved, track, CAMERA) - term.cost(states, track, CAMERA)
        defined = case.density(states, track, case.parameters) - case.density(moved, track, case.parameters)
        assert written == pytest.approx(defined, rel=1e-8, abs=1e-7)


@EVERY_CASE
def test_a_term_declares_what_it_acts_on(case: Case) -> None:
    term = case.term(case.parameters)
    for states, track in every_situation(case, 5):
        packed, rows = packed_alone(term, track, CAMERA), rows_of(states)
        for k, step in enumerate(chain(track, CAMERA)):
            kernels = called(term, packed, k)
            said = [STATE_SLICES[name] for kernel in kernels for name in kernel.variables]
            free = np.ones(12, bool)
            for part in said:
                free[6:][part] = False
            for part in (STATE_SLICES[name] for kernel in kernels for name in kernel.before):
                free[:6][part] = False
            _, gradient, hessian = evaluate(term, packed, k, rows[k - 1], rows[k])
            assert not gradient[free].any() and not hessian[free].any()
            for factor in term.factors(step):
                symbols = [gtsam.Symbol(key) for key in factor.keys()]  # noqa: SIM118
                assert {symbol.index() for symbol in symbols} <= {k, k - 1}
                letters = {chr(symbol.chr()) for symbol in symbols} & {"b", "h"}
                assert letters <= {name[0] for name in term.uses}


@SEARCHED
def test_the_search_looks_up_what_the_kernels_cost(case: Case) -> None:
    term, bins = case.term(case.parameters), 24
    angles = 2.0 * PI * np.arange(bins) / bins
    searched = [kernel for kernel in term.kernels if kernel.orientation]
    for states, track in every_situation(case, 5):
        alone, rows = packed_alone(term, track, CAMERA), rows_of(states)
        packed = filled(PackedTracks.of([track], CAMERA, OF_PRESETS.types), [term])
        problem, n = problem_of(packed), len(track)
        local = rows.copy()
        local[:, :2] -= packed.origin[0]
        found = {name: np.zeros((n, bins)) for name in ("body", "head")}
        nodes = np.arange(n)
        cos, sin, whole = np.cos(angles), np.sin(angles), Chain(problem, 0, n, 0)
        add_grid_costs(whole, local, cos, sin, nodes, found["body"], found["head"])
        for k in range(n):
            for name, place in (("body", BODY), ("head", HEAD)):
                if not any(kernel.orientation == name for kernel in searched):
                    assert not found[name].any()
                    continue
                expected = costs_at(term, alone, k, rows[k], place, angles)
                np.testing.assert_allclose(
                    np.diff(found[name][k]), np.diff(expected), atol=1e-6 * (1.0 + np.ptp(expected))
                )


def costs_at(
    term: Term, packed: PackedTracks, k: int, row: np.ndarray, place: int, angles: np.ndarray
) -> np.ndarray:
    """Costs of a frame with one orientation at each of the angles."""
    turned = np.tile(row, (len(angles), 1))
    turned[:, place] = angles
    return np.array([evaluate(term, packed, k, row, other)[0] for other in turned])


@OF_OBSERVATIONS
def test_a_term_costs_nothing_where_nothing_was_seen(case: Case) -> None:
    n = 3
    nothing = {name: np.full((n, *shape), np.nan) for name, shape in (("position", (2,)), ("body", ()))}
    blank = Track(1, np.arange(n), np.arange(n) * 0.1, body_likelihood=np.full((n, 8), np.nan), **nothing)
    assert factors_of(case, blank) == []
    states = States(np.ones((n, 2)), np.ones((n, 2)), np.ones(n), np.ones(n))
    term = case.term(case.parameters)
    assert term.cost(states, blank, CAMERA) == 0.0
    assert not any(called(term, packed_alone(term, blank, CAMERA), k) for k in range(n))


def test_every_kernel_of_every_preset_is_in_the_battery() -> None:
    tried = {id(kernel) for case in CASES for kernel in case.term.kernels}
    held = {id(kernel) for kernel in Anchor.kernels}
    assert {id(kernel) for term in every_term() for kernel in term.kernels} <= tried | held


def test_the_frame_program_is_the_one_of_the_terms() -> None:
    assert Path(program.__file__).read_text(encoding="utf-8") == package_source()


@pytest.mark.parametrize("preset", presets)
def test_the_engine_adds_up_the_terms_of_a_model(preset: str) -> None:
    """The frame program against the terms' kernels one by one: cost, gradient and curvature."""
    model = Model(preset, OUTLIERS)
    for seed in range(10):
        states, track = situation(seed, 2)
        packed = pack([track], model, CAMERA)
        problem, rows = problem_of(packed), rows_of(states)
        packed.records["body_anchor"] = packed.records["head_anchor"] = 0.0
        local = rows.copy()
        local[:, :2] -= packed.origin[0]
        (sums, gradients, hessians), turns = empty_sums(), np.zeros((2, 4))
        start = local[0].copy()
        note_turns(0, local, turns)
        cost = program.add_frame(Chain(problem, 0, 2, 0), 1, local, start, True, BOTH, turns, sums)
        expected = [0.0, np.zeros(12), np.zeros((12, 12))]
        for term in model.terms:
            if term.kernels:
                parts = evaluate(term, packed_alone(term, track, CAMERA), 1, rows[0], rows[1])
                expected = [a + b for a, b in zip(expected, parts, strict=True)]
        # The kernels of white-noise acceleration and of metres give way to others of the same model.
        assert cost == pytest.approx(expected[0], rel=1e-10)
        np.testing.assert_allclose(gradients.ravel(), expected[1], rtol=1e-9, atol=1e-9)
        then, here = (np.tril(half) + np.tril(half, -1).T for half in hessians[:2])
        found = np.block([[then, hessians[2]], [hessians[2].T, here]])
        np.testing.assert_allclose(found, expected[2], rtol=1e-9, atol=1e-7)


# Mixtures.


@settings(max_examples=100)
@given(st.data())
def test_a_mixture_is_what_scipy_says(data: st.DataObject) -> None:
    n = data.draw(st.integers(1, 12))
    weight = st.one_of(st.just(0.0), st.floats(1e-6, 10.0))
    weights = np.array(data.draw(st.lists(weight, min_size=n, max_size=n).filter(any)))
    means = np.array(data.draw(st.lists(st.floats(-PI, PI), min_size=n, max_size=n)))
    kappa = data.draw(st.one_of(st.floats(0.01, 100.0), st.sampled_from([1e3, 1e4])))
    uniform = data.draw(st.sampled_from([0.0, 1e-6, 0.05, 0.9]))
    angle = data.draw(st.floats(-PI, PI))
    with np.errstate(divide="ignore"):
        logs = np.log(np.append(weights / weights.sum() * (1.0 - uniform), uniform / (2 * PI)))
    logs[:-1] += stats.vonmises.logpdf(np.angle(np.exp(1j * (angle - means))), kappa)
    (found,) = mixture_log_density(np.array([angle]), means, weights[None], kappa, uniform)
    assert found == pytest.approx(np.logaddexp.reduce(logs), abs=1e-8 + 1e-11 * kappa)
    assert found <= highest_log_density(kappa, uniform) + 1e-9


def test_scores_that_are_all_zero_say_nothing() -> None:
    track = Track(1, np.arange(1), np.zeros(1), np.zeros((1, 2)), body_likelihood=np.zeros((1, 8)))
    (factor,) = factors_of(Case("", BodyLikelihood), track)
    for angle in (0.0, 1.0, PI):
        values = gtsam.Values()
        values.insert(B(0), gtsam.Rot2(angle))
        assert factor.error(values) == pytest.approx(2.0 * class_kappa(8), abs=1e-12)
        assert np.abs(factor.linearize(values).jacobian()[0]).max() == 0.0
