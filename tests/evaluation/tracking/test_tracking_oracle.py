"""Scores equal TrackEval's and Stone Soup's, on random scenes and for published trackers."""

import datetime
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stonesoup.metricgenerator.ospametric import GOSPAMetric
from stonesoup.types.state import State
from trackeval_scores import GROUND, IMAGE, SCENES, SEEDS, STORED, oracle, without_curves
from tracking_scenes import random_scene

import graphtrack as gt
from graphtrack.evaluation.identities import gospa_counts, judge, threshold_of
from graphtrack.evaluation.matching import (
    boxes,
    estimated_detections,
    ground_similarity,
    known_detections,
    share_frames,
    true_detections,
)
from graphtrack.io.read_write import read_boxes

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
@settings(max_examples=12)
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


CUTOFF = 2.0


def crowd(rng, frames, most):
    counts = rng.integers(0, most, frames)
    frame = np.repeat(np.arange(frames), counts)
    identity = np.concatenate([np.arange(count) for count in counts])
    return known_detections(identity, frame, rng.uniform(0.0, 5.0, (len(frame), 2)))


def states(side, frame):
    at = datetime.datetime(2020, 1, 1) + datetime.timedelta(seconds=frame)
    return [State(place[:, None], timestamp=at) for place in side.place[side.frame == frame]]


def test_it_is_that_of_stone_soup():
    rng = np.random.default_rng(0)
    truth, estimates = crowd(rng, 12, 7), crowd(rng, 12, 7)
    metric = GOSPAMetric(p=2, c=CUTOFF, switching_penalty=0.0)
    squares = []
    for frame in range(12):
        pair = states(estimates, frame), states(truth, frame)
        if pair[0] or pair[1]:
            squares.append(metric.compute_gospa_metric(*pair)[0].value["distance"] ** 2)
    frames = share_frames(truth, estimates, lambda a, b: ground_similarity(a, b, CUTOFF))
    assert CUTOFF * gospa_counts(frames).gospa == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-9)


NAMES = [
    "CNNTCM",
    "EAMTT",
    "JointMC",
    "KSP",
    "MDP",
    "MHT_DAM",
    "NOMTwSDP",
    "RNN",
    "SCEA",
    "SORT",
    "TDAM",
    "TSML_CDE",
]


@pytest.fixture(scope="module")
def recording(data_dir: Path) -> Path:
    folder = data_dir / "towncentre" / "frames_001_150"
    if not folder.is_dir():
        pytest.skip(f"no published tracks at {folder}")
    return folder


@pytest.mark.parametrize(("name", "idf1"), [("JointMC", 0.589), ("SORT", 0.440)])
def test_idf1_of_feet_through_the_calibration(name, idf1, recording, tmp_path):
    def on_ground(path):
        """The file without its positions, which are rounded to a grid, so that the camera makes them."""
        rows = [",".join([*line.split(",")[:7], "-1,-1,-1\n"]) for line in path.read_text().splitlines()]
        (tmp_path / path.name).write_text("".join(rows))
        return gt.read(tmp_path / path.name, calibration=recording.parent / "calibration.ci", fps=2.5)

    estimates, truth = on_ground(recording / "published" / f"{name}.txt"), on_ground(recording / "gt.txt")
    assert gt.score(estimates, truth).together.idf1 == pytest.approx(idf1, abs=5e-4)


@pytest.mark.parametrize("name", NAMES)
def test_all_figures_as_trackeval_has_them(name, recording):
    pytest.importorskip("trackeval", reason="pip install --no-deps trackeval==1.3.0 to compare with it")
    files = recording / "published" / f"{name}.txt", recording / "gt.txt"
    estimates, truth = (gt.read(path, fps=2.5) for path in files)
    check_all(
        gt.score(estimates, truth), [estimated_detections(estimates), true_detections(truth)], metres=1.0
    )
    check_all(gt.score(*files, iou=0.5), [boxes(read_boxes(path)) for path in files], iou=0.5)


def check_all(score, detections, **demand):
    theirs = oracle([tuple(detections)], **demand)
    ours = asdict(score.together)
    assert {key: ours[key] for key in without_curves(theirs)} == pytest.approx(
        without_curves(theirs), abs=1e-11
    )
    assert ours["curves"]["HOTA"] == pytest.approx(theirs["curves"]["HOTA"], abs=1e-11)
