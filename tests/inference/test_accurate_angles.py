"""Accurate angles, as of a motion-capture helmet: errors fall with the declared noise, at any rate.

A share of outliers makes the cost of an observation flat a few standard deviations away: the start of the
solver must not lie there.
"""

from __future__ import annotations

import numpy as np
import pytest
from selection import others_slow

import graphtrack as gt
from graphtrack.geometry.angles import wrap
from graphtrack.model import presets
from graphtrack.tracks.track import Track

STDS = (5.0, 1.0, 0.5, 0.1, 0.01)  # degrees
WITH_ANGLES = [name for name in presets if name != "position"]


def helmet(
    std: float, rate: float, name: str, moves: bool, outliers: float = 0.0
) -> tuple[Track, np.ndarray]:
    """Somebody whose head or body oscillates by 30°, with noise of ``std`` degrees; and the true angles."""
    rng = np.random.default_rng(5)
    n = 60 if rate < 50 else 200
    t = np.arange(n) / rate
    truth = np.radians(30.0 * np.sin(t))
    angle = truth + np.radians(rng.normal(0.0, std, n))
    wrong = rng.random(n) < outliers
    angle[wrong] += rng.uniform(1.0, 2.0 * np.pi - 1.0, wrong.sum())
    position = np.column_stack([1.3 * t * moves, 0.0 * t]) + rng.normal(0.0, 0.03, (n, 2))
    kappa = np.full(n, np.radians(std) ** -2)
    channels = {name: wrap(angle), f"{name}_kappa": kappa, "position_std": np.full(n, 0.03)}
    return Track(1, np.arange(n), t, position, **channels), np.where(wrong, np.nan, truth)


def check(found: Track, truth: np.ndarray, name: str, std: float, times: float = 1.3) -> None:
    error = np.degrees(np.abs(wrap(getattr(found, name) - truth)))
    assert np.sqrt(np.nanmean(error**2)) < times * std
    # Noise alone exceeds five standard deviations in one observation of two million.
    assert np.nanmax(error) < 5.0 * std


def channels_of(model: str) -> tuple[str, ...]:
    return tuple(name for name in ("head", "body") if getattr(gt.Model(model), f"has_{name}"))


@pytest.mark.slow
@pytest.mark.parametrize("rate", others_slow([1.0, 10.0, 100.0], [10.0]))
@pytest.mark.parametrize("model", others_slow(WITH_ANGLES, ["joint", "joint-intentional"]))
@pytest.mark.parametrize("online", [False, True])
def test_errors_fall_with_the_declared_noise(model, rate, online):
    for name in channels_of(model):
        for moves in (False, True):
            for std in STDS:
                track, truth = helmet(std, rate, name, moves)
                found = gt.track_online(track, model) if online else gt.smooth(track, model)
                check(found, truth, name, std)


@pytest.mark.parametrize("std", STDS[1:])
@pytest.mark.parametrize("online", [False, True])
def test_accurate_angles_with_outliers(std, online):
    track, truth = helmet(std, 10.0, "head", True, outliers=0.05)
    found = gt.track_online(track) if online else gt.smooth(track)
    check(found, truth, "head", std)


@pytest.mark.slow
@pytest.mark.parametrize("std", others_slow(STDS, [0.01]))
@pytest.mark.parametrize("model", ["joint", "joint-intentional"])
def test_engines_of_gtsam_follow_accurate_angles(model, std):
    track, truth = helmet(std, 10.0, "head", True)
    check(gt.smooth(track, model, engine="gtsam"), truth, "head", std)
    check(gt.track_online(track, model, engine="fixed-lag"), truth, "head", std)
    check(gt.track_online(track, model, engine="isam2"), truth, "head", std)
