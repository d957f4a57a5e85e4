"""Where people come and go, and where detections are false: rates over the ground."""

from __future__ import annotations

import numpy as np
import pytest

from graphtrack.association import places
from graphtrack.association.chains import Chains, link_by, unlinked

FRAMES, CROSSING = 400, 20


def street(seed: int = 0, shift: tuple[float, float] = (0.0, 0.0)) -> tuple[Chains, np.ndarray]:
    """A walk of 20 m each, one after the other from left to right, and false detections in a corner above."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(FRAMES // CROSSING):
        y = rng.uniform(-1.0, 1.0)
        rows += [(k * CROSSING + j, j + rng.normal(0.0, 0.1), y, k) for j in range(CROSSING)]
    rows += [(f, rng.uniform(14.0, 20.0), rng.uniform(10.0, 12.0), -1) for f in range(FRAMES)]
    frame, x, y, identity = np.array(sorted(rows)).T
    position = np.column_stack([x, y]) + shift
    nothing = np.full((len(frame), 2), np.nan)
    chains = unlinked(0.4 * frame, frame.astype(np.int64), position, nothing)
    link_by(chains, identity.astype(np.int64))
    return chains, identity.astype(np.int64)


def test_people_come_where_they_came_and_leave_where_they_left() -> None:
    chains, identity = street()
    left, middle, right, corner = np.array([[0.0, 0.0], [10.0, 0.0], [19.0, 0.0], [17.0, 11.0]])
    births, deaths, clutter = places.learned(chains, identity).at(np.array([left, middle, right, corner]))
    assert births[0] > 2.0 > 1.0 > births[1]
    assert births[0] > 4.0 * births[2]
    assert deaths[2] > 2.0 > 1.0 > deaths[1]
    assert deaths[2] > 4.0 * deaths[0]
    assert clutter[3] > 2.0 and clutter[:3].max() < 0.2


def test_nothing_is_known_far_away_and_of_nobody() -> None:
    chains, identity = street()
    nobody = np.full(len(identity), -1)
    far = np.array([[500.0, 500.0]])
    for found in (places.learned(chains, identity).at(far), places.learned(chains, nobody).at(far)):
        assert all(np.isfinite(rate).all() and (rate > 0.0).all() for rate in found)
    births, deaths, _ = places.seen_from_within(chains, nobody)
    np.testing.assert_array_equal(deaths, 1.0)
    assert (births <= 1.0).all()


def test_rates_move_with_the_world() -> None:
    chains, identity = street()
    moved, _ = street(shift=(300.0, -40.0))
    for here, there in zip(
        places.seen_from_within(chains, identity), places.seen_from_within(moved, identity), strict=True
    ):
        np.testing.assert_allclose(here, there, rtol=1e-9)


def test_a_track_says_nothing_of_where_itself_began() -> None:
    """Of two tracks that are far apart each counts for the other alone."""
    frame = np.tile(np.arange(10, 30), 2)
    x = np.concatenate([np.arange(20.0), np.arange(20.0) + 200.0])
    identity, order = np.repeat([0, 1], 20), np.argsort(frame, kind="stable")
    position = np.column_stack([x, np.repeat([0.0, 200.0], 20)])[order]
    nothing = np.full((40, 2), np.nan)
    chains = unlinked(0.4 * frame[order], frame[order], position, nothing)
    link_by(chains, identity[order])
    births, deaths, _ = places.seen_from_within(chains, identity[order])
    plain, plain_deaths, _ = places.learned(chains, identity[order]).at(chains.position)
    first, last = int(np.argmin(x[order])), int(np.argmax(x[order] * (x[order] < 100.0)))
    assert births[first] <= 1.0 + 1e-6 < plain[first]
    assert deaths[last] <= plain_deaths[last]


@pytest.mark.parametrize("k", [0, 7, 300])
def test_own_events_are_left_out_as_if_they_had_not_been(k: int) -> None:
    """Against a loop over the events of all others, blurred without a grid."""
    chains, identity = street(seed=k)
    births, _, _ = places.seen_from_within(chains, identity)
    firsts = np.flatnonzero((chains.preceding < 0) & (identity >= 0) & (chains.frame > 3)).tolist()
    others = chains.position[[j for j in firsts if identity[j] != identity[k] or identity[k] < 0]]
    square = np.sum((others - chains.position[k]) ** 2, axis=1)
    peak = 1.0 / (2.0 * np.pi * places.SPREAD**2)
    low, high = np.quantile(chains.position, [0.005, 0.995], axis=0)
    mean = len(firsts) / np.prod(high - low)
    expected = (peak * np.exp(-0.5 * square / places.SPREAD**2).sum() + 2 * peak) / (mean + 2 * peak)
    # The grid has corners every half spread.
    assert births[k] == pytest.approx(expected, rel=0.2)
