"""One battery for all terms: a new term is one line in `CASES`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, H, V, X
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.linalg import expm
from walks import scores, walk

from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import smooth_track
from graphtrack.model import (
    CouplingParameters,
    FactorShapeError,
    LikelihoodParameters,
    Model,
    MotionParameters,
    Parameters,
    States,
    Step,
    Term,
    custom_factor,
)
from graphtrack.model.coupling import BodyFollowsMotion, HeadFollowsBody
from graphtrack.model.custom import numerical_jacobians
from graphtrack.model.intentional import IntentionalMotion
from graphtrack.model.motion import Motion
from graphtrack.model.orientation import BodyDynamics, HeadDynamics
from graphtrack.model.pose import (
    BodyLikelihood,
    HeadLikelihood,
    VonMisesMixture,
    class_centres,
    class_kappa,
    mixture_factor,
)
from graphtrack.model.position import PositionLikelihood
from graphtrack.model.steps import chain
from graphtrack.tracks import Track

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
    rate, epsilon = parameters.motion.head_rate, 0.01
    drift, diffusion = np.zeros((6, 6)), np.zeros((6, 6))
    drift[:2, 2:4], drift[2:4, 2:4], drift[2:4, 4:] = np.eye(2), -rate * np.eye(2), rate * np.eye(2)
    diffusion[2:4, 2:4] = parameters.motion.acceleration_density * np.eye(2)
    total = np.sum(stats.norm.logpdf(states.velocity[0], scale=parameters.motion.initial_speed_std))
    for k, dt in enumerate(np.diff(track.t)):
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


def pixels_density(states: States, track: Track, parameters: Parameters) -> float:
    assert track.pixel is not None
    miss = CAMERA.ground_to_image(states.position) - track.pixel
    return float(np.sum(stats.norm.logpdf(miss, scale=parameters.likelihood.pixel_std)))


def angle_density(name: str) -> DensityOf:
    def density(states: States, track: Track, parameters: Parameters) -> float:
        kappa = getattr(parameters.likelihood, f"{name}_kappa")
        deviation = getattr(states, name) - getattr(track, name)
        outlier = parameters.likelihood.outlier_probability
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
        mixed = np.sum(
            weights / weights.sum(axis=1, keepdims=True) * stats.vonmises.pdf(deviation, (n / PI) ** 2),
            axis=1,
        )
        return float(np.sum(np.log(outlier / (2 * PI) + (1 - outlier) * mixed)))

    return density


class FavouriteSpeed(Term):
    """A term as a user writes it: people like to walk at 1.2 m/s. No Jacobian is given."""

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        key = step.velocity_key

        def residual(values: gtsam.Values) -> np.ndarray:
            return np.array([(np.linalg.norm(values.atVector(key)) - 1.2) / 0.3])

        return [custom_factor([key], 1, residual)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        speed = np.linalg.norm(states.velocity, axis=1)
        return 0.5 * float(np.sum(((speed - 1.2) / 0.3) ** 2))


@dataclass(frozen=True)
class Case:
    """A term in the battery.

    Attributes
    ----------
    term, parameters : what is tested
    density : the log density up to a constant, stated independently; None: not stated
    least_squares : whether the Jacobian is the derivative of the residual. With robust losses and mixtures
        only the gradient is exact.
    channels : the channels of the track that the term sees
    """

    name: str
    term: type[Term]
    parameters: Parameters = Parameters()  # noqa: RUF009
    density: DensityOf | None = None
    least_squares: bool = True
    channels: tuple[str, ...] = ("position",)


def likelihood(**values: Any) -> Parameters:
    return Parameters(likelihood=LikelihoodParameters(**values))


def coupling(**values: Any) -> Parameters:
    return Parameters(coupling=CouplingParameters(**values))


def steering(rate: float) -> Parameters:
    return Parameters(motion=MotionParameters(head_rate=rate))


SHARP = likelihood(body_kappa=1e4, head_kappa=1e4, outlier_probability=0.05)
OUTLIERS = likelihood(outlier_probability=0.1)
NO_CLASS_OUTLIERS = likelihood(class_outlier_probability=0.0)
ROBUST: dict[str, Any] = {"least_squares": False}
MIXED_8: dict[str, Any] = {"least_squares": False, "channels": ("body_likelihood",)}
MIXED_12: dict[str, Any] = {"least_squares": False, "channels": ("head_likelihood",)}
SEEN_BODY: dict[str, Any] = {"channels": ("body",)}
SEEN_HEAD: dict[str, Any] = {"channels": ("head",)}
MIXED_BODY: dict[str, Any] = {"least_squares": False, "channels": ("body",)}

CASES = [
    Case("motion", Motion, density=motion_density),
    Case("intentional motion", IntentionalMotion, density=steered_density),
    Case("intentional motion, strong", IntentionalMotion, steering(20.0), density=steered_density),
    Case("intentional motion, weak", IntentionalMotion, steering(1e-3), density=steered_density),
    Case("intentional motion, none", IntentionalMotion, steering(0.0), density=motion_density),
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
    Case("metres, Huber", PositionLikelihood, likelihood(robust="huber"), **ROBUST),
    Case("metres, Cauchy", PositionLikelihood, likelihood(robust="cauchy"), **ROBUST),
    Case("pixels", PositionLikelihood, density=pixels_density, channels=("position", "pixel")),
    Case(
        "pixels, Cauchy",
        PositionLikelihood,
        likelihood(robust="cauchy"),
        least_squares=False,
        channels=("position", "pixel"),
    ),
    Case("body angle", BodyLikelihood, density=angle_density("body"), **SEEN_BODY),
    Case("head angle", HeadLikelihood, density=angle_density("head"), **SEEN_HEAD),
    Case("body angle, outliers", BodyLikelihood, OUTLIERS, angle_density("body"), **MIXED_BODY),
    Case("body angle, sharp, outliers", BodyLikelihood, SHARP, angle_density("body"), **MIXED_BODY),
    Case("body angle, sharp", BodyLikelihood, likelihood(body_kappa=1e4), **SEEN_BODY),
    Case("body angle without weight", BodyLikelihood, likelihood(body_kappa=0.0), **SEEN_BODY),
    Case("8 body classes", BodyLikelihood, density=class_density("body"), **MIXED_8),
    Case("12 head classes", HeadLikelihood, density=class_density("head"), **MIXED_12),
    Case("8 body classes, no outliers", BodyLikelihood, NO_CLASS_OUTLIERS, class_density("body"), **MIXED_8),
    Case("favourite speed", FavouriteSpeed),
]
EVERY_CASE = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
THRESHOLDS = (CouplingParameters().speed_threshold, 0.0)

SPEEDS = st.one_of(
    st.floats(0.02, 4.0),
    st.sampled_from([0.05, *(THRESHOLDS[0] + d for d in (-0.05, -1e-3, -1e-4, 1e-4, 1e-3, 0.05))]),
)
DIRECTIONS = st.one_of(st.floats(-PI, PI), st.sampled_from([0.0, PI / 2, PI, -PI, PI - 1e-7]))
DEVIATIONS = st.one_of(st.floats(-PI, PI), st.sampled_from([0.0, PI, PI - 1e-9, -PI + 1e-9, PI - 1e-3, 1e-6]))


@st.composite
def situations(draw: st.DrawFn) -> tuple[States, Track]:
    """States and observations of a few frames, anywhere: far from the optimum, opposite, slow."""
    n = draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    directions = np.array(draw(st.lists(DIRECTIONS, min_size=n, max_size=n)))
    speeds = np.array(draw(st.lists(SPEEDS, min_size=n, max_size=n)))
    deviations = np.array(draw(st.lists(DEVIATIONS, min_size=4 * n, max_size=4 * n))).reshape(4, n)
    far = draw(st.sampled_from([0.01, 1.0, 20.0]))
    body = directions + deviations[0]
    body[1:] = np.where(rng.random(n - 1) < 0.5, body[:-1] + deviations[3, 1:], body[1:])
    head = body + deviations[1]
    position = rng.normal(0.0, 2.0, (n, 2))
    classes = [scores(angle + deviations[2], k, rng) for angle, k in ((body, 8), (head, 12))]
    if draw(st.booleans()):
        classes = [np.where(rng.random(c.shape) < 0.7, 0.0, c) for c in classes]
        for c in classes:
            c[np.arange(n), rng.integers(c.shape[1], size=n)] = 1.0
    elsewhere = position + far * rng.normal(0.0, 1.0, (n, 2)) * 0.1
    track = Track(
        track_id=1,
        frame=np.arange(n),
        t=np.cumsum(rng.uniform(0.02, 0.5, n)),
        position=elsewhere,
        pixel=CAMERA.ground_to_image(elsewhere),
        body=np.array([body[k] + deviations[2, k] for k in range(n)]),
        head=np.array([head[k] + deviations[2, k] for k in range(n)]),
        body_likelihood=classes[0],
        head_likelihood=classes[1],
    )
    velocity = speeds[:, None] * np.column_stack([np.cos(directions), np.sin(directions)])
    return States(position, velocity, body, head), track


def seen_by(case: Case, track: Track) -> Track:
    """The track with no orientations but those that the case sees."""
    channels = ("pixel", "body", "head", "body_likelihood", "head_likelihood")
    return replace(track, **{name: None for name in channels if name not in case.channels})


def values_of(states: States) -> gtsam.Values:
    values = gtsam.Values()
    for k in range(len(states.position)):
        values.insert(X(k), states.position[k])
        values.insert(V(k), states.velocity[k])
        values.insert(B(k), gtsam.Rot2(states.body[k]))
        values.insert(H(k), gtsam.Rot2(states.head[k]))
    return values


def factors_of(case: Case, track: Track) -> list[gtsam.NonlinearFactor]:
    term = case.term(case.parameters)
    return [factor for step in chain(track, CAMERA) for factor in term.factors(step)]


def numerical_gradient(factor: gtsam.NonlinearFactor, values: gtsam.Values, keys: list[int]) -> np.ndarray:
    """Of the factor's error through ``retract``; differences of fourth order."""
    step, columns = 1e-4, []
    for key in keys:
        for axis in range(2 if chr(gtsam.Symbol(key).chr()) in "xv" else 1):
            errors = []
            for size in (-2, -1, 1, 2):
                delta = gtsam.VectorValues()
                delta.insert(
                    key, size * step * np.eye(2 if chr(gtsam.Symbol(key).chr()) in "xv" else 1)[axis]
                )
                errors.append(factor.error(values.retract(delta)))
            columns.append((errors[0] - 8 * errors[1] + 8 * errors[2] - errors[3]) / (12 * step))
    return np.array(columns)


