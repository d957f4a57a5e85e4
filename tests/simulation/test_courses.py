"""Courses of angles have the density of the whole chain, which nothing normalises step by step."""

from __future__ import annotations

import numpy as np
import pytest

from graphtrack.geometry.angles import difference
from graphtrack.simulation.motion import sample_course

DRAWS = 20_000


def by_quadrature(t: np.ndarray, diffusion: float, pull: np.ndarray, bins: int = 72) -> np.ndarray:
    """Probabilities (bins, bins, bins) of three angles."""
    angle = 2.0 * np.pi * np.arange(bins) / bins
    log = np.zeros((bins,) * 3)
    for k, one in enumerate(pull):
        shape = tuple(bins if axis == k else 1 for axis in range(3))
        log = log + np.reshape((np.conj(one) * np.exp(1j * angle)).real, shape)
    turn = np.cos(angle[:, None] - angle[None]) / diffusion
    log = log + (turn / (t[1] - t[0]))[:, :, None] + (turn / (t[2] - t[1]))[None]
    density = np.exp(log - log.max())
    return density / density.sum()


@pytest.mark.parametrize("reach", [1.0, 20.0])
def test_three_angles_have_the_moments_of_the_chain(reach: float) -> None:
    t, diffusion = np.array([0.0, 0.5, 2.0]), 0.4
    pull = reach * np.exp(1j * np.array([0.3, 1.5, -2.0])) * np.array([0.5, 0.0, 1.0])
    probability = by_quadrature(t, diffusion, pull)
    drawn = sample_course(t, diffusion, np.tile(pull, (DRAWS, 1)), np.random.default_rng(1))
    angle = 2.0 * np.pi * np.arange(72) / 72
    for order in (1, 2):
        waves = np.exp(1j * order * angle)
        for k in range(3):
            others = tuple(axis for axis in range(3) if axis != k)
            expected = np.sum(probability.sum(axis=others) * waves)
            assert abs(np.mean(np.exp(1j * order * drawn[:, k])) - expected) < 5.0 / np.sqrt(DRAWS)
        for a, b in ((0, 1), (1, 2), (0, 2)):
            both = probability.sum(axis=3 - a - b)
            expected = np.einsum("ab,a,b->", both, waves, waves.conj())
            found = np.mean(np.exp(1j * order * (drawn[:, a] - drawn[:, b])))
            assert abs(found - expected) < 5.0 / np.sqrt(DRAWS)


@pytest.mark.parametrize("fps", [10.0, 30.0, 100.0])
@pytest.mark.parametrize("diffusion", [0.3, 1e-3])
def test_what_pulls_steadily_holds_an_angle_as_far_at_every_rate(fps: float, diffusion: float) -> None:
    # In continuous time the deviation is a ground state's: its variance is ½·√(diffusion/pull a second).
    rate, seconds = 40.0, 20.0
    t = np.arange(int(seconds * fps)) / fps
    drawn = sample_course(t, diffusion, np.full((40, len(t)), rate / fps, complex), np.random.default_rng(2))
    middle = drawn[:, (t > 5.0) & (t < 15.0)]
    expected = 0.5 * np.sqrt(diffusion / rate)
    # 40 courses of 10 s, in which the deviation is forgotten at the rate √(diffusion·pull).
    independent = 40 * 10.0 * np.sqrt(diffusion * rate)
    allowed = 4.0 * np.sqrt(2.0 / independent) + 0.5 * np.sqrt(diffusion * rate) / fps
    assert abs(np.mean(middle**2) / expected - 1.0) < allowed


def test_without_pulls_an_angle_diffuses_from_anywhere() -> None:
    t = np.array([0.0, 0.1, 0.6])
    drawn = sample_course(t, 0.2, np.zeros((DRAWS, 3), complex), np.random.default_rng(3))
    assert abs(np.mean(np.exp(1j * drawn[:, 0]))) < 5.0 / np.sqrt(DRAWS)
    turned = difference(drawn[:, 1:], drawn[:, :-1])
    np.testing.assert_allclose(np.mean(turned**2, axis=0), 0.2 * np.array([0.1, 0.5]), rtol=0.1)
    assert np.all(np.abs(drawn) <= np.pi)


def test_a_narrow_pull_is_resolved() -> None:
    t = np.array([0.0, 1.0])
    pull = np.full((DRAWS // 10, 2), 1e4 * np.exp(0.7j))
    drawn = sample_course(t, 0.5, pull, np.random.default_rng(4))
    np.testing.assert_allclose(np.mean((drawn - 0.7) ** 2, axis=0), 1e-4, rtol=0.1)


def test_many_tracks_are_drawn_in_parts_as_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    from graphtrack.simulation import motion

    t = np.arange(5) * 0.2
    pull = np.full((9, 5), 3.0 + 0.0j)
    monkeypatch.setattr(motion, "_MEMORY", 4 * 5 * 240 * 2)
    parts = sample_course(t, 0.2, pull, np.random.default_rng(5))
    assert parts.shape == (9, 5) and len(np.unique(parts[:, 0])) == 9
