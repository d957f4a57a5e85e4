"""A simulated detector misses, occludes and adds detections at its rates, and the truth is recoverable."""

from __future__ import annotations

import numpy as np
import pytest
from command import run
from scipy import stats

import graphtrack as gt
from graphtrack import InputError, Track, TrackSet
from graphtrack.simulation.degrade import OBSERVED
from graphtrack.simulation.detector import FALSE, Detector, detect, sampled

ALL_FAULTS = Detector(missed=0.15, occluded_share=0.5, occluded_seconds=2.0, clutter=1.0)


def crowd(people: int = 60, seconds: float = 24.0, fps: float = 5.0) -> TrackSet:
    """People who come and go at different times and walk straight on."""
    rng = np.random.default_rng(7)
    tracks = []
    for k in range(people):
        frame = np.arange(rng.integers(0, 20), int(seconds * fps) - rng.integers(0, 20))
        course = rng.uniform(-np.pi, np.pi)
        walk = 1.2 * np.outer(frame / fps, [np.cos(course), np.sin(course)])
        tracks.append(Track(k, frame, frame / fps, rng.uniform(0.0, 10.0, 2) + walk, head=walk[:, 0] % 3.0))
    return TrackSet(tuple(tracks))


def people_of(tracks: TrackSet) -> list[Track]:
    return [track for track in tracks if track.label != FALSE]


def is_observed(track: Track) -> np.ndarray:
    return np.isfinite(track.position).all(axis=1)


def test_a_perfect_detector_changes_nothing() -> None:
    exact = crowd()
    found = detect(exact, rng=np.random.default_rng(0))
    for before, seen, truth in zip(exact, found.observed, found.truth, strict=True):
        for after in (seen.position, seen.true_position, truth.position):
            np.testing.assert_array_equal(after, before.position)
        np.testing.assert_array_equal(seen.head, before.head)


def test_as_many_are_missed_as_is_said_and_then_nothing_is_observed() -> None:
    found = detect(crowd(), Detector(missed=0.3), position_std=0.1, rng=np.random.default_rng(1))
    seen = np.concatenate([is_observed(track) for track in found.observed])
    low, high = stats.binom.interval(1.0 - 1e-4, len(seen), 0.7)
    assert low <= seen.sum() <= high
    for track, truth in zip(found.observed, found.truth, strict=True):
        for name in OBSERVED:
            values = getattr(track, name)
            if values is not None:
                missing = np.isnan(values.reshape(len(track), -1)).all(axis=1)
                np.testing.assert_array_equal(missing, ~is_observed(track))
        np.testing.assert_array_equal(track.true_position, truth.position)


def test_half_of_the_people_are_hidden_once_for_so_long_within_their_tracks() -> None:
    detector = Detector(occluded_share=0.5, occluded_seconds=2.0)
    starts = []
    for seed in range(20):
        observed = detect(crowd(), detector, rng=np.random.default_rng(seed)).observed
        hidden = [track for track in observed if not is_observed(track).all()]
        assert len(hidden) == 30
        for track in hidden:
            gone = np.flatnonzero(~is_observed(track))
            assert len(gone) == 10 and np.ptp(gone) == 9
            assert gone[0] > 0 and gone[-1] < len(track) - 1
            starts.append((gone[0] - 1) / (len(track) - 12))
    assert stats.kstest(starts, "uniform").pvalue > 1e-4


def test_false_detections_are_uniform_over_the_place_and_poisson_over_frames() -> None:
    exact = crowd()
    found = detect(exact, Detector(clutter=4.0), rng=np.random.default_rng(3))
    false = [track for track in found.observed if track.label == FALSE]
    assert len(false) == found.false and all(len(track) == 1 for track in false)
    assert not {track.track_id for track in false} & {track.track_id for track in exact}
    places = np.concatenate([track.position for track in exact])
    low, high = places.min(axis=0), places.max(axis=0)
    share = (np.concatenate([track.position for track in false]) - low) / (high - low)
    assert stats.kstest(share[:, 0], "uniform").pvalue > 1e-4
    assert stats.kstest(share[:, 1], "uniform").pvalue > 1e-4
    frames = np.unique(np.concatenate([track.frame for track in exact]))
    counts = np.array([sum(track.frame[0] == k for track in false) for k in frames])
    assert counts.sum() == len(false)
    dispersion = ((counts - 4.0) ** 2 / 4.0).sum()
    assert stats.chi2.interval(1.0 - 1e-4, len(frames))[0] < dispersion
    assert dispersion < stats.chi2.interval(1.0 - 1e-4, len(frames))[1]


