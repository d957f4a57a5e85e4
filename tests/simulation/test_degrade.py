"""Added noise has the declared statistics; withheld windows are at turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from graphtrack import InputError, Track, TrackSet
from graphtrack.geometry.angles import difference, mean_resultant_length, unit
from graphtrack.simulation.degrade import add_noise, occlude


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


@pytest.mark.parametrize("bad", [{"position_std": -1.0}, {"body_kappa": -0.1}, {"head_kappa": float("inf")}])
def test_impossible_noise_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(bad))):
        add_noise(TrackSet((corner(5.0),)), rng=np.random.default_rng(0), **bad)  # type: ignore[arg-type]


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
    with pytest.raises(InputError, match="turn_seconds"):
        occlude(TrackSet(tuple(rough)), 3.0, turn_seconds=0.0)


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
    for bad in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="seconds"):
            occlude(TrackSet((fine,)), bad)