def kinked(case: Case, states: States) -> bool:
    """Whether a speed is so near the threshold of the coupling that differences reach across the kink."""
    if case.term is not BodyFollowsMotion:
        return False
    speed = np.linalg.norm(states.velocity, axis=1)
    return bool(np.any(np.abs(speed - case.parameters.coupling.speed_threshold) < 3e-4))


@EVERY_CASE
@settings(deadline=None, max_examples=40)
@given(situation=situations())
def test_the_jacobian_is_the_derivative_of_the_whitened_residual(
    case: Case, situation: tuple[States, Track]
) -> None:
    states, track = situation[0], seen_by(case, situation[1])
    assume(not kinked(case, states))
    values = values_of(states)
    for factor in factors_of(case, track):
        keys = list(factor.keys())
        jacobian, right = factor.linearize(values).jacobian()
        if not case.least_squares:
            continue
        whitened = factor.whitenedError(values)
        np.testing.assert_allclose(right, -whitened, atol=1e-12 * (1.0 + np.abs(whitened).max()))
        expected = np.hstack(numerical_jacobians(factor.whitenedError, values, keys))
        # Rounding of the residual, and the size of its third derivative.
        allowed = 1e-7 * (1.0 + np.abs(expected).max() + np.abs(whitened).max())
        np.testing.assert_allclose(
            jacobian, expected, atol=allowed, err_msg=str([gtsam.DefaultKeyFormatter(k) for k in keys])
        )


