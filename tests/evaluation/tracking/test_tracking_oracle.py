"""Scores equal TrackEval's: its stored ones always, and its own where it is installed."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trackeval_scores import GROUND, IMAGE, SCENES, SEEDS, STORED, oracle, without_curves
from tracking_scenes import random_scene

from graphtrack.evaluation.identities import judge, threshold_of
from graphtrack.evaluation.matching import known_detections

REFERENCE = json.loads(STORED.read_text(encoding="utf-8"))


def figures_of(pairs, demand):
    """Ours: of each pair, and of all together."""
    named = [(str(k), estimates, truth) for k, (estimates, truth) in enumerate(pairs)]
    found = judge(named, threshold_of(**demand))
    return [asdict(one) for one in found.sequences], asdict(found.together)


def check(ours, theirs):
    assert {name: ours[name] for name in theirs if name != "curves"} == pytest.approx(
        without_curves(theirs), abs=1e-11
    )
    for name, curve in theirs.get("curves", {}).items():
        assert ours["curves"][name] == pytest.approx(curve, abs=1e-11), name


@pytest.mark.parametrize("kind", SCENES)
def test_as_stored_from_trackeval(kind):
    sequences, together = figures_of([random_scene(s, boxes=kind == "image") for s in SEEDS], SCENES[kind])
    for ours, theirs in zip(sequences, REFERENCE[kind]["sequences"], strict=True):
        check(ours, theirs)
    check(together, REFERENCE[kind]["together"])
    # The scenes have all that is counted, and nothing that is stored is trivial.
    assert all(
        value > 0 for name, value in together.items() if isinstance(value, int) and name != "mostly_lost"
    )


@pytest.mark.parametrize(("demand", "boxes"), [(GROUND, False), (IMAGE, True)], ids=["ground", "image"])
@settings(deadline=None)
@given(seeds=st.lists(st.integers(0, 10**6), min_size=1, max_size=3))
def test_as_trackeval_says(demand, boxes, seeds):
    pytest.importorskip(
        "trackeval", reason="pip install --no-deps trackeval==1.3.0 to compare with it beyond what is stored"
    )
    pairs = [random_scene(seed, boxes=boxes) for seed in seeds]
    sequences, together = figures_of(pairs, demand)
    for ours, pair in zip(sequences, pairs, strict=True):
        check(ours, oracle([pair], **demand))
    check(together, oracle(pairs, **demand))


@settings(deadline=None)
@given(data=st.data())
def test_as_trackeval_says_of_ties(data):
    """Positions on a coarse grid, so that many distances are equal and many exactly the threshold."""
    pytest.importorskip(
        "trackeval", reason="pip install --no-deps trackeval==1.3.0 to compare with it beyond what is stored"
    )
    cell = st.tuples(st.integers(0, 3), st.integers(0, 5), st.integers(0, 3), st.integers(0, 3))
    both = []
    for _ in range(2):
        rows = data.draw(st.lists(cell, min_size=1, max_size=25, unique_by=lambda row: row[:2]))
        track_id, frame, *place = np.array(rows).T
        both.append(known_detections(track_id, frame, np.column_stack(place) / 3.0))
    if not np.isin(both[0].frame, both[1].frame).any():
        return
    (ours,), _ = figures_of([tuple(both)], {"metres": 1.0 / 3.0})
    check(ours, oracle([tuple(both)], metres=1.0 / 3.0))
