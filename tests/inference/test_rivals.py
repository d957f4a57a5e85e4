"""Two basins that are about as likely: the covariance about the estimate admits both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from walks import out_and_back, walk

from graphtrack import TrackSet, smooth
from graphtrack.geometry.angles import UNIFORM_STD, difference
from graphtrack.inference.chain.batch import solve_packed
from graphtrack.inference.chain.covariance import calibration_of
from graphtrack.inference.chain.initialisation import pack
from graphtrack.model import Model
from graphtrack.tracks.track import Track

PRESETS = pytest.mark.parametrize("preset", ["joint", "full"])


def solved(tracks: Sequence[Track], preset: str) -> Sequence[Track]:
    found = smooth(TrackSet(list(tracks)), preset)
    assert isinstance(found, TrackSet)
    return list(found.tracks)


def turned_back(track: Track, degrees: float) -> Track:
    """The walk with the body observed, which turns by so much, clockwise if negative."""
    x = track.position[:, 0]
    first, last = np.flatnonzero(x >= x.max() - 1e-9)[[0, -1]]
    share = np.clip((np.arange(len(x)) - first + 2) / (last - first + 4), 0.0, 1.0)
    return replace(track, body=np.angle(np.exp(1j * np.radians(degrees) * share)))


@PRESETS
def test_whoever_may_have_turned_either_way_has_a_covariance_that_admits_both(preset: str) -> None:
    """The path is a line: the mirrored course is as likely, and in half of the cases the truth."""
    for found in solved([out_and_back(seed) for seed in range(30)], preset):
        for name, place in (("body", 4), ("head", 5)):
            angle, variance = getattr(found, name), found.covariance[:, place, place]
            square = 0.5 * difference(-angle, angle) ** 2
            assert np.all(np.minimum(square, UNIFORM_STD**2) <= 1.1 * variance), (found.track_id, name)
        assert np.linalg.eigvalsh(found.covariance).min() > 0.0


@PRESETS
def test_whoever_was_seen_to_turn_one_way_has_no_rival(preset: str) -> None:
    model = Model(preset)
    for degrees in (180.0, -180.0):
        tracks = [turned_back(out_and_back(seed), degrees) for seed in range(10)]
        assert not solve_packed(pack(tracks, model), model).apart.any()


@PRESETS
def test_ordinary_walks_have_no_rival(preset: str) -> None:
    model = Model(preset)
    assert not solve_packed(pack([walk(60, seed=seed) for seed in range(10)], model), model).apart.any()


@PRESETS
def test_rivals_are_the_same_in_lanes(preset: str) -> None:
    model = Model(preset)
    packed, calibration = pack([out_and_back(seed) for seed in range(12)], model), None
    for calibration in (None, calibration_of(model.parameters)):
        lanes, alone = (
            solve_packed(packed, model, in_lanes=way, calibration=calibration) for way in (True, False)
        )
        assert np.abs(lanes.apart).max() > 0.5
        np.testing.assert_allclose(lanes.apart, alone.apart, atol=1e-5)
        np.testing.assert_allclose(lanes.covariance, alone.covariance, atol=1e-5)