@EVERY_CASE
@settings(deadline=None, max_examples=40)
@given(situation=situations())
def test_the_linearised_gradient_is_that_of_the_error(case: Case, situation: tuple[States, Track]) -> None:
    states, track = situation[0], seen_by(case, situation[1])
    if kinked(case, states):
        return
    values = values_of(states)
    for factor in factors_of(case, track):
        jacobian, right = factor.linearize(values).jacobian()
        found = -jacobian.T @ right
        expected = numerical_gradient(factor, values, list(factor.keys()))
        allowed = 1e-5 * (1.0 + np.abs(jacobian).max() ** 2 + factor.error(values) * 1e-3)
        np.testing.assert_allclose(found, expected, atol=allowed)


@EVERY_CASE
@settings(deadline=None, max_examples=40)
@given(situation=situations())
def test_the_errors_of_the_factors_sum_to_the_written_density(
    case: Case, situation: tuple[States, Track]
) -> None:
    states, track = situation[0], seen_by(case, situation[1])
    values = values_of(states)
    total = sum(factor.error(values) for factor in factors_of(case, track))
    written = case.term(case.parameters).cost(states, track, CAMERA)
    assert total == pytest.approx(written, rel=1e-9, abs=1e-9)


@EVERY_CASE
@settings(deadline=None, max_examples=25)
@given(first=situations(), seed=st.integers(0, 10_000))
def test_the_written_density_is_the_one_of_the_definition(
    case: Case, first: tuple[States, Track], seed: int
) -> None:
    if case.density is None:
        return
    states, track = first[0], seen_by(case, first[1])
    rng = np.random.default_rng(seed)
    moved = States(*(value + rng.normal(0.0, 0.5, value.shape) for value in vars(states).values()))
    term = case.term(case.parameters)
    written = term.cost(moved, track, CAMERA) - term.cost(states, track, CAMERA)
    defined = case.density(states, track, case.parameters) - case.density(moved, track, case.parameters)
    assert written == pytest.approx(defined, rel=1e-8, abs=1e-7)


