"""Custom factors, and terms of a user's own that state them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, H, V, X
from walks import walk

from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import smooth_track
from graphtrack.inference.state import values_of
from graphtrack.model import FactorShapeError, Model, Observation, States, Step, Term, custom_factor
from graphtrack.tracks.track import Track

VALUES = values_of([Step(0, Observation(0.0))], np.ones((1, 6)), Model("separate"))
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
    for key, name in ((X(0), "x0"), (V(0), "v0"), (B(0), "b0"), (H(0), "h0")):
        wrong = custom_factor([key], 2, lambda values: np.zeros(2), lambda values: (np.zeros(2), [np.eye(3)]))
        with pytest.raises(FactorShapeError, match=name):
            wrong.linearize(VALUES)


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
    # Printing the locals of a traceback would read freed memory.
    assert not any(isinstance(value, gtsam.CustomFactor) for frame in frames for value in frame.values())


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


def test_a_term_of_ones_own_brings_its_orientation_into_the_model() -> None:
    estimate = smooth_track(walk(8), Model("position", terms=[FavouriteHeading])).track
    np.testing.assert_allclose(estimate.body, 0.0, atol=1e-4)
    assert estimate.head is None
    # The density is exp(cos θ), whose curvature at its top is 1.
    np.testing.assert_allclose(estimate.covariance[:, 4, 4], 1.0, rtol=1e-3)


class WrongShape(FavouriteHeading):
    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        return [custom_factor([step.velocity_key], 3, lambda values: np.zeros(2))]


def test_a_term_of_ones_own_with_a_wrong_shape_is_told_so() -> None:
    with pytest.raises(FactorShapeError, match="residual of shape"):
        smooth_track(walk(5), Model("position", terms=[WrongShape]))
