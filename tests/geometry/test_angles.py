import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, special, stats

from graphtrack.geometry import angles

PI = float(np.pi)
AROUND_HALF_TURNS = st.builds(
    lambda turns, offset: turns * PI + offset,
    st.sampled_from([-3, -2, -1, 0, 1, 2, 3]),
    st.sampled_from([0.0, 1e-15, -1e-15, 1e-12, -1e-12, 1e-8, -1e-8]),
)
ANGLES = st.one_of(st.floats(-1e4, 1e4), AROUND_HALF_TURNS, st.sampled_from([PI, -PI, 0.0, -0.0]))
CONCENTRATIONS = st.one_of(st.floats(0.0, 50.0), st.sampled_from([0.0, 1e-9, 1e3, 1e6]))


def assert_same_direction(a: float, b: float, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(np.exp(1j * np.asarray(a)), np.exp(1j * np.asarray(b)), atol=tolerance)


@given(ANGLES)
def test_a_wrapped_angle_is_the_same_direction_within_the_interval(angle: float) -> None:
    wrapped = float(angles.wrap(angle))
    assert -PI < wrapped <= PI
    assert_same_direction(wrapped, angle)


def test_ends_of_intervals_and_missing_values() -> None:
    assert angles.wrap(PI) == angles.wrap(-PI) == PI
    assert np.isnan(angles.wrap(np.nan)) and angles.direction([0.0, 0.0]) == 0.0
    found = angles.concentration_from_resultant([-0.1, 0.0, 1.0])
    np.testing.assert_array_equal(found[:2], 0.0)
    assert 1e6 < found[2] < np.inf


@given(ANGLES, ANGLES)
def test_the_difference_turns_the_second_into_the_first(a: float, b: float) -> None:
    turn = float(angles.difference(a, b))
    assert -PI < turn <= PI
    assert_same_direction(b + turn, a)


@given(ANGLES)
def test_direction_and_unit_are_inverse(angle: float) -> None:
    assert_same_direction(float(angles.direction(2.5 * angles.unit(angle))), angle)


@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=8), ANGLES)
def test_the_mean_absolute_error_does_not_see_a_common_turn(offsets: list[float], truth: float) -> None:
    offset = np.array(offsets)
    error = angles.mean_absolute_error(truth + offset, np.full(len(offset), truth))
    assert error == pytest.approx(np.mean(np.abs(offset)), abs=1e-9)


@given(ANGLES, AROUND_HALF_TURNS, CONCENTRATIONS)
def test_the_von_mises_log_density_agrees_with_scipy(angle: float, mean: float, kappa: float) -> None:
    if kappa == 0.0:  # scipy's has no concentration 0
        expected = -np.log(2 * PI)
    else:
        expected = stats.vonmises.logpdf(float(angles.difference(angle, mean)), kappa)
    found = angles.von_mises_log_density(angle, mean, kappa)
    np.testing.assert_allclose(found, expected, atol=1e-9 * (1.0 + kappa))


@given(st.floats(1e-6, 1e5))
def test_the_mean_resultant_length_is_the_mean_cosine_and_has_an_inverse(kappa: float) -> None:
    length = float(angles.mean_resultant_length(kappa))
    assert float(angles.concentration_from_resultant(length)) == pytest.approx(kappa, rel=5e-3)
    if kappa < 500.0:
        assert length == pytest.approx(special.iv(1, kappa) / special.iv(0, kappa), rel=1e-9)


@pytest.mark.parametrize("kappas", [(0.0, 2.0), (1.5, 0.3), (30.0, 400.0)])
def test_the_density_of_a_blurred_angle_is_its_integral(kappas: tuple[float, float]) -> None:
    first, second = kappas
    for apart in (0.0, 0.4, 3.0):

        def product(angle: float, apart: float = apart) -> float:
            logs = (
                angles.von_mises_log_density(angle, 0.0, first),
                angles.von_mises_log_density(angle, apart, second),
            )
            return float(np.exp(sum(logs)))

        expected = integrate.quad(product, -np.pi, np.pi, points=[0.0, apart], limit=200)[0]
        found = angles.log_blurred(np.array([apart]), np.array([first]), np.array([second]))[0]
        assert np.exp(found) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_an_angle_far_from_a_sure_estimate_is_foretold_though_its_density_underflows() -> None:
    apart, first, second = np.array([3.0]), np.array([900.0]), np.array([800.0])

    def log_product(angle: float) -> float:
        return float(
            angles.von_mises_log_density(angle, 0.0, 900.0) + angles.von_mises_log_density(angle, 3.0, 800.0)
        )

    # Its mass is about the one place between both; as a double the density would be 0 there.
    greatest = max(np.linspace(0.0, 3.0, 30_001), key=log_product)
    most = log_product(greatest)
    scaled = integrate.quad(lambda angle: np.exp(log_product(angle) - most), greatest - 0.5, greatest + 0.5)[
        0
    ]
    assert most < -1000.0
    assert angles.log_blurred(apart, first, second)[0] == pytest.approx(most + np.log(scaled), rel=1e-9)