@EVERY_CASE
def test_factors_arrive_with_variables_of_their_own_step_and_the_one_before(case: Case) -> None:
    steps = chain(seen_by(case, replace(walk(4), pixel=CAMERA.ground_to_image(walk(4).position))), CAMERA)
    for k, step in enumerate(steps):
        for factor in case.term(case.parameters).factors(step):
            indices = {gtsam.Symbol(key).index() for key in factor.keys()}  # noqa: SIM118
            letters = {chr(gtsam.Symbol(key).chr()) for key in factor.keys()}  # noqa: SIM118
            assert indices <= {k, k - 1}
            # What a term acts on it must declare, else the model would not hold those variables.
            assert {"b": "body" in case.term.uses, "h": "head" in case.term.uses}.items() >= {
                (letter, True) for letter in letters & {"b", "h"}
            }


@EVERY_CASE
def test_a_term_costs_nothing_where_nothing_was_seen(case: Case) -> None:
    if case.term not in (PositionLikelihood, BodyLikelihood, HeadLikelihood):
        return
    n = 3
    blank = Track(
        1,
        np.arange(n),
        np.arange(n) * 0.1,
        np.full((n, 2), np.nan),
        body=np.full(n, np.nan),
        body_likelihood=np.full((n, 8), np.nan),
    )
    assert factors_of(case, blank) == []
    states = States(np.ones((n, 2)), np.ones((n, 2)), np.ones(n), np.ones(n))
    assert case.term(case.parameters).cost(states, blank, CAMERA) == 0.0


