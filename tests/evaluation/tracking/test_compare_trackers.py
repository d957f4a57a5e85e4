"""Trackers get the same detections and scores; trackers of other packages are adapted or reported."""

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from command import Done, ran, run

import graphtrack as gt
from graphtrack import InputError, Track, TrackSet
from graphtrack.baselines.hungarian import HungarianParameters
from graphtrack.evaluation.methods import Method
from graphtrack.evaluation.trackers import (
    INSTALL,
    TUNED,
    DetectedScene,
    PeerParameters,
    compare_trackers,
    corners_of,
    load,
    make_tracker,
    read_detections,
    track_boxes,
    tuned,
)
from graphtrack.io.options import ReadOptions
from graphtrack.model import Model
from graphtrack.simulation.crowd import CrossedArea, crowd
from graphtrack.simulation.detector import Detector, detect
from graphtrack.tracks.detections import Detections

OWN = ("associate", "online", "hungarian")
NONE = np.empty(0, np.int64)


@pytest.fixture(scope="module")
def scene() -> DetectedScene:
    rng = np.random.default_rng(11)
    faults = Detector(missed=0.1, clutter=0.5)
    found = detect(crowd(rng, seconds=32.0), faults, position_std=0.1, rng=rng)
    table = found.anonymous(rng)
    position = np.column_stack([table["x"], table["y"]])
    return DetectedScene(Detections(table["frame"], table["t"], position), found.truth)


@dataclass
class Boxes:
    """A stand-in for ``supervision.Detections``."""

    xyxy: np.ndarray
    confidence: np.ndarray | None = None
    data: dict = field(default_factory=dict)
    tracker_id: np.ndarray = field(default_factory=lambda: NONE)

    def __len__(self) -> int:
        return len(self.xyxy)


class Nearest:
    """A tracker of boxes that joins each to the nearest of the frame before, and answers in reverse order."""

    def __init__(self, **told: float) -> None:
        self.told, self.before, self.ids, self.next = told, np.empty((0, 2)), NONE, 1

    def update(self, boxes: Boxes) -> Boxes:
        if not len(boxes):
            return Boxes(np.empty((0, 4)))  # as the package does: no data, no identities
        centre = 0.5 * (boxes.xyxy[:, :2] + boxes.xyxy[:, 2:])
        size = np.ptp(boxes.xyxy.reshape(-1, 2, 2), axis=1).max(initial=1.0)
        ids = np.full(len(centre), -1)
        for i, place in enumerate(centre):
            far = np.linalg.norm(self.before - place, axis=1)
            if len(far) and far.min() < 0.5 * size and self.ids[far.argmin()] not in ids:
                ids[i] = self.ids[far.argmin()]
            else:
                ids[i], self.next = self.next, self.next + 1
        self.before, self.ids = centre, ids
        order = np.arange(len(ids))[::-1]
        return Boxes(boxes.xyxy[order], None, {"row": boxes.data["row"][order]}, ids[order])


@pytest.fixture
def ducks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules of the peers' names that hold a duck each."""
    trackers, supervision = ModuleType("trackers"), ModuleType("supervision")
    vars(trackers).update(ByteTrackTracker=Nearest, OCSORTTracker=Nearest)
    vars(supervision).update(Detections=Boxes)
    monkeypatch.setitem(sys.modules, "trackers", trackers)
    monkeypatch.setitem(sys.modules, "supervision", supervision)


@pytest.mark.slow
def test_our_trackers_find_most_and_the_offline_one_more(scene: DetectedScene) -> None:
    found = compare_trackers(scene.detections, scene.truth, OWN)
    assert [one.method for one in found.results] == ["online", "hungarian", "associate"], "online first"
    *online, offline = (one.score for one in found.results)
    assert all(0.6 < one.idf1 < offline.idf1 for one in online)
    filled = compare_trackers(scene.detections, scene.truth, OWN, fill=True)
    *online_filled, offline_again = (one.score for one in filled.results)
    # `online` reports hidden people itself: filling adds none.
    assert all(more.recall >= one.recall for more, one in zip(online_filled, online, strict=True))
    assert online_filled[1].recall > online[1].recall
    assert offline_again == offline
    json.dumps(found.to_dict())


def test_figures_are_those_of_score(scene: DetectedScene) -> None:
    method = make_tracker("hungarian", Model("joint"))
    (found,) = compare_trackers(scene.detections, scene.truth, [method], metres=0.7).results
    assert found.score == gt.score(method.run(scene.detections), scene.truth, metres=0.7).together


def test_a_method_of_your_own_takes_part(scene: DetectedScene) -> None:
    nobody = Method("nobody", True, "finds nobody", lambda detections: TrackSet(()))
    (found,) = compare_trackers(scene.detections, scene.truth, [nobody], fill=True).results
    assert found.score.idf1 == 0.0 and found.score.recall == 0.0


