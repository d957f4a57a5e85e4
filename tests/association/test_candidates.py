"""Candidates within reach: complete, and pruning changes no match."""

from typing import Any

import numpy as np
import pytest
from crossing_people import descriptors_of_people, packed_square, street
from scipy.optimize import linear_sum_assignment
from selection import others_slow

from graphtrack.association import moves, offline
from graphtrack.association.candidates import gains_of_links, grid_of, near_detections
from graphtrack.association.likelihood import GATE
from graphtrack.association.matching import match
from graphtrack.association.moves import ends_at
from graphtrack.association.offline import associate_detections, repair_detections
from graphtrack.tracks.detections import APPEARANCE, Detections


class Search(offline._Search):
    """A search that has been settled once, and one that keeps nothing from move to move."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.remembers = False

    def join_generously(self) -> None:
        super().join_generously()
        self.remembers = False


@pytest.fixture(scope="module")
def settled() -> Search:
    search = Search(packed_square(np.random.default_rng(0), people=30, frames=30)[0], {})
    search.join_generously()
    search.settle()
    return search


def cuts(search: Search) -> Any:
    for first in search._first[1:].tolist():
        yield first, *ends_at(search.chains, first, search.packed)


@pytest.mark.slow
def test_the_grid_finds_what_is_within_the_gate(settled: Search) -> None:
    chains, scene, rows = settled.chains, settled.packed, settled.chains.rows
    found, near = 0, np.empty(len(rows), np.int64)
    for _, heads, tails in cuts(settled):
        grid = grid_of(chains, tails, np.arange(len(tails)))
        for k in heads.tolist():
            state, dt = chains.state[k], chains.t[tails] - chains.t[k]
            mean = np.array([state["x"], state["y"]]) + dt[:, None] * [state["vx"], state["vy"]]
            off = chains.position[tails] - mean
            spread = state["pp"] + 2.0 * dt * state["pv"] + dt**2 * state["vv"] + scene.density * dt**3 / 3.0
            spread += chains.variance[tails] + scene.jump_variance
            within = (np.sum(off**2, axis=1) < GATE**2 * spread) & (dt <= scene.longest_gap)
            one, bounds = rows[k], np.full(len(grid.groups), np.inf)
            count = near_detections(
                chains, state, float(one["t"]), int(one["frame"]), grid, bounds, scene, near
            )
            assert sorted(near[:count].tolist()) == np.flatnonzero(within).tolist()
            found += count
    assert found > 1000


def test_what_is_outbid_or_hopeless_changes_no_match(settled: Search) -> None:
    chains, scene = settled.chains, settled.packed
    left_out = 0
    for first, heads, tails in cuts(settled):
        rows, least = np.arange(len(heads)), np.full(len(tails), -1e9)
        fresh = np.ones(len(heads), bool), np.ones(len(tails), bool)
        i, j, gain = gains_of_links(chains, heads, heads, tails, fresh, rows, least, scene)
        dense = np.zeros((len(heads), len(tails)))
        dense[i, j] = np.maximum(gain, 0.0)
        row, column = linear_sum_assignment(dense, maximize=True)
        expected = np.full(len(heads), -1)
        some = dense[row, column] > 0.0
        expected[row[some]] = column[some]
        edges = settled._links(heads, tails, first)
        assert edges is not None
        np.testing.assert_array_equal(match(edges, dense.shape), expected)
        left_out += len(gain) - len(edges[0])
    assert left_out > 1000


def crowds() -> dict[str, Detections]:
    seen, whose = street(np.random.default_rng(7), people=14, frames=40, miss=0.15, false=1.0)
    rng = np.random.default_rng(3)
    shown = {APPEARANCE: descriptors_of_people(rng, whose), "body": rng.uniform(-3.0, 3.0, len(seen))}
    return {
        "street": street(np.random.default_rng(5), people=8, frames=25, miss=0.2, false=2.0)[0],
        "square": packed_square(np.random.default_rng(1), people=30, frames=30)[0],
        "looks": Detections(seen.frame, seen.t, seen.position, {**seen.channels, **shown}),
    }


@pytest.mark.parametrize("name", others_slow(crowds(), ["street"]))
def test_what_is_kept_from_sweep_to_sweep_changes_nobody(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    detections = crowds()[name]
    given = np.arange(len(detections)) % 7
    once, mended = associate_detections(detections), repair_detections(detections, given)
    settled = associate_detections(detections, once.scene)
    monkeypatch.setattr(offline, "_Search", Search)
    again = associate_detections(detections)
    # An outbid candidate is not recomputed where the better candidate has changed indirectly.
    assert (once.identity != again.identity).mean() < 2e-3
    # What is learned on the way differs a little, and evidence is one of the same parameters alone.
    assert settled.evidence == pytest.approx(associate_detections(detections, once.scene).evidence, rel=1e-4)
    np.testing.assert_array_equal(mended.identity, repair_detections(detections, given).identity)


@pytest.mark.slow
def test_the_match_is_that_of_the_hungarian_method() -> None:
    rng = np.random.default_rng(0)
    for density in (0.02, 0.1, 0.3, 1.0):
        for _ in range(20):
            shape = int(rng.integers(1, 40)), int(rng.integers(1, 40))
            gains = np.where(rng.random(shape) < density, rng.normal(1.0, 2.0, shape), 0.0)
            i, j = np.nonzero(gains)
            partner = match((i, j, gains[i, j]), shape)
            some = np.flatnonzero(partner >= 0)
            assert len(set(partner[some].tolist())) == len(some)
            assert (gains[some, partner[some]] > 0.0).all()
            positive = np.maximum(gains, 0.0)
            best = positive[linear_sum_assignment(positive, maximize=True)].sum()
            assert gains[some, partner[some]].sum() == pytest.approx(best)


@pytest.mark.slow
def test_the_number_of_threads_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    detections = packed_square(np.random.default_rng(4), people=30, frames=30)[0]
    found = []
    for threads in (1, 3):
        monkeypatch.setattr(moves, "processors", lambda threads=threads: threads)
        monkeypatch.setattr(moves, "_ROWS_OF_A_THREAD", 4)
        found.append(associate_detections(detections))
    one, other = found
    np.testing.assert_array_equal(other.identity, one.identity)
    np.testing.assert_array_equal(other.probability, one.probability)
    assert other.evidence == one.evidence
