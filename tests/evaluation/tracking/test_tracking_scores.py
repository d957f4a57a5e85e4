"""Scores of tracking: equal to TrackEval's and Stone Soup's, their properties, and identity events."""

import datetime
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stonesoup.metricgenerator.ospametric import GOSPAMetric
from stonesoup.types.state import State
from trackeval_scores import oracle, without_curves
from tracking_scenes import as_tracks, random_scene

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.evaluation.identities import gospa_counts, judge, threshold_of
from graphtrack.evaluation.identity_events import judge_events
from graphtrack.evaluation.matching import (
    boxes,
    estimated_detections,
    ground_similarity,
    known_detections,
    share_frames,
    true_detections,
)
from graphtrack.io.read_write import read_boxes
from graphtrack.tracks.track import Track, TrackSet

NEEDED = "pip install --no-deps trackeval==1.3.0 to compare with it"


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


@pytest.mark.parametrize(
    ("demand", "boxes"), [({"metres": 0.5}, False), ({"iou": 0.3}, True)], ids=["ground", "image"]
)
@settings(max_examples=12)
@given(seeds=st.lists(st.integers(0, 10**6), min_size=1, max_size=3))
def test_as_trackeval_says(demand, boxes, seeds):
    pytest.importorskip("trackeval", reason=NEEDED)
    pairs = [random_scene(seed, boxes=boxes) for seed in seeds]
    sequences, together = figures_of(pairs, demand)
    for ours, pair in zip(sequences, pairs, strict=True):
        check(ours, oracle([pair], **demand))
    check(together, oracle(pairs, **demand))


@given(data=st.data())
def test_as_trackeval_says_of_ties(data):
    """Positions on a coarse grid, so that many distances are equal and many exactly the threshold."""
    pytest.importorskip("trackeval", reason=NEEDED)
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
    pytest.importorskip("trackeval", reason=NEEDED)
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


N = 40


def walkers(count=4, apart=5.0):
    """People side by side, too far apart to be taken for one another."""
    frame = np.arange(N)
    return TrackSet(
        tuple(
            Track(k, frame, frame / 10.0, np.column_stack([0.13 * frame, np.full(N, apart * k)]))
            for k in range(count)
        )
    )


def together(estimates, truth, **demand):
    return gt.score(estimates, truth, **demand).together


def test_the_distance_decides():
    truth = walkers(2)
    off = truth.map(lambda track: replace(track, position=track.position + np.array([0.0, 0.6])))
    found = together(off, truth)
    assert found.recall == 1.0 and found.mean_distance == pytest.approx(0.6)
    assert found.motp == pytest.approx(1.0 - 0.6 / 2.0)
    closer = together(off, truth, metres=0.5)
    assert closer.recall == 0.0 and closer.mean_distance is None and closer.mota == -1.0
    # HOTA asks for more and less: 0.4 of one metre, which is zero, is enough up to α = 0.4.
    assert closer.hota == pytest.approx(8 / 19)


def test_true_positions_of_the_truth_are_compared_where_there_are_any():
    exact = walkers(2)
    noisy = exact.map(
        lambda track: replace(
            track, position=track.position + np.array([0.0, 3.0]), true_position=track.position
        )
    )
    assert together(exact, noisy).hota == 1.0
    assert together(noisy, exact).recall == 0.0


def test_missing_positions_are_no_detections_and_it_is_said():
    truth = walkers(2)
    position = truth[0].position.copy()
    position[3:5] = np.nan
    score = gt.score(TrackSet((replace(truth[0], position=position), truth[1])), truth)
    assert score.together.misses == 2 and score.together.false_positives == 0
    assert score.notes == ("2 rows of the estimates without a position: left out",)


def test_nobody_found_is_a_score_of_zero():
    found = together(TrackSet(()), walkers(3))
    assert (found.hota, found.idf1, found.mota, found.recall) == (0.0, 0.0, 0.0, 0.0)
    assert found.misses == 3 * N and found.mostly_lost == 3


def test_estimates_beside_the_frames_of_the_truth_are_false_positives():
    longer = walkers(1)
    found = together(longer, longer.map(lambda track: track[:10]))
    assert (found.matches, found.false_positives, found.frames) == (10, N - 10, N)