# Mixtures.


@st.composite
def mixtures(draw: st.DrawFn) -> VonMisesMixture:
    n = draw(st.integers(1, 12))
    weights = draw(
        st.lists(st.one_of(st.just(0.0), st.floats(1e-6, 10.0)), min_size=n, max_size=n).filter(any)
    )
    means = draw(st.lists(DIRECTIONS, min_size=n, max_size=n))
    kappa = draw(st.one_of(st.floats(0.01, 100.0), st.sampled_from([1e3, 1e4])))
    uniform = draw(st.floats(1e-6, 0.9))
    return VonMisesMixture(tuple(means), tuple(weights), kappa, uniform)


def log_density(mixture: VonMisesMixture, angle: float) -> float:
    weights = np.array(mixture.weights) / np.sum(mixture.weights) * (1.0 - mixture.uniform)
    deviation = angle - np.array(mixture.means)
    peaks = stats.vonmises.pdf(np.angle(np.exp(1j * deviation)), mixture.kappa)
    return float(np.log(mixture.uniform / (2 * PI) + weights @ peaks))


@settings(deadline=None, max_examples=300)
@given(mixtures(), DIRECTIONS)
def test_the_mixture_factor_is_exactly_the_negative_log_density(
    mixture: VonMisesMixture, angle: float
) -> None:
    residual, _ = mixture.rows(angle)
    expected = -log_density(mixture, angle)
    assert 0.5 * residual @ residual - mixture.offset == pytest.approx(
        expected, abs=1e-8 + 1e-11 * mixture.kappa
    )
    assert mixture.negative_log_density(angle) == pytest.approx(expected, abs=1e-8 + 1e-11 * mixture.kappa)


@settings(deadline=None, max_examples=300)
@given(mixtures(), DIRECTIONS)
def test_the_remainder_of_a_mixture_never_goes_below_zero(mixture: VonMisesMixture, angle: float) -> None:
    residual, _ = mixture.rows(angle)
    # From the density: what is left of −log L + offset when the two von Mises rows are taken away.
    remainder = mixture.offset - log_density(mixture, angle) - 0.5 * residual[:2] @ residual[:2]
    assert remainder > -1e-9 * (1.0 + mixture.kappa)
    assert residual[2] >= 0.0


@settings(deadline=None, max_examples=200)
@given(mixtures(), DIRECTIONS)
def test_the_gradient_of_a_mixture_is_exact(mixture: VonMisesMixture, angle: float) -> None:
    residual, jacobian = mixture.rows(angle)
    step = 1e-3 / np.sqrt(1.0 + mixture.kappa)
    a, b, c, d = (log_density(mixture, angle + k * step) for k in (-2, -1, 1, 2))
    expected = -(a - 8 * b + 8 * c - d) / (12 * step)
    assert (jacobian.T @ residual).item() == pytest.approx(expected, abs=1e-5 * (1.0 + mixture.kappa))


@pytest.mark.parametrize("kappa", [1.0, 100.0, 1e3, 1e4])
@pytest.mark.parametrize("deviation", [0.0, 1.0, PI / 2, PI - 1e-6, PI])
def test_one_sharp_class_without_outliers_is_a_von_mises_at_any_distance(
    kappa: float, deviation: float
) -> None:
    mixture = VonMisesMixture((0.3, 1.0), (1.0, 0.0), kappa, 0.0)
    residual, jacobian = mixture.rows(0.3 + deviation)
    assert 0.5 * residual @ residual - mixture.offset == pytest.approx(
        mixture.negative_log_density(0.3 + deviation), abs=1e-8 + 1e-12 * kappa
    )
    gradient = (jacobian.T @ residual).item()
    assert gradient == pytest.approx(kappa * np.sin(deviation), abs=1e-8 + 1e-10 * kappa)


