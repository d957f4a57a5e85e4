"""Angles that nobody saw begin where people go, whatever stands between there and the couplings."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import difference
from graphtrack.inference.chain.batch import solve_packed
from graphtrack.inference.chain.initialisation import pack
from graphtrack.inference.chain.newton import CONVERGED
from graphtrack.model import Model
from graphtrack.tracks.track import Track


def rounds(frames: int) -> Track:
    """Somebody who walks in a circle, again and again, of whom the place alone is seen."""
    t = np.arange(frames) / 25.0
    noise = np.random.default_rng(0).normal(0.0, 0.05, (frames, 2))
    return Track(
        1, np.arange(frames), t, 20.0 * np.column_stack([np.cos(0.06 * t), np.sin(0.06 * t)]) + noise
    )


def test_a_long_way_round_takes_no_more_steps_than_a_short_one() -> None:
    model, steps = Model("full"), []
    for frames in (300, 6000):
        result = solve_packed(pack([rounds(frames)], model), model)
        assert (result.status == CONVERGED).all()
        steps.append(int(result.iterations.max()))
    assert steps[1] <= steps[0] + 5, steps


def test_unseen_bodies_and_heads_point_where_people_go() -> None:
    track, model = rounds(6000), Model("full")
    states = solve_packed(pack([track], model), model).states
    way = 0.06 * track.t + 0.5 * np.pi
    for place in (4, 5):
        assert np.abs(difference(states[:, place], way)).max() < np.radians(20.0)
