"""Data association of detections without identities; false detections are left out."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command import run as run_command
from crossing_people import idf1, street

import graphtrack as gt
from graphtrack.association.likelihood import log_gap, scene_of
from graphtrack.association.offline import associate_detections, repair_detections
from graphtrack.tracks.detections import Detections
from graphtrack.tracks.scene import SceneParameters


def table_of(detections: Detections) -> pd.DataFrame:
    x, y = detections.position.T
    return pd.DataFrame({"frame": detections.frame, "t": detections.t, "x": x, "y": y})


@pytest.mark.slow
def test_noise_misses_and_false_detections_leave_most_identities() -> None:
    scores = []
    for seed in range(2):
        detections, whose = street(np.random.default_rng(seed), miss=0.15, false=1.0)
        found = associate_detections(detections)
        scores.append(idf1(found.identity, whose))
        assert (found.identity[whose < 0] < 0).mean() > 0.5
    assert np.mean(scores) > 0.93


def test_nobody_has_two_detections_in_a_frame_and_the_evidence_is_positive() -> None:
    detections, _ = street(np.random.default_rng(5), people=8, frames=40, miss=0.2, false=2.0)
    found = associate_detections(detections)
    known = found.identity >= 0
    pairs = np.column_stack([found.identity[known], detections.frame[known]])
    assert len(np.unique(pairs, axis=0)) == known.sum() and found.evidence > 0.0
    assert ((found.probability >= 0.0) & (found.probability <= 1.0 + 1e-9)).all()


@pytest.mark.slow
def test_the_order_of_a_frames_detections_has_no_effect() -> None:
    detections, _ = street(np.random.default_rng(6), people=8, frames=40, miss=0.1, false=1.0)
    shuffled = np.random.default_rng(0).permutation(len(detections))
    again = Detections(detections.frame[shuffled], detections.t[shuffled], detections.position[shuffled])
    first, second = associate_detections(detections).identity, associate_detections(again).identity
    back = np.empty(len(shuffled), np.int64)
    back[shuffled[again.row]] = second
    for one in range(first.max() + 1):
        assert len(set(back[first == one].tolist())) == 1
    assert ((first < 0) == (back < 0)).all()


def test_who_crosses_is_told_by_where_they_came_from() -> None:
    """Two walk through each other's place and miss each other by a hand; nearest neighbours would swap."""
    t = np.arange(20) * 0.4
    one = np.column_stack([1.3 * t - 5.0, 0.10 * np.ones(20)])
    other = np.column_stack([5.0 - 1.3 * t, -0.10 * np.ones(20)])
    frame = np.repeat(np.arange(20), 2)
    position = np.stack([one, other], axis=1).reshape(-1, 2)
    found = associate_detections(Detections(frame, frame * 0.4, position)).identity
    assert len(set(found[::2].tolist())) == len(set(found[1::2].tolist())) == 1 and found[0] != found[1]


def test_second_boxes_of_one_person_are_no_people() -> None:
    rng = np.random.default_rng(8)
    detections, whose = street(rng, people=10)
    twice = rng.random(len(detections)) < 0.25
    frame = np.concatenate([detections.frame, detections.frame[twice]])
    near = detections.position[twice] + rng.normal(0.0, 0.4, (twice.sum(), 2))
    both = Detections(frame, frame * 0.4, np.vstack([detections.position, near]))
    found = associate_detections(both)
    assert abs(found.identity.max() + 1 - 10) <= 2 and found.scene.duplicate_rate > 0.05
    owner = np.concatenate([whose, np.full(twice.sum(), -1)])[both.row]
    assert idf1(found.identity, owner) > 0.85


def test_a_gap_is_an_occlusion_rather_than_many_misses() -> None:
    scene = scene_of(SceneParameters(), 0.1)
    gaps = np.array([log_gap(k, scene) for k in range(40)])
    assert gaps[0] == 0.0 and gaps[1] == pytest.approx(np.log(0.1 + 0.01 * np.exp(-0.1 / 2.0)))
    # Once hidden, a further frame costs next to nothing.
    assert gaps[39] - gaps[38] == pytest.approx(-0.05, abs=1e-3)


# Files, tables, commands.


def test_a_table_without_identities_becomes_tracks_with_gaps_marked(tmp_path: Path) -> None:
    detections, _ = street(np.random.default_rng(10), people=5, miss=0.2)
    path = tmp_path / "seen.csv"
    table_of(detections).to_csv(path, index=False)
    tracks = gt.read(path)
    assert 4 <= len(tracks) <= 7
    assert any("associated" in note and "people" in note for note in tracks.summary.notes)
    smoothed = gt.smooth(tracks, "position")
    gaps = 0
    for track in smoothed:
        np.testing.assert_array_equal(np.diff(track.frame), 1)
        assert np.isfinite(track.position).all() and set(np.unique(track.observed)) <= {0.0, 1.0}
        assert (np.isnan(track.identity_p) == (track.observed == 0.0)).all()
        gaps += int((track.observed == 0.0).sum())
    assert gaps > 0
    columns = smoothed.to_table().columns
    assert {"identity_p", "observed"} <= set(columns)


