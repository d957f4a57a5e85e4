"""One battery for all compiled kernels: a new kernel is one line in `KERNELS`."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from graphtrack.geometry.angles import unit
from graphtrack.model.kernels.coupling import add_body_follows_motion, add_head_follows_body
from graphtrack.model.kernels.frames import BODY, HEAD
from graphtrack.model.kernels.motion import add_first_velocity, add_motion
from graphtrack.model.kernels.orientation import add_turn
from graphtrack.model.kernels.pose import add_angle, add_classes, angle_cost
from graphtrack.model.kernels.position import CAUCHY, HUBER, add_pixel, add_position
from graphtrack.model.pose import class_centres, class_kappa

TO_IMAGE = np.linalg.inv(np.array([[0.02, 0.001, -9.0], [0.0005, -0.03, 14.0], [0.0, 0.0008, 1.0]]))
HEIGHTS = np.random.default_rng(3).dirichlet(np.full(13, 0.5))
OPPOSED = np.where(np.arange(9) % 4 == 0, 0.3, 0.02)

Kernel = Callable[[np.ndarray, np.ndarray, bool, list[np.ndarray]], float]
"""From states (6,) of the frame before and of a frame, exact, and what is added to (gradients and Hessians of
both, and the block between them) to the cost."""


def turn(place: int, kappa: float) -> Kernel:
    def add(before: np.ndarray, state: np.ndarray, exact: bool, out: list[np.ndarray]) -> float:
        then, now = unit(before[place]), unit(state[place])
        return add_turn(then[0], then[1], now[0], now[1], place, kappa, exact, *out)

    return add


def angle(place: int, kappa: float, uniform: float) -> Kernel:
    def add(before: np.ndarray, state: np.ndarray, exact: bool, out: list[np.ndarray]) -> float:
        now, mean = unit(state[place]), unit(0.7)
        return add_angle(now[0], now[1], place, mean[0], mean[1], kappa, uniform, exact, out[1], out[3])

    return add


def classes(place: int, heights: np.ndarray) -> Kernel:
    n = len(heights) - 1
    directions, kappa = unit(class_centres(n)), class_kappa(n)

    def add(before: np.ndarray, state: np.ndarray, exact: bool, out: list[np.ndarray]) -> float:
        now = unit(state[place])
        return add_classes(now[0], now[1], place, heights, directions, kappa, exact, out[1], out[3])

    return add


def metres(kind: int) -> Kernel:
    def add(before: np.ndarray, state: np.ndarray, exact: bool, out: list[np.ndarray]) -> float:
        return add_position(state, 0.3, -0.2, 4.0, kind, 1.2, exact, out[1], out[3])

    return add


def pixels(kind: int) -> Kernel:
    def add(before: np.ndarray, state: np.ndarray, exact: bool, out: list[np.ndarray]) -> float:
        return add_pixel(state, 3.0, -2.0, 600.0, 520.0, 1e-3, TO_IMAGE, kind, 1.2, exact, out[1], out[3])

    return add


def body_follows_motion(kappa: float, threshold: float) -> Kernel:
    def add(before: np.ndarray, state: np.ndarray, exact: bool, out: list[np.ndarray]) -> float:
        now = unit(state[BODY])
        return add_body_follows_motion(state, now[0], now[1], kappa, threshold, exact, out[1], out[3])

    return add


def head_follows_body(before: np.ndarray, state: np.ndarray, exact: bool, out: list[np.ndarray]) -> float:
    body, head = unit(state[BODY]), unit(state[HEAD])
    return add_head_follows_body(body[0], body[1], head[0], head[1], 3.0, exact, out[1], out[3])


def motion(before: np.ndarray, state: np.ndarray, exact: bool, out: list[np.ndarray]) -> float:
    return add_motion(before, state, 0.3, 2.0, *out)


def first_velocity(before: np.ndarray, state: np.ndarray, exact: bool, out: list[np.ndarray]) -> float:
    return add_first_velocity(state, 0.4, out[1], out[3])


KERNELS: dict[str, Kernel] = {
    "motion": motion,
    "first velocity": first_velocity,
    "body turns": turn(BODY, 5.0),
    "head turns": turn(HEAD, 5.0),
    "body follows motion": body_follows_motion(10.0, 0.2),
    "body follows any motion": body_follows_motion(10.0, 0.0),
    "head follows body": head_follows_body,
    "metres": metres(0),
    "metres, Huber": metres(HUBER),
    "metres, Cauchy": metres(CAUCHY),
    "pixels": pixels(0),
    "pixels, Huber": pixels(HUBER),
    "pixels, Cauchy": pixels(CAUCHY),
    "body angle": angle(BODY, 4.0, 0.0),
    "head angle": angle(HEAD, 4.0, 0.0),
    "body angle, outliers": angle(BODY, 9.0, 0.02),
    "head angle, outliers": angle(HEAD, 2.0, 0.3),
    "8 body classes, opposed": classes(BODY, OPPOSED / OPPOSED.sum()),
    "12 head classes": classes(HEAD, HEIGHTS),
}
EVERY_KERNEL = pytest.mark.parametrize("kernel", KERNELS.values(), ids=list(KERNELS))


def states(seed: int) -> np.ndarray:
    """States (12,) of a frame and then of the one before, anywhere: angles far apart, speeds up to 2 m/s."""
    rng = np.random.default_rng(seed)
    both = rng.normal(0.0, 1.0, (2, 6))
    speed, heading = rng.uniform(0.3, 2.0, 2), rng.uniform(-math.pi, math.pi, 2)
    both[:, 2:4] = speed[:, None] * unit(heading)
    both[:, 4:] = rng.uniform(-math.pi, math.pi, (2, 2))
    return both.ravel()


def evaluate(kernel: Kernel, both: np.ndarray, exact: bool = True) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost, gradient (12,) and Hessian (12, 12) with respect to the frame and the one before."""
    out = [np.zeros(6), np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))]
    state, before = both[:6].copy(), both[6:].copy()
    cost = kernel(before, state, exact, out)
    gradient_before, gradient, lower_before, lower, transition = out
    here, then = (np.tril(half) + np.tril(half, -1).T for half in (lower, lower_before))
    hessian = np.block([[here, transition.T], [transition, then]])
    return cost, np.concatenate([gradient, gradient_before]), hessian