@pytest.mark.parametrize("kappa", [100.0, 1e3, 1e4])
@pytest.mark.parametrize("weights", [(1.0, 1.0), (1.0, 1e-3)])
@settings(deadline=None, max_examples=40)
@given(angle=st.floats(-PI, PI))
def test_sharp_classes_without_outliers_stay_exact_at_any_distance(
    kappa: float, weights: tuple[float, float], angle: float
) -> None:
    mixture = VonMisesMixture((0.0, 2.0), weights, kappa, 0.0)
    residual, _ = mixture.rows(angle)
    logs = kappa * (np.cos(angle - np.array(mixture.means)) - 1.0) + np.log(np.array(weights) / sum(weights))
    peak = float(stats.vonmises.logpdf(0.0, kappa))
    expected = -float(np.logaddexp(*logs)) - peak
    found = 0.5 * residual @ residual - mixture.offset
    assert found == pytest.approx(expected, abs=1e-7 + 1e-10 * kappa)


@pytest.mark.parametrize("n_classes", [8, 12])
def test_equal_class_scores_say_next_to_nothing(n_classes: int) -> None:
    mixture = VonMisesMixture(
        tuple(class_centres(n_classes)), (1.0,) * n_classes, class_kappa(n_classes), 0.0
    )
    costs = [mixture.negative_log_density(angle) for angle in np.linspace(-PI, PI, 1001)]
    assert np.ptp(costs) < 0.05


def test_scores_that_are_all_zero_say_nothing() -> None:
    mixture = VonMisesMixture(tuple(class_centres(8)), (0.0,) * 8, class_kappa(8), 0.05)
    factor = mixture_factor(B(0), mixture)
    errors = []
    for angle in (0.0, 1.0, PI):
        values = gtsam.Values()
        values.insert(B(0), gtsam.Rot2(angle))
        errors.append(factor.error(values) - mixture.offset)
        assert np.abs(factor.linearize(values).jacobian()[0]).max() == 0.0
    np.testing.assert_allclose(errors, np.log(2 * PI), atol=1e-12)


# Shapes.

VALUES = values_of(States(np.ones((1, 2)), np.ones((1, 2)), np.ones(1), np.ones(1)))
JACOBIANS = {
    "too many rows": [np.zeros((3, 2)), np.zeros((3, 1))],
    "too few rows": [np.zeros((1, 2)), np.zeros((1, 1))],
    "too many columns": [np.zeros((2, 2)), np.zeros((2, 2))],
    "too few columns": [np.zeros((2, 1)), np.zeros((2, 1))],
    "one for two keys": [np.zeros((2, 2))],
    "three for two keys": [np.zeros((2, 2)), np.zeros((2, 1)), np.zeros((2, 1))],
    "none": [],
    "no column": [np.zeros((2, 2)), np.zeros(2)],
    "swapped": [np.zeros((2, 1)), np.zeros((2, 2))],
}


@pytest.mark.parametrize("jacobians", JACOBIANS.values(), ids=JACOBIANS.keys())
def test_a_jacobian_of_a_wrong_shape_is_an_error_and_no_crash(jacobians: list[np.ndarray]) -> None:
    factor = custom_factor(
        [X(0), B(0)], 2, lambda values: np.zeros(2), lambda values: (np.zeros(2), jacobians)
    )
    assert factor.error(VALUES) == 0.0
    with pytest.raises(FactorShapeError, match=r"found .* expected"):
        factor.linearize(VALUES)


@pytest.mark.parametrize("key", [X(0), V(0), B(0), H(0)], ids=["x0", "v0", "b0", "h0"])
def test_the_message_names_the_key_of_the_wrong_jacobian(key: int) -> None:
    factor = custom_factor([key], 2, lambda values: np.zeros(2), lambda values: (np.zeros(2), [np.eye(3)]))
    with pytest.raises(FactorShapeError, match=gtsam.DefaultKeyFormatter(key)):
        factor.linearize(VALUES)