@pytest.mark.slow
def test_identities_are_forgotten_repaired_or_asked_for_on_request_alone(tmp_path: Path) -> None:
    detections, whose = street(np.random.default_rng(11), people=4)
    table = table_of(detections).assign(track_id=1000 + whose)
    path = tmp_path / "tracked.csv"
    table.to_csv(path, index=False)
    assert {track.track_id for track in gt.read(path)} == {1000, 1001, 1002, 1003}
    assert {track.track_id for track in gt.read(path, associate="always")} == {1, 2, 3, 4}
    assert {track.track_id for track in gt.associate(gt.read(path))} == {1, 2, 3, 4}
    half = np.median(detections.frame[whose == 2])
    table["track_id"] = np.where((whose == 2) & (detections.frame > half), 40, whose)
    table.to_csv(path, index=False)
    tracks = gt.read(path, associate="repair")
    assert len(tracks) == 4 and "repaired 5 tracks: now 4" in " ".join(tracks.summary.notes)
    assert sum(int(np.isfinite(track.position[:, 0]).sum()) for track in tracks) == len(detections)
    table.drop(columns="track_id").to_csv(path, index=False)
    with pytest.raises(gt.InputError, match="rows without identities"):
        gt.read(path, associate="never")
    with pytest.raises(gt.InputError, match="rows without identities"):
        gt.track_online(path, "position")
    with pytest.raises(gt.InputError, match="associate = 'perhaps'"):
        gt.read(path, associate="perhaps")
    lines = [f"{k},-1,{100 + 3 * k},50,20,40,0.9,-1,-1,-1" for k in range(1, 30)]
    path.write_text("\n".join([*lines, "30,4,200,50,20,40,0.9,-1,-1,-1"]), encoding="utf-8")
    with pytest.raises(gt.InputError, match=r"line 1.*29 of 30 are detections without identity"):
        gt.read(path, metres_per_pixel=0.02, fps=10.0)


@pytest.mark.slow
def test_the_published_trackers_are_reached_on_real_detections(data_dir: Path) -> None:
    """Town Centre, 60 s at 2.5 Hz, positions alone; SORT has 0.445, the best published tracker 0.596."""
    folder = data_dir / "towncentre" / "frames_001_150"
    options = {"calibration": data_dir / "towncentre" / "calibration.ci", "fps": 2.5}
    found = gt.smooth(gt.read(folder / "det.txt", **options), "position")
    together = gt.score(found, gt.read(folder / "gt.txt", **options), metres=1.0).together
    assert together.idf1 > 0.5 and together.mota > 0.25


def test_a_tracker_that_swaps_two_people_and_loses_one_is_repaired() -> None:
    detections, whose = street(np.random.default_rng(11), people=8, frames=50, noise=0.05)
    given, half = whose.copy(), 25
    ids, counts = np.unique(whose[detections.frame < half], return_counts=True)
    one, other = ids[np.argsort(-counts)][:2].tolist()
    late = detections.frame >= half
    given[late & (whose == one)], given[late & (whose == other)] = other, one
    lost = int(np.argmax(np.bincount(whose)))
    given[late & (whose == lost)] = 99
    assert idf1(given, whose) < 0.97
    found = repair_detections(detections, given)
    assert idf1(found.identity, whose) == 1.0
    # Correct identities are kept.
    right = ~np.isin(whose, [one, other, lost])
    np.testing.assert_array_equal(found.identity[right], given[right])


def rows_of_text(path: Path, rows: list[str], more: str = "") -> Path:
    path.write_text("\n".join([f"frame,t,x,y{more}", *rows]) + "\n")
    return path


THREE = [f"{k},{0.1 * k:g},{0.1 * k:g},{3 * i}" for k in range(20) for i in range(3)]


def test_a_detection_that_is_given_twice_counts_once(tmp_path: Path) -> None:
    once = gt.read(rows_of_text(tmp_path / "once.csv", THREE))
    twice = gt.read(rows_of_text(tmp_path / "twice.csv", THREE + THREE[:9]))
    assert len(twice) == len(once) == 3
    assert twice.summary.refused == {"repeated in the same frame": 9}


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("9,0.05,1,1", "frame 9 at t = 0.05, expected t = 0.9"),
        ("30,0.55,1,1", "frame 30 at t = 0.55, expected"),
    ],
)
@pytest.mark.parametrize("command", ["smooth", "track"])
def test_times_that_run_back_are_one_error(tmp_path: Path, command: str, wrong: str, told: str) -> None:
    source = rows_of_text(tmp_path / "back.csv", [*THREE[:40], wrong, *THREE[40:]])
    done = run_command(command, source, "-o", tmp_path / "out.csv", program="graphtrack")
    assert done.returncode == 2 and f"back.csv, line 42: found {told}" in " ".join(done.stderr.split())
    assert not (tmp_path / "out.csv").exists()


def test_identities_in_some_rows_alone_are_one_error(tmp_path: Path) -> None:
    rows = [f"{row},{-1 if k % 4 == 3 else k % 3}" for k, row in enumerate(THREE)]
    source = rows_of_text(tmp_path / "half.csv", rows, ",track_id")
    with pytest.raises(gt.InputError, match=r"half.csv, line 5: .*without an identity.*--associate always"):
        gt.read(source)
    assert len(gt.read(source, associate="always")) == 3
