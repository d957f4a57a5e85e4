"""Added noise, simulated classifiers and detectors have their statistics; windows are at turns."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import i0e, i1e
from walks import walk

from graphtrack import InputError, Track, TrackSet
from graphtrack.geometry.angles import class_centres, difference, mean_resultant_length, unit
from graphtrack.simulation.crowd import standers
from graphtrack.simulation.degrade import (
    OBSERVED,
    add_class_likelihoods,
    add_noise,
    confusion_matrix,
    occlude,
)
from graphtrack.simulation.detector import FALSE, Detector, detect, sampled
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES


def walker(
    course: np.ndarray, speed: np.ndarray | float = 1.2, fps: float = 10.0, track_id: int = 1
) -> Track:
    """A person with given courses (radians) and speeds, observed exactly."""
    step = np.broadcast_to(speed, course.shape)[:, None] * unit(course) / fps
    frame = np.arange(len(course))
    return Track(track_id, frame, frame / fps, np.cumsum(step, axis=0), body=course, head=course)


def corner(at: float, seconds: float = 12.0, degrees: float = 90.0, **more: object) -> Track:
    t = np.arange(0.0, seconds, 0.1)
    return walker(np.radians(degrees) * np.clip((t - at) / 0.6 + 0.5, 0.0, 1.0), **more)  # type: ignore[arg-type]


def test_noise_has_the_stated_statistics_and_the_truth_is_kept() -> None:
    exact = TrackSet(tuple(corner(5.0, track_id=i) for i in range(40)))
    noisy = add_noise(exact, position_std=0.2, body_kappa=1.2, head_kappa=5.0, rng=np.random.default_rng(1))
    error = np.concatenate([a.position - b.position for a, b in zip(noisy, exact, strict=True)])
    low, high = stats.chi2.ppf([1e-4, 1 - 1e-4], error.size)
    assert low < np.sum(error**2) / 0.2**2 < high
    assert abs(np.corrcoef(error.T)[0, 1]) < 4.0 / np.sqrt(len(error))
    for name, kappa in (("body", 1.2), ("head", 5.0)):
        pairs = zip(noisy, exact, strict=True)
        deviation = np.concatenate([getattr(a, name) - getattr(b, name) for a, b in pairs])
        mean = float(mean_resultant_length(kappa))
        spread = np.sqrt((1.0 - mean / kappa - mean**2) / deviation.size)
        assert abs(np.cos(deviation).mean() - mean) < 4.0 * spread
        assert abs(np.sin(deviation).mean()) < 4.0 * np.sqrt(mean / kappa / deviation.size)
    for after, before in zip(noisy, exact, strict=True):
        np.testing.assert_array_equal(after.true_position, before.position)
        np.testing.assert_array_equal(after.true_head, before.head)
        assert np.all(after.position_std == 0.2) and np.all(after.body_kappa == 1.2)


def test_a_known_truth_is_used_again_and_not_the_noisy_values() -> None:
    exact = TrackSet((corner(5.0),))
    rng = np.random.default_rng(2)
    once = add_noise(exact, position_std=5.0, head_kappa=0.1, rng=rng)
    again = add_noise(once, position_std=1e-6, head_kappa=1e8, rng=rng)
    np.testing.assert_allclose(again.by_id(1).position, exact.by_id(1).position, atol=1e-4)
    assert np.abs(difference(again.by_id(1).head, exact.by_id(1).head)).max() < 1e-2
    np.testing.assert_array_equal(again.by_id(1).true_position, exact.by_id(1).position)


def test_channels_without_noise_stay_and_missing_stays_missing() -> None:
    track = corner(5.0)
    position = track.position.copy()
    position[10:20] = np.nan
    head = track.head.copy()
    head[3] = np.nan
    track = replace(track, position=position, head=head, head_likelihood=np.full((len(track), 12), 1 / 12))
    track = replace(track, pixel=np.full((len(track), 2), 7.0))
    noisy = add_noise(
        TrackSet((track,)), position_std=0.1, head_kappa=3.0, rng=np.random.default_rng(3)
    ).by_id(1)
    assert np.array_equal(np.isnan(noisy.position), np.isnan(position))
    assert np.array_equal(np.isnan(noisy.head), np.isnan(head))
    np.testing.assert_array_equal(noisy.body, track.body)
    assert noisy.body_kappa is None
    assert noisy.head_likelihood is None, "the classes would win over the noisy angles"
    assert noisy.pixel is None, "the pixels would win over the noisy positions"


@pytest.mark.parametrize("at", [4.0, 6.3, 8.5])
def test_the_window_lies_around_the_turn_and_hides_what_it_says(at: float) -> None:
    track = replace(corner(at), body_kappa=np.full(120, 2.0), position_std=np.full(120, 0.1))
    hidden = occlude(TrackSet((track,)), 2.0)
    window = hidden.windows[1]
    assert window.sum() == 20
    assert abs(track.t[window].mean() - at) < 0.2
    after = hidden.tracks.by_id(1)
    for name in ("position", "position_std", "body", "body_kappa"):
        missing = np.isnan(getattr(after, name)).reshape(120, -1)
        assert np.array_equal(missing.all(axis=1), window) and np.array_equal(missing.any(axis=1), window)
    np.testing.assert_array_equal(after.head, track.head)
    np.testing.assert_array_equal(after.t, track.t)


def test_the_sharpest_of_two_turns_is_taken_even_across_pi() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    gentle, sharp = np.clip((t - 5.0) / 0.6, 0.0, 1.0), np.clip((t - 14.0) / 0.6, 0.0, 1.0)
    course = np.radians(160.0) + np.radians(30.0) * gentle + np.radians(70.0) * sharp
    window = occlude(TrackSet((walker(course),)), 1.0).windows[1]
    assert abs(t[window].mean() - 14.3) < 0.2


def test_a_rough_truth_does_not_hide_the_turn() -> None:
    rough = []
    for seed in range(20):
        track = corner(12.0, seconds=60.0, degrees=60.0, track_id=seed)
        noise = np.random.default_rng(seed).normal(0.0, 0.1, track.position.shape)
        rough.append(replace(track, position=track.position + noise))

    def share(**more: float) -> float:
        """The share of the windows that hold the turn."""
        windows = occlude(TrackSet(tuple(rough)), 3.0, **more).windows
        return float(np.mean([windows[t.track_id][np.argmin(np.abs(t.t - 12.0))] for t in rough]))

    assert share(turn_seconds=3.0) == 1.0
    assert share() < 0.8


def test_tracks_without_room_are_left_out_with_their_reason() -> None:
    short = corner(1.0, seconds=3.5, track_id=1)
    standing = walker(np.zeros(100), 0.0, track_id=2)
    lost = corner(5.0, track_id=3)
    lost = replace(
        lost, position=np.where(lost.t[:, None] < 5.0, lost.position, np.nan), true_position=lost.position
    )
    fine = corner(5.0, track_id=4)
    hidden = occlude(TrackSet((short, standing, lost, fine)), 2.0)
    assert [track.track_id for track in hidden.tracks] == [4]
    assert set(hidden.windows) == {4} and set(hidden.left_out) == {1, 2, 3}
    assert (
        "too short" in hidden.left_out[1]
        and "move" in hidden.left_out[2]
        and "position" in hidden.left_out[3]
    )


NAN, INFINITE = float("nan"), float("inf")
REFUSED = [
    (add_noise, {"position_std": -1.0}, "position_std"),
    (add_noise, {"body_kappa": -0.1}, "body_kappa"),
    (add_noise, {"head_kappa": INFINITE}, "head_kappa"),
    *((occlude, {"seconds": wrong}, "seconds") for wrong in (0.0, -1.0, NAN)),
    (occlude, {"seconds": 3.0, "turn_seconds": 0.0}, "turn_seconds"),
    (add_class_likelihoods, {"body": np.eye(12)}, r"shape \(12, 12\)"),
    (add_class_likelihoods, {"body": np.ones((8, 8))}, "rows that sum to 1"),
    *((sampled, {"every": wrong}, "every") for wrong in (0.0, -1.0, INFINITE, 1e-12)),
]


@pytest.mark.parametrize(("function", "wrong", "said"), REFUSED)
def test_what_is_impossible_is_refused(function: Any, wrong: dict[str, Any], said: str) -> None:
    random = {"rng": np.random.default_rng(0)} if function in (add_noise, add_class_likelihoods) else {}
    with pytest.raises(InputError, match=said):
        function(TrackSet((corner(5.0),)), **wrong, **random)


@pytest.mark.parametrize(
    ("classes", "shares", "said"),
    [
        (8, {"flipped": 0.8, "at_random": 0.3}, "at most 1 together"),
        (8, {"flipped": -0.1}, "at most 1 together"),
        (7, {}, "7 classes"),
    ],
)
def test_confusions_that_are_none_are_refused(classes: int, shares: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        confusion_matrix(classes, **shares)


def test_answers_come_as_often_as_the_confusion_says() -> None:
    rng = np.random.default_rng(0)
    track = walk(20_000, seed=3)
    (seen,) = add_class_likelihoods(track, rng=rng)
    for name, n in (("body", BODY_CLASSES), ("head", HEAD_CLASSES)):
        truth, likelihood = getattr(seen, f"true_{name}"), getattr(seen, f"{name}_likelihood")
        assert getattr(seen, name) is None
        true_class = np.argmax(np.cos(truth[:, None] - class_centres(n)), axis=1)
        expected = confusion_matrix(n)
        # Each answer has a column of its own, whose greatest entry is the answer itself.
        answer = likelihood.argmax(axis=1)
        for k in np.flatnonzero(np.bincount(true_class, minlength=n) > 1000):
            share = np.bincount(answer[true_class == k], minlength=n) / (true_class == k).sum()
            np.testing.assert_allclose(share, expected[k], atol=0.04)
        np.testing.assert_allclose(likelihood, expected[:, answer].T)


def test_errors_last_as_long_as_is_said_and_are_as_large_as_before() -> None:
    n, dt, lasting = 60_000, 0.1, 1.0
    zeros = np.zeros(n)
    track = Track(0, np.arange(n), dt * np.arange(n), np.zeros((n, 2)), body=zeros, head=zeros)
    rng = np.random.default_rng(3)
    found = add_noise(TrackSet((track,)), body_kappa=2.0, persistence=lasting, rng=rng).tracks[0]
    error = np.cos(found.body) - np.cos(found.body).mean()
    correlation = [(error[k:] * error[: n - k]).mean() / (error**2).mean() for k in (5, 10)]
    np.testing.assert_allclose(correlation, np.exp([-0.5, -1.0]), atol=0.05)
    assert np.cos(found.body).mean() == pytest.approx(i1e(2.0) / i0e(2.0), abs=0.02)
    classes = add_class_likelihoods(TrackSet((track,)), persistence=lasting, rng=rng).tracks[0]
    answer = classes.body_likelihood.argmax(axis=1)
    matrix = confusion_matrix(8)
    np.testing.assert_allclose(np.bincount(answer, minlength=8) / n, matrix[0], atol=0.02)
    right = (answer == 0) - matrix[0, 0]
    share = (right[10:] * right[:-10]).mean() / (right**2).mean()
    assert share == pytest.approx(np.exp(-1.0), abs=0.05)
    with pytest.raises(InputError, match="persistence"):
        add_noise(TrackSet((track,)), body_kappa=2.0, persistence=-1.0, rng=rng)


def test_people_who_stand_turn_on_the_spot_with_the_head_ahead() -> None:
    people = standers(np.random.default_rng(0), people=20, seconds=30.0)
    for track in people:
        assert np.linalg.norm(track.position - track.position.mean(axis=0), axis=1).max() < 0.3
    body, head = (np.concatenate([getattr(track, name) for track in people]) for name in ("body", "head"))
    assert np.abs(difference(head, body)).mean() < np.radians(25.0)
    turned = np.concatenate([np.abs(difference(track.body[1:], track.body[:-1])) for track in people])
    assert turned.sum() / (20 * 30.0) > np.radians(10.0)  # a second
    # A turn of the head tells of the body's a quarter of a second later.
    rates = [
        (difference(t.body[1:], t.body[:-1]), difference(t.head[1:], t.head[:-1])) for t in people.tracks
    ]

    def agreement(lag: int) -> float:
        return float(np.mean([(b[lag:] * h[: len(h) - lag]).mean() for b, h in rates]))

    assert agreement(3) > agreement(0)


def test_what_is_not_known_is_not_seen() -> None:
    track = walk(5)
    truth = np.array(track.true_body)
    truth[2] = np.nan
    (seen,) = add_class_likelihoods(replace(track, true_body=truth), rng=np.random.default_rng(0))
    assert np.isnan(seen.body_likelihood[2]).all()
    assert np.isfinite(seen.body_likelihood[[0, 1, 3, 4]]).all()


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


@pytest.mark.slow
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