def test_a_fixed_count_is_that_of_each_frame_also_where_nobody_is() -> None:
    alone = TrackSet((Track(1, [0, 1, 2], [0.0, 0.4, 0.8], np.zeros((3, 2))),))
    later = TrackSet((*alone, Track(2, [6, 7], [2.4, 2.8], np.ones((2, 2)))))
    detector = Detector(clutter=2.0, clutter_count="fixed")
    found = detect(later, detector, rng=np.random.default_rng(4))
    frames = [int(track.frame[0]) for track in found.observed if track.label == FALSE]
    assert frames == [k for k in range(8) for _ in range(2)]
    times = [track.t[0] for track in found.observed if track.label == FALSE]
    np.testing.assert_allclose(times, 0.4 * np.array(frames))


def test_anonymous_detections_are_those_seen_in_any_order_without_the_truth() -> None:
    rng = np.random.default_rng(5)
    found = detect(crowd(), ALL_FAULTS, position_std=0.1, head_kappa=3.0, rng=rng)
    table = found.anonymous(rng)
    assert list(table) == ["frame", "t", "x", "y", "head_deg"]
    assert len(table["x"]) == found.detections and (np.diff(table["frame"]) >= 0).all()
    kept = np.concatenate([track.position[is_observed(track)] for track in found.observed])
    rows = np.column_stack([table["x"], table["y"]])
    np.testing.assert_array_equal(rows[np.lexsort(rows.T)], kept[np.lexsort(kept.T)])
    # Ranks of the same people must not agree from frame to frame: a tracker could read identities off them.
    order = {tuple(place): track.track_id for track in found.observed for place in track.position}
    whose = np.array([order[tuple(place)] for place in rows])
    rises = [np.diff(whose[table["frame"] == k]) > 0 for k in np.unique(table["frame"])]
    assert abs(np.concatenate(rises).mean() - 0.5) < 0.05


def test_sampling_goes_straight_on_between_rows_and_the_shorter_way_round() -> None:
    t = np.array([1.0, 1.5, 3.0])
    walk = np.column_stack([2.0 * t, -t])
    body = np.radians([170.0, -170.0, 160.0])
    there = Track(3, [10, 15, 30], t, walk, body=body, label="one")
    late = Track(4, [12, 13], [1.2, 1.3], np.zeros((2, 2)))
    found = sampled(TrackSet((there, late)), 0.5)
    (track,) = found
    np.testing.assert_array_equal(track.frame, np.arange(5))
    np.testing.assert_allclose(track.t, 1.0 + 0.5 * np.arange(5))
    np.testing.assert_allclose(track.position, np.column_stack([2.0 * track.t, -track.t]))
    degrees = np.degrees(np.unwrap(track.body))
    np.testing.assert_allclose(degrees, [170.0, 190.0, 180.0, 170.0, 160.0])
    assert track.label == "one" and "1 track between them left out" in found.summary.notes[-1]


@pytest.mark.parametrize(
    "bad",
    [
        {"missed": 1.5},
        {"occluded_share": -0.1},
        {"occluded_seconds": float("nan")},
        {"clutter": -1.0},
        {"clutter_count": "some"},
        {"clutter": 1.5, "clutter_count": "fixed"},
    ],
)
def test_impossible_faults_are_refused(bad: dict) -> None:
    with pytest.raises(InputError):
        Detector(**bad)


@pytest.mark.parametrize("every", [0.0, -1.0, float("inf"), 1e-12])
def test_impossible_times_are_refused(every: float) -> None:
    with pytest.raises(InputError, match="every"):
        sampled(crowd(), every)


@pytest.mark.slow
def test_the_command_writes_detections_and_the_truth_that_judges_them(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    gt.write(crowd(25), "exact.csv")
    line = "add-noise exact.csv -o {} --truth-output truth.csv --every 0.4 --position-noise 0.1 --missed 0.1"
    line += " --occlude-share 0.5 --clutter 0.5 --seed 3"
    done = run(*line.format("known.csv").split(), program="graphtrack")
    assert done.returncode == 0 and "false" in done.stderr
    score = gt.score("known.csv", "truth.csv").together
    assert score.idr > 0.8 and score.idp > 0.95 and 0.8 < score.recall < 0.95
    done = run(*line.format("anonymous.csv").split(), "--anonymous", program="graphtrack")
    assert done.returncode == 0
    assert (tmp_path / "anonymous.csv").read_text().splitlines()[0] == "frame,t,x,y,head_deg"
    read = gt.read("anonymous.csv")
    assert any(note.startswith("associated ") for note in read.summary.notes)


@pytest.mark.parametrize(
    "name", ["anonymous.csv", "anonymous.csv.gz", "anonymous.parquet", "anonymous.ndjson"]
)
def test_every_table_holds_rows_without_identities(name, tmp_path) -> None:
    from graphtrack.io.options import ReadOptions
    from graphtrack.io.read_write import rows_of_file, write_table

    rng = np.random.default_rng(6)
    table = detect(crowd(5), ALL_FAULTS, rng=rng).anonymous(rng)
    write_table(table, tmp_path / name)
    rows = rows_of_file(tmp_path / name, None, ReadOptions())
    assert not rows.has_identity
    np.testing.assert_array_equal(rows.channels["position"], np.column_stack([table["x"], table["y"]]))