def test_detections_of_nobody_are_nobodys_tracks() -> None:
    rng = np.random.default_rng(0)
    frame = np.arange(6)
    alone = Detections(10 * frame, 4.0 * frame, rng.uniform(0.0, 100.0, (6, 2)))
    truth = TrackSet((Track(1, 10 * frame, 4.0 * frame, np.full((6, 2), 500.0)),))
    for one in compare_trackers(alone, truth, OWN).results:
        assert one.score.matches == 0 and one.score.misses == 6


@pytest.mark.parametrize("methods", [[], ["hungarian", "hungarian"], ["magic"]])
def test_methods_that_are_none_are_refused(methods: list[str], scene: DetectedScene) -> None:
    with pytest.raises(InputError, match="method"):
        compare_trackers(scene.detections, scene.truth, methods)


def test_boxes_of_the_image_are_given_where_they_are_known() -> None:
    box = np.array([[5.0, 6.0, 10.0, 30.0]])
    seen = Detections(np.zeros(1, np.int64), np.zeros(1), np.ones((1, 2)), {"box": box})
    np.testing.assert_array_equal(corners_of(seen, PeerParameters()), [[5.0, 6.0, 15.0, 36.0]])


def test_a_peer_is_given_every_frame_and_its_answers_go_where_they_belong(ducks: None) -> None:
    t = 0.4 * np.arange(12)
    people = [np.column_stack([0.3 * np.arange(12), np.full(12, 5.0 * k)]) for k in range(4)]
    rng = np.random.default_rng(0)
    rows = [(k, who) for k in range(12) if k not in (5, 6) for who in rng.permutation(4)]
    frame = np.array([k for k, _ in rows])
    position = np.array([people[who][k] for k, who in rows])
    detections = Detections(10 * frame, t[frame], position)
    told: list[dict] = []
    make, boxes_of = load("ocsort")

    class Counted(Nearest):
        updates = 0

        def update(self, boxes: Boxes) -> Boxes:
            type(self).updates += 1
            return super().update(boxes)

    def counted(parameters: PeerParameters, fps: float) -> Counted:
        told.append({"fps": fps})
        return Counted()

    found = track_boxes(detections, PeerParameters(side=2.0), counted, boxes_of)
    assert Counted.updates == 12 and told == [{"fps": pytest.approx(2.5)}]
    assert len(found) == 4
    for track in found:
        assert np.ptp(track.position[:, 1]) == 0.0, "one person throughout"
        np.testing.assert_array_equal(track.frame, 10 * np.array([0, 1, 2, 3, 4, 7, 8, 9, 10, 11]))
    assert isinstance(make(TUNED["ocsort"], 2.5), Nearest)


def test_a_peer_is_told_its_gap_in_frames_at_30_hz_and_the_rate(ducks: None) -> None:
    make, _ = load("bytetrack")
    told = make(PeerParameters(longest_gap=2.0, minimum_iou=0.3, minimum_frames=3), 2.5).told
    assert told == {
        "lost_track_buffer": 60,
        "frame_rate": 2.5,
        "minimum_consecutive_frames": 3,
        "minimum_iou_threshold": 0.3,
    }


def test_a_peer_that_is_not_installed_is_one_error_that_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, scene: DetectedScene
) -> None:
    monkeypatch.setitem(sys.modules, "trackers", None)
    with pytest.raises(InputError) as told:
        compare_trackers(scene.detections, scene.truth, ["bytetrack"])
    assert told.value.expected == INSTALL


@pytest.mark.parametrize("name", ["bytetrack", "ocsort"])
def test_the_peers_themselves(name: str, scene: DetectedScene) -> None:
    for module in ("trackers", "supervision"):
        pytest.importorskip(module, reason="the peers are an extra: see docs/tracking.md")
    found = compare_trackers(scene.detections, scene.truth, [name])
    assert 0.4 < found.results[0].score.idf1 < 1.0 and found.results[0].score.precision > 0.9


def test_tuning_climbs_to_the_best_and_passes_over_what_is_refused() -> None:
    def value(parameters: HungarianParameters) -> float:
        return -((parameters.gate - 3.2) ** 2) - (parameters.hits - 4) ** 2 - abs(parameters.frames - 6)

    grid = {"gate": (1.0, 2.0, 3.0, 4.0), "hits": (1, 2, 3, 4), "frames": (1, 2, 6)}
    steps: list[float] = []
    found = tuned(HungarianParameters(), grid, value, lambda parameters, worth: steps.append(worth))
    assert (found.gate, found.hits, found.frames) == (3.0, 4, 6)
    assert steps == sorted(steps) and steps