def test_what_is_said_of_a_score():
    truth = walkers(2)
    score = gt.score(truth, truth)
    assert isinstance(score, gt.TrackingScore)
    assert repr(score) == "TrackingScore(HOTA 1.000, IDF1 1.000, MOTA 1.000; 1 sequence, within 1 m)"
    page = score._repr_html_()
    assert "<th>IDF1</th>" in page and "<td>1.000</td>" in page
    plain = score.to_dict()
    assert plain["measure"] == "metres" and plain["threshold"] == 1.0
    assert plain["together"]["curves"]["alpha"] == pytest.approx(np.arange(1, 20) / 20.0)
    assert plain["together"]["curves"]["HOTA"] == [1.0] * 19


@pytest.mark.parametrize(
    ("estimates", "demand", "said"),
    [
        (walkers(1), {"metres": 1.0, "iou": 0.5}, "metres and iou"),
        (walkers(1), {"metres": 0.0}, "metres = 0"),
        (walkers(1), {"metres": float("nan")}, "metres = nan"),
        (walkers(1), {"iou": 1.5}, "iou = 1.5"),
        (walkers(1), {"iou": 0.5}, "a TrackSet, which has no boxes"),
        (
            walkers(1).map(lambda track: replace(track, frame=track.frame + 1000, t=track.t + 1000.0)),
            {},
            "no frame in common",
        ),
        (7, {}, "a int"),
    ],
)
def test_wrong_input_is_told(estimates, demand, said):
    with pytest.raises(InputError, match=said):
        gt.score(estimates, walkers(1), **demand)


def test_a_truth_without_anybody_is_told():
    (walker,) = walkers(1)
    nowhere = TrackSet((replace(walker, position=np.full((N, 2), np.nan)),))
    for truth in (nowhere, TrackSet(())):
        with pytest.raises(InputError, match="no position in the truth"):
            gt.score(walkers(1), truth)


def standing(track_id, x, frames):
    frames = np.asarray(frames)
    return Track(track_id, frames, frames / 10.0, np.tile([float(x), 0.0], (len(frames), 1)))


@pytest.mark.parametrize("seed", range(20))
def test_there_are_as_many_events_as_the_score_counts(seed):
    estimates, truth = (as_tracks(one) for one in random_scene(seed))
    judged = judge_events(estimates, truth, metres=0.5)
    score = gt.score(estimates, truth, metres=0.5).together
    assert sum(event.switch for event in judged.events) == score.switches
    assert sum(event.found_again for event in judged.events) == score.fragmentations
    assert [event.frame for event in judged.events] == sorted(event.frame for event in judged.events)
    assert all(event.switch == (event.before != event.after) for event in judged.events)
    matched = [np.isfinite(track.true_position).all(axis=1) for track in judged.tracks]
    assert sum(int(rows.sum()) for rows in matched) == score.matches
    # The track of a person stays near them.
    tracks, people = ({track.track_id: track for track in one} for one in (judged.tracks, truth))
    for event in judged.events:
        track, person = tracks[event.after], people[event.person]
        here = track.true_position[track.frame == event.frame]
        assert here == pytest.approx(person.position[person.frame == event.frame])
        assert np.linalg.norm(here - track.position[track.frame == event.frame]) <= 0.5 + 1e-9


def test_a_swap_and_a_loss_are_told_with_both_identities():
    truth = TrackSet((standing(1, 0, range(20)), standing(2, 5, range(20))))
    first = np.array([[0.0, 0.0]] * 10 + [[5.0, 0.0]] * 10)
    second = first[::-1]
    frames = np.arange(20)
    swapped = TrackSet((Track(10, frames, frames / 10.0, first), Track(20, frames, frames / 10.0, second)))
    told = [
        (e.frame, e.person, e.before, e.after, e.switch, e.found_again)
        for e in judge_events(swapped, truth).events
    ]
    assert told == [(10, 1, 10, 20, True, False), (10, 2, 20, 10, True, False)]
    lost = TrackSet((standing(10, 0, [0, 1, 2, 8, 9]), standing(20, 5, range(20))))
    told = [
        (e.frame, e.person, e.before, e.after, e.switch, e.found_again)
        for e in judge_events(lost, truth).events
    ]
    assert told == [(8, 1, 10, 10, False, True)]


def test_where_nobody_matches_there_is_nothing_to_tell():
    truth, far = TrackSet((standing(1, 0, range(5)),)), TrackSet((standing(1, 50, range(5)),))
    judged = judge_events(far, truth)
    assert judged.events == ()
    assert all(track.true_position is None or np.isnan(track.true_position).all() for track in judged.tracks)