@EVERY_KERNEL
@pytest.mark.parametrize("seed", range(12))
def test_the_gradient_is_the_derivative_of_the_cost(kernel: Kernel, seed: int) -> None:
    both, step = states(seed), 1e-4
    expected = []
    for unit_vector in step * np.eye(12):
        costs = [evaluate(kernel, both + k * unit_vector)[0] for k in (-2, -1, 1, 2)]
        expected.append((costs[0] - 8.0 * costs[1] + 8.0 * costs[2] - costs[3]) / (12.0 * step))
    for exact in (True, False):
        found = evaluate(kernel, both, exact)[1]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * (1.0 + np.abs(expected).max()))


@EVERY_KERNEL
@pytest.mark.parametrize("seed", range(12))
def test_the_exact_curvature_is_the_derivative_of_the_gradient(kernel: Kernel, seed: int) -> None:
    both, step = states(seed), 1e-4
    expected = []
    for unit_vector in step * np.eye(12):
        slopes = [evaluate(kernel, both + k * unit_vector)[1] for k in (-2, -1, 1, 2)]
        expected.append((slopes[0] - 8.0 * slopes[1] + 8.0 * slopes[2] - slopes[3]) / (12.0 * step))
    found = evaluate(kernel, both)[2]
    allowed = 1e-7 * (1.0 + np.abs(expected).max())
    np.testing.assert_allclose(found, np.array(expected), rtol=1e-6, atol=allowed)


@EVERY_KERNEL
def test_the_other_curvature_is_never_negative(kernel: Kernel) -> None:
    for seed in range(200):
        values = np.linalg.eigvalsh(evaluate(kernel, states(seed), exact=False)[2])
        assert values.min() >= -1e-12 * (1.0 + values.max())


@EVERY_KERNEL
def test_the_cost_does_not_depend_on_the_curvature_and_adds_up(kernel: Kernel) -> None:
    both = states(5)
    cost, gradient, hessian = evaluate(kernel, both)
    assert evaluate(kernel, both, exact=False)[0] == cost
    assert cost >= 0.0
    out = [np.ones(6), np.ones(6), np.ones((6, 6)), np.ones((6, 6)), np.ones((6, 6))]
    kernel(both[6:].copy(), both[:6].copy(), True, out)
    np.testing.assert_allclose(np.concatenate([out[1], out[0]]) - 1.0, gradient, atol=1e-12)
    np.testing.assert_allclose(out[4] - 1.0, hessian[6:, :6], atol=1e-12)


def test_kernels_that_can_be_indefinite_are() -> None:
    """Else the two curvatures would not be told apart above."""
    for name in ("body turns", "body follows motion", "head follows body", "body angle", "metres, Cauchy"):
        least = [np.linalg.eigvalsh(evaluate(KERNELS[name], states(seed))[2]).min() for seed in range(200)]
        assert min(least) < -1e-3, name


def test_a_slow_person_is_not_pulled() -> None:
    slow = states(1)
    slow[2:4] = [0.1, 0.05]
    cost, gradient, hessian = evaluate(body_follows_motion(10.0, 0.2), slow)
    assert cost == 0.0
    assert not gradient.any()
    assert not hessian.any()
    slow[2:4] = 0.0
    assert np.isfinite(evaluate(body_follows_motion(10.0, 0.0), slow)[2]).all()


@pytest.mark.parametrize("uniform", [0.0, 0.05])
def test_the_cost_of_an_angle_is_that_which_is_added(uniform: float) -> None:
    for seed in range(5):
        both = states(seed)
        added = evaluate(angle(BODY, 6.0, uniform), both)[0]
        assert added == pytest.approx(angle_cost(math.cos(both[BODY] - 0.7), 6.0, uniform), rel=1e-12)