@pytest.mark.parametrize("shape", [(), (1,), (3,), (2, 1), (1, 2)], ids=str)
def test_a_residual_of_a_wrong_shape_is_an_error_and_no_crash(shape: tuple[int, ...]) -> None:
    jacobians = [np.zeros((2, 2))]
    plain = custom_factor([X(0)], 2, lambda values: np.zeros(shape))
    linear = custom_factor([X(0)], 2, lambda values: np.zeros(shape), lambda v: (np.zeros(shape), jacobians))
    for use in (plain.error, plain.linearize, linear.error, linear.linearize):
        with pytest.raises(FactorShapeError, match="residual of shape"):
            use(VALUES)


def test_a_key_of_no_variable_of_the_model_is_refused() -> None:
    with pytest.raises(FactorShapeError, match="q3"):
        custom_factor([gtsam.symbol("q", 3)], 1, lambda values: np.zeros(1))


def test_an_error_within_a_residual_comes_out_as_it_is() -> None:
    def residual(values: gtsam.Values) -> np.ndarray:
        raise ZeroDivisionError("of the user's own")

    with pytest.raises(ZeroDivisionError, match="of the user's own"):
        custom_factor([X(0)], 1, residual).error(VALUES)


@pytest.mark.parametrize("use", ["error", "linearize"])
def test_a_traceback_holds_nothing_of_a_factor_that_is_gone(use: str) -> None:
    def residual(values: gtsam.Values) -> np.ndarray:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError) as caught:
        getattr(custom_factor([X(0)], 1, residual), use)(VALUES)
    frames = [entry.frame.f_locals for entry in caught.traceback]
    assert len(frames) > 1
    # Whatever prints the locals of a traceback would read freed memory.
    assert not any(isinstance(value, gtsam.CustomFactor) for frame in frames for value in frame.values())


# A term of one's own.


class WrongShape(FavouriteSpeed):
    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        return [custom_factor([step.velocity_key], 3, lambda values: np.zeros(2))]


class FavouriteHeading(Term):
    """Bodies like to point to +x: an orientation of its own, in a model that has none."""

    uses: ClassVar = frozenset({"body"})

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        key = step.body_key
        return [
            custom_factor([key], 1, lambda values: np.array([2.0 * np.sin(values.atRot2(key).theta() / 2)]))
        ]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        return float(np.sum(1.0 - np.cos(states.body)))


@pytest.mark.parametrize("preset", ["position", "separate", "joint"])
def test_a_term_of_ones_own_without_a_jacobian_takes_part(preset: str) -> None:
    track = walk(15, seed=2)
    with_term = Model(preset, terms=[FavouriteSpeed])
    plain, pulled = smooth_track(track, Model(preset)), smooth_track(track, with_term)

    def deviation(estimate: Track) -> float:
        assert estimate.velocity is not None
        return float(np.sum((np.linalg.norm(estimate.velocity, axis=1) - 1.2) ** 2))

    assert deviation(pulled.track) < 0.9 * deviation(plain.track)
    assert pulled.converged


def test_a_term_of_ones_own_brings_its_orientation_into_the_model() -> None:
    estimate = smooth_track(walk(8), Model("position", terms=[FavouriteHeading])).track
    assert estimate.body is not None
    np.testing.assert_allclose(estimate.body, 0.0, atol=1e-4)
    assert estimate.head is None
    assert estimate.covariance is not None
    np.testing.assert_allclose(estimate.covariance[:, 4, 4], 1.0, rtol=1e-4)


def test_a_term_of_ones_own_with_a_wrong_shape_is_told_so() -> None:
    with pytest.raises(FactorShapeError, match="residual of shape"):
        smooth_track(walk(5), Model("position", terms=[WrongShape]))