def test_a_crowd_walks_as_the_place_says() -> None:
    place = CrossedArea(stops=0.0, pairs=0.0)
    people = crowd(np.random.default_rng(0), place=place, seconds=300.0)
    half = 0.5 * np.array([place.width, place.depth]) + 2.0
    speeds = []
    for track in people:
        assert (np.abs(track.position) < half).all()
        if len(track) > 4:
            moved = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
            speeds.append(float(np.median(moved * 2.5)))
    assert abs(np.mean(speeds) - place.speed) < 0.15
    assert abs(len(people) - place.arrivals * 310.0) < 5.0 * np.sqrt(place.arrivals * 310.0)


def test_walkers_in_pairs_keep_side_by_side() -> None:
    people = crowd(np.random.default_rng(1), place=CrossedArea(pairs=1.0), seconds=60.0).tracks
    apart = [
        float(np.median(np.linalg.norm(one.position - other.position, axis=1)))
        for one, other in zip(people[::2], people[1::2], strict=True)
        if np.array_equal(one.frame, other.frame)
    ]
    assert len(apart) == len(people) // 2 and 0.6 < np.median(apart) < 1.0


@pytest.fixture
def here(cwd: Path) -> Path:
    """A folder with detections and their truth."""
    gt.write(crowd(np.random.default_rng(3), seconds=30.0), "exact.csv")
    line = "add-noise exact.csv -o detections.csv --truth-output truth.csv --position-noise 0.1 --missed 0.1"
    ran(*line.split(), "--clutter", 1, "--anonymous", program="graphtrack")
    return cwd


def compare(*more: str) -> Done:
    return run("compare", "detections.csv", "--truth", "truth.csv", *more, program="graphtrack")


@pytest.mark.slow
def test_the_command_prints_a_line_for_each_method_and_writes_all_figures(here: Path, ducks: None) -> None:
    done = compare("--methods", "associate,hungarian,bytetrack,ocsort", "--json", "found.json")
    assert done.returncode == 0, done.stderr
    found = json.loads((here / "found.json").read_text())
    assert [one["method"] for one in found["methods"]] == ["hungarian", "bytetrack", "ocsort", "associate"]
    for one in found["methods"]:
        assert one["method"] in done.stdout and one["seconds"] >= 0.0
        for name in ("hota", "idf1", "mota", "switches", "precision", "recall", "fragmentations"):
            assert np.isfinite(one[name])
    for heading in ("HOTA", "IDF1", "MOTA", "switches", "precision", "recall", "fragmentations", "seconds"):
        assert heading in done.stdout


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("--methods kf", "associate, online, hungarian"),
        ("--methods ,", "no methods"),
        ("--occlude 2", "--occlude"),
        ("--position-noise 0.1", "--position-noise"),
        ("--figures figures", "--figures"),
        ("--associate never", "--associate never"),
        ("--select 1", "--select"),
        ("--metres -1", "metres"),
        ("truth.csv", "2 files"),
        ("--json detections.csv", "--json"),
    ],
)
def test_what_means_nothing_here_is_one_error(more: str, said: str, here: Path) -> None:
    done = compare(*more.split())
    assert done.returncode == 2 and done.stderr.splitlines()[-1].startswith("error: ")
    assert said in done.stderr


def test_identities_in_the_input_are_forgotten_only_when_that_is_asked_for(here: Path) -> None:
    line = ["compare", "truth.csv", "--truth", "truth.csv", "--methods", "hungarian"]
    done = run(*line, program="graphtrack")
    assert done.returncode == 2 and "--associate always" in done.stderr
    assert run(*line, "--associate", "always", program="graphtrack").returncode == 0


@pytest.mark.parametrize("more", ["--metres 1", "--fill", "--associate always"])
def test_what_is_of_trackers_needs_a_truth(more: str, here: Path) -> None:
    done = run("compare", "truth.csv", "--position-noise", "0.1", *more.split(), program="graphtrack")
    assert done.returncode == 2 and "with --truth" in done.stderr


def test_detections_of_a_detector_have_its_boxes_in_the_order_of_time(tmp_path: Path) -> None:
    rows = ["2,-1,30,40,10,20,0.9,-1,-1,-1", "1,-1,10,20,10,20,0.8,-1,-1,-1", "1,-1,1,2,10,20,0,-1,-1,-1"]
    (tmp_path / "det.txt").write_text("\n".join(rows) + "\n")
    found, _ = read_detections(tmp_path / "det.txt", None, ReadOptions(metres_per_pixel=0.01, fps=10.0))
    np.testing.assert_array_equal(found.frame, [1, 2])
    np.testing.assert_array_equal(found.channels["box"], [[10, 20, 10, 20], [30, 40, 10, 20]])
