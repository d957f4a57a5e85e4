"""Errors of states: plain arithmetic, calibration, and rows compared with the people that they match."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import ran
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2
from typer.testing import CliRunner

import graphtrack as gt
from graphtrack import Track
from graphtrack.cli.commands import program
from graphtrack.tracks.track import TrackSet

SPREAD = np.array([0.1, 0.2, 0.3, 0.3, np.radians(10.0), np.radians(20.0)])


def scene(honest: float = 1.0, n: int = 400, people: int = 3) -> tuple[TrackSet, TrackSet]:
    """Estimates whose errors have ``honest`` times the stated standard deviations, and the truth."""
    rng = np.random.default_rng(1)
    estimates, truth = [], []
    for k in range(people):
        t = 0.1 * np.arange(n)
        position = np.column_stack([t, np.full(n, 2.0 * k)])
        body, head = np.full(n, 3.1), np.zeros(n)
        error = honest * SPREAD * rng.standard_normal((n, 6))
        covariance = np.tile(np.diag(SPREAD**2), (n, 1, 1))
        found = Track(
            k, np.arange(n), t, position + error[:, :2], body=body + error[:, 4], head=head + error[:, 5]
        )
        velocity = np.array([1.0, 0.0]) + error[:, 2:4]
        estimates.append(replace(found, velocity=velocity, covariance=covariance))
        truth.append(Track(k, np.arange(n), t, position, body=body, head=head))
    return TrackSet(tuple(estimates)), TrackSet(tuple(truth))


def row(score: gt.StateScore, quantity: str) -> dict[str, float]:
    return next(one for one in score.rows if one["quantity"] == quantity)


def test_errors_are_those_of_plain_arithmetic() -> None:
    estimates, truth = scene()
    found = gt.score_states(estimates, truth)
    assert [one["quantity"] for one in found.rows] == ["position", "velocity", "body", "head"]
    distances = np.concatenate(
        [np.linalg.norm(a.position - b.position, axis=1) for a, b in zip(estimates, truth, strict=True)]
    )
    position = row(found, "position")
    assert position["rmse"] == pytest.approx(np.sqrt(np.mean(distances**2)))
    assert position["mae"] == pytest.approx(distances.mean())
    assert position["median"] == pytest.approx(np.median(distances))
    assert position["frames"] == 1200 and position["tracks"] == 3
    degrees = np.degrees(
        np.concatenate(
            [np.angle(np.exp(1j * (a.body - b.body))) for a, b in zip(estimates, truth, strict=True)]
        )
    )
    assert row(found, "body")["rmse"] == pytest.approx(np.sqrt(np.mean(degrees**2)))


@pytest.mark.parametrize("honest", [1.0, 2.0])
def test_coverage_and_nees_are_those_of_the_chi_squared_distribution(honest: float) -> None:
    found = gt.score_states(*scene(honest))
    for quantity, degrees in (("position", 2), ("velocity", 2), ("body", 1), ("head", 1)):
        expected = chi2.cdf(chi2.ppf(0.95, degrees) / honest**2, degrees)
        assert row(found, quantity)["coverage_95"] == pytest.approx(expected, abs=0.03)
        assert row(found, quantity)["nees"] == pytest.approx(honest**2, rel=0.1)
        low, high = chi2.ppf([0.025, 0.975], 3 * degrees) / (3 * degrees)
        assert row(found, quantity)["nees_low"] == pytest.approx(low)
        assert row(found, quantity)["nees_high"] == pytest.approx(high)


def test_frames_are_matched_by_time() -> None:
    estimates, truth = scene()
    later = truth.map(lambda track: track[100:])
    assert row(gt.score_states(estimates, later), "head")["frames"] == 900
    between = truth.map(lambda track: replace(track, t=track.t + 0.05))
    assert gt.score_states(estimates, between).rows == ()
    two = TrackSet(tuple(truth)[:2])
    assert row(gt.score_states(estimates, two), "position")["tracks"] == 2


@settings(max_examples=25)
@given(st.permutations(range(3)), st.integers(0, 5))
def test_identities_of_the_estimates_do_not_matter(numbers: list[int], first: int) -> None:
    """An associated track may have the number of any person: its errors are those of its own."""
    estimates, truth = scene(n=60)
    expected = gt.score_states(estimates, truth)
    found = estimates.with_tracks(
        replace(track, track_id=first + number) for track, number in zip(estimates, numbers, strict=True)
    )
    assert gt.score_states(found, truth).rows == expected.rows


@pytest.mark.parametrize("switch", [10, 30, 50])
def test_a_track_that_switches_has_the_errors_of_each_of_its_people(switch: int) -> None:
    estimates, truth = scene(n=60)
    first, second, third = estimates

    def joined(a: Track, b: Track) -> Track:
        late = np.arange(60) >= switch
        return replace(
            a,
            position=np.where(late[:, None], b.position, a.position),
            velocity=np.where(late[:, None], b.velocity, a.velocity),
            body=np.where(late, b.body, a.body),
            head=np.where(late, b.head, a.head),
        )

    switched = TrackSet((joined(first, second), joined(second, first), third))
    for one, other in zip(
        gt.score_states(switched, truth).rows, gt.score_states(estimates, truth).rows, strict=True
    ):
        assert one["rmse"] == pytest.approx(other["rmse"])


def test_large_errors_of_known_people_are_not_left_out() -> None:
    """Rows beyond the distance of a match are compared by track_id where both have the same identities."""
    estimates, truth = scene(n=60)
    lost = estimates[0].position.copy()
    lost[40:50] += 5.0
    known = estimates.with_tracks([replace(estimates[0], position=lost), *estimates[1:]])
    found = gt.score_states(known, truth)
    assert row(found, "position")["frames"] == 180
    assert row(found, "position")["rmse"] == pytest.approx(5.0 * np.sqrt(2.0 * 10.0 / 180.0), rel=0.02)
    assert found.notes == ("10 rows not within 1 m of anybody: compared by track_id",)
    other = gt.score_states(known.map(lambda track: replace(track, track_id=track.track_id + 1)), truth)
    assert row(other, "position")["frames"] == 170 and row(other, "position")["rmse"] < 0.3
    assert other.notes == ("10 rows not within 1 m of anybody at the same time: not compared",)


def test_each_person_may_have_times_of_their_own() -> None:
    estimates, truth = scene(n=60)

    def shifted(tracks: TrackSet) -> TrackSet:
        return tracks.with_tracks(replace(track, t=track.t + 0.03 * k) for k, track in enumerate(tracks))

    expected = row(gt.score_states(estimates, truth), "position")
    assert row(gt.score_states(shifted(estimates), shifted(truth)), "position") == expected
    renamed = shifted(estimates).map(lambda track: replace(track, track_id=track.track_id + 1))
    assert row(gt.score_states(renamed, shifted(truth)), "position") == expected


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1.0, 1.7e9]))
def test_stamps_of_a_frame_may_differ_from_person_to_person(seed: int, origin: float) -> None:
    """Of estimates under other numbers, all rows are compared, although no two stamps are equal."""
    rng = np.random.default_rng(seed)
    estimates, truth = scene(n=60)

    def jittered(tracks: TrackSet, first: int) -> TrackSet:
        return TrackSet(
            tuple(
                replace(one, track_id=first - k, t=origin + one.t + rng.uniform(0.0, 0.004, len(one)))
                for k, one in enumerate(tracks)
            )
        )

    found = gt.score_states(jittered(estimates, 12), jittered(truth, 3))
    assert row(found, "position")["frames"] == 180 and row(found, "position")["tracks"] == 3
    assert not any("not within" in note for note in found.notes)


def test_what_is_not_known_is_named() -> None:
    estimates, truth = scene()
    bare = estimates.map(lambda track: replace(track, covariance=None, velocity=None, head=None))
    found = gt.score_states(bare, truth)
    assert [one["quantity"] for one in found.rows] == ["position", "body"]
    assert row(found, "body")["coverage_95"] is None
    assert any(note.startswith("head: not in both") for note in found.notes)
    assert any(note.startswith("position: no uncertainty in the estimates") for note in found.notes)


def test_the_command_prints_and_writes_them(tmp_path: Path) -> None:
    estimates, truth = scene(n=60)
    gt.write(estimates, tmp_path / "smoothed.csv")
    gt.write(truth, tmp_path / "truth.csv")
    out = tmp_path / "score.json"
    arguments = ["score", str(tmp_path / "smoothed.csv"), "--truth", str(tmp_path / "truth.csv")]
    result = CliRunner().invoke(program(), [*arguments, "--json", str(out)])
    assert result.exit_code == 0, result.output
    assert "95 % covers" in result.output and "NEES" in result.output
    states = json.loads(out.read_text())["states"]
    expected = gt.score_states(estimates, truth).to_dict()["rows"]
    for one, other in zip(states["rows"], expected, strict=True):
        assert one["rmse"] == pytest.approx(other["rmse"], rel=1e-3)


RATES = st.sampled_from([1.0, 2.5, 10.0, 25.0, 100.0])


def people(hz, noise=0.0, offset=0.0, jitter=0.0, seed=0):
    """Three people who walk apart, each with times of their own."""
    rng = np.random.default_rng(seed)
    tracks = []
    for k in range(3):
        t = np.arange(0.0, 20.0, 1.0 / hz) + offset * k
        t = t + rng.uniform(-jitter, jitter, len(t))
        position = np.column_stack([1.2 * t, np.full(len(t), 2.0 * k)])
        position = position + rng.normal(0.0, noise, position.shape)
        tracks.append(gt.Track(k + 1, frame=np.arange(len(t)), t=t, position=position))
    return gt.TrackSet(tuple(tracks))


@pytest.mark.slow
@given(RATES, RATES, st.integers(0, 99))
def test_rates_change_no_identity(hz, of_truth, seed):
    found = gt.score(people(hz, 0.03, seed=seed), people(of_truth), metres=0.5).together
    assert found.idf1 > 0.97 and found.switches == 0
    if min(hz, of_truth) < max(hz, of_truth):
        assert abs(found.frames - 20.0 * min(hz, of_truth)) <= 1


@pytest.mark.slow
@given(st.floats(0.0, 0.03), st.floats(0.0, 0.004))
def test_each_sensor_may_have_a_clock_of_its_own(offset, jitter):
    found = gt.score(people(10, 0.03, offset, jitter), people(10, 0.0, offset, jitter), metres=0.5).together
    assert found.idf1 > 0.98 and found.switches == 0


def test_frames_without_estimates_are_missed():
    estimates = people(10, 0.03)
    part = gt.TrackSet(tuple(one[(one.t < 5.0) | (one.t > 15.0)] for one in estimates))
    found = gt.score(part, people(100), metres=0.5).together
    assert found.recall == pytest.approx(0.5, abs=0.02) and found.precision == 1.0


def test_tracks_between_all_times_that_are_compared_are_left_out():
    short = people(100)[0][3:4]
    estimates = people(100, 0.03)
    estimates = estimates.with_tracks([*estimates, replace(short, track_id=99)])
    found = gt.score(estimates, people(10), metres=0.5).together
    assert found.idf1 > 0.98 and found.precision == 1.0


def test_the_command_says_that_it_compares_by_time(cwd):
    gt.write(people(10, 0.03), "found.csv")
    gt.write(people(100), "truth.csv")
    done = ran("score", "found.csv", "--truth", "truth.csv", program="graphtrack")
    assert "compared by time" in done.stderr and "10 Hz and 100 Hz" in done.stderr
