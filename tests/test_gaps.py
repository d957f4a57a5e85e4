"""Missing rows become frames without observations; estimates at other times are the model's own."""

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from command import ran
from hypothesis import example, given
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack.errors import InputError, InputWarning
from graphtrack.tracks.gaps import (
    at_times,
    filled,
    split_at_gaps,
    unfilled_gaps,
    usual_rate,
    with_times_at,
    without_absences,
)
from graphtrack.tracks.time import TIME_TOLERANCE


def walk(n=60, seed=0, track_id=1, dt=0.1):
    rng = np.random.default_rng(seed)
    t = dt * np.arange(n)
    position = np.column_stack([1.2 * t, np.sin(t)]) + rng.normal(0.0, 0.1, (n, 2))
    return gt.Track(track_id, frame=np.arange(n), t=t, position=position)


@given(st.floats(0.0, TIME_TOLERANCE), st.integers(1, 10))
@example(1e-320, 1)
def test_rows_at_one_time_tell_no_rate(apart, step):
    frame = step * np.arange(40)
    t = np.repeat(np.arange(20) / 10, 2)
    t[1::2] += apart
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert usual_rate([(frame, t)]) == pytest.approx(10.0 * step, rel=1e-3)
        assert usual_rate([(frame[:2], t[:2])]) == 0.0


def named(track, sensor):
    return replace(track, sensor=np.full(len(track), sensor))


def test_gaps_of_one_named_sensor_are_filled_as_without_its_name():
    there = np.isin(np.arange(60), [7, 8, 9, 30], invert=True)
    tracks = gt.TrackSet((walk()[there], walk(seed=1, track_id=2)))
    expected = filled(tracks)
    found = filled(tracks.map(lambda one: named(one, "gate")))
    assert found.n_frames == expected.n_frames == 120
    for one, other in zip(found, expected, strict=True):
        assert set(one.sensor.tolist()) == {"gate"}
        np.testing.assert_array_equal(one.t, other.t)
        np.testing.assert_array_equal(one.position, other.position)
    # Of several sensors each counts its own frames, and so may one.
    several = gt.TrackSet((named(tracks.tracks[0], "gate"), named(tracks.tracks[1], "door")))
    assert filled(several).n_frames == several.n_frames
    own = named(tracks.tracks[0], "gate")
    own = gt.TrackSet((replace(own, frame=own.frame[::-1].copy()),))
    assert filled(own).n_frames == own.n_frames


def test_detections_of_one_named_sensor_have_rows_for_missed_frames():
    whole = walk()
    table = {"frame": whole.frame, "t": whole.t, "x": whole.position[:, 0], "y": whole.position[:, 1]}
    table = {name: np.delete(values, [20, 21]) for name, values in table.items()}
    (expected,) = gt.associate(table)
    (found,) = gt.associate({**table, "sensor": np.full(58, "gate")})
    assert len(found) == len(expected) == 60 and found.observed.sum() == 58
    np.testing.assert_array_equal(found.t, expected.t)


@given(st.sets(st.integers(1, 58), max_size=20))
def test_rows_that_are_left_out_come_back_as_frames_without_observations(missing):
    whole = walk()
    there = np.array([k not in missing for k in range(60)])
    found = filled(gt.TrackSet((whole[there],))).tracks[0]
    np.testing.assert_array_equal(found.frame, whole.frame)
    np.testing.assert_allclose(found.t, whole.t, atol=1e-9)
    np.testing.assert_array_equal(np.isfinite(found.position[:, 0]), there)
    assert (found.observed is None) == (not missing)
    if missing:
        np.testing.assert_array_equal(found.observed, there)
    far = gt.Track(1, frame=[0, 1, 2, 36_000], t=[0.0, 0.1, 0.2, 3600.0], position=np.zeros((4, 2)))
    tracks = gt.TrackSet((far,))  # beyond the longest gap
    assert filled(tracks).n_frames == 4 and unfilled_gaps(tracks) == 1


@given(st.sampled_from([7.0, 12.5, 25.0, 29.97, 30.0]), st.sampled_from([2, 3, 6]), st.integers(0, 2**32 - 1))
def test_a_frame_has_one_time_for_everybody(rate, digits, seed):
    rng = np.random.default_rng(seed)
    frame = np.unique(rng.integers(0, 400, 300))
    t = 36_000.0 * (seed % 2) + np.round(frame / rate, digits)
    rows = [np.sort(rng.choice(len(frame), 120, replace=False)) for _ in range(4)]
    tracks = gt.TrackSet(
        tuple(gt.Track(k, frame[at], t[at], np.zeros((len(at), 2))) for k, at in enumerate(rows))
    )
    for found in (filled(tracks), at_times(*with_resampled(tracks, rate))):
        assert found.n_frames > tracks.n_frames
        every = np.concatenate([one.frame for one in found])
        times = np.concatenate([one.t for one in found])
        assert len(np.unique(times)) == len(np.unique(every))
        assert (np.abs(times - np.round(times, 9)) < 1e-15 * np.maximum(times, 1.0)).all()
    for one, as_read in zip(filled(tracks), tracks, strict=True):
        np.testing.assert_array_equal(one.t[one.observed == 1], as_read.t)
        assert (np.diff(one.t) > 0).all()


def with_resampled(tracks, hz):
    return with_times_at(tracks, hz)[0], hz, min(one.t[0] for one in tracks)


def test_rows_of_several_sensors_at_one_time_are_one_row_of_another_rate():
    """In any order of their names: times may differ by less than doubles and files resolve."""
    t = np.round(np.arange(20) / 10.0, 1).repeat(2) + np.tile([0.0, 4e-6], 20)
    both = gt.Track(1, np.arange(40), t, np.column_stack([t, t]), sensor=np.array(["west", "east"] * 20))
    (found,) = at_times(*with_resampled(gt.TrackSet((both,)), 10.0))
    np.testing.assert_array_equal(found.frame, np.arange(20))
    np.testing.assert_allclose(found.position[:, 0], found.t, atol=1e-5)


def test_people_with_times_of_their_own_keep_them():
    """Frames of one number are at several times: those between are as without the other person."""
    own = gt.TrackSet((walk()[np.delete(np.arange(60), [5, 6, 30])],))
    other = walk(track_id=2)
    both = filled(gt.TrackSet((*own, replace(other, t=other.t + 0.05))))
    np.testing.assert_array_equal(both.tracks[0].t, filled(own).tracks[0].t)


def test_filling_changes_nothing_elsewhere():
    """The model is linear."""
    whole = walk()
    there = np.delete(np.arange(60), slice(20, 31))
    by_filling = gt.smooth(filled(gt.TrackSet((whole[there],))), "position").tracks[0]
    without = gt.smooth(whole[there], "position")
    np.testing.assert_allclose(by_filling.position[there], without.position, atol=1e-8)


@pytest.mark.parametrize("hz", [3.0, 10.0, 20.0, 25.0])
def test_estimates_at_another_rate_are_those_of_a_model_without_these_frames(hz):
    tracks = gt.TrackSet((walk(), walk(50, 1, 2)))
    found = at_times(gt.smooth(with_times_at(tracks, hz)[0], "position"), hz, 0.0)
    for track, one in zip(tracks, found, strict=True):
        np.testing.assert_allclose(one.t, one.frame / hz, atol=1e-6)
        assert one.t[0] == 0.0 and track.t[-1] - one.t[-1] < 1.0 / hz
        plain = gt.smooth(track, "position")
        common = [(j, k) for j, t in enumerate(one.t) for k in np.flatnonzero(np.abs(track.t - t) < 1e-6)]
        assert len(common) >= 5
        for j, k in common:
            np.testing.assert_allclose(one.position[j], plain.position[k], atol=1e-8)
    for wrong in (0.0, -1.0, float("nan"), float("inf"), 1e12):
        with pytest.raises(InputError, match="Hz"):
            with_times_at(tracks, wrong)


def test_tracks_between_the_times_of_another_rate_are_left_out_with_a_note():
    short = walk()[3:4]
    assert short.t[0] == pytest.approx(0.3)
    tracks = gt.TrackSet((short, walk(50, 1, 2)))
    found, notes = with_times_at(tracks, 2.5)
    assert [one.track_id for one in found] == [2] and notes == (
        "1 track between the times of 2.5 Hz left out",
    )
    assert [one.track_id for one in gt.smooth(tracks, "position", resample=2.5)] == [2]


def test_the_command_fills_and_resamples(cwd):
    there = np.ones(60, bool)
    there[20:31] = False
    gt.write(gt.TrackSet((walk()[there], walk(track_id=2))), "tracks.csv")
    rows = {}
    for name, *options in (("filled",), ("left", "--no-fill"), ("fast", "--resample", "20")):
        ran(
            "smooth", "tracks.csv", "--model", "position", "-o", f"{name}.csv", *options, program="graphtrack"
        )
        rows[name] = gt.read(f"{name}.csv")
    assert [len(track) for track in rows["filled"]] == [60, 60]
    assert [len(track) for track in rows["left"]] == [49, 60]
    assert [len(track) for track in rows["fast"]] == [119, 119]
    np.testing.assert_array_equal(rows["filled"].by_id(1).observed, there)


def test_options_of_reading_go_with_paths_and_tables(tmp_path):
    gt.write(gt.TrackSet((walk(),)), tmp_path / "a.csv")
    table = gt.read(tmp_path / "a.csv").to_table().drop(columns="t")
    table.to_csv(tmp_path / "b.csv", index=False)
    for source in (tmp_path / "b.csv", [tmp_path / "b.csv"], table):
        np.testing.assert_allclose(gt.smooth(source, "position", fps=5).by_id(1).t, 0.2 * np.arange(60))
        np.testing.assert_allclose(gt.track_online(source, "position", fps=5).by_id(1).t, 0.2 * np.arange(60))
    for wrong, options in ((walk(), {"fps": 5}), (tmp_path / "b.csv", {"fpz": 5})):
        for call in (gt.smooth, gt.track_online):
            with pytest.raises(InputError, match="fp"):
                call(wrong, "position", **options)


def test_an_id_that_comes_back_is_another_track():
    there = np.abs(walk(600).t - 30.0) > 15.0
    absent = walk(600)[there]
    jumped = walk(100, track_id=7)
    far = jumped.position + np.where(jumped.t[:, None] > 4.0, (60.0, 0.0), 0.0)
    jumped = replace(jumped, position=far)[np.abs(jumped.t - 5.0) >= 1.0]
    off = walk(100, track_id=9)
    off = replace(off, position=off.position + np.where(np.arange(100)[:, None] == 40, (30.0, 0.0), 0.0))
    people = gt.TrackSet((absent, jumped, off))
    found, notes = split_at_gaps(people, 20.0)
    assert [(one.track_id, len(one)) for one in found] == [
        (1, (absent.t < 30.0).sum()),
        (10, (absent.t > 30.0).sum()),
        (7, (jumped.t < 5.0).sum()),
        (11, (jumped.t > 5.0).sum()),
        (9, 100),
    ]
    assert len(notes) == 2 and "id 1 absent" in notes[0] and "id 7" in notes[1]
    assert split_at_gaps(gt.TrackSet((absent, off)), 60.0)[1] == ()
    smoothed = gt.smooth(people, "position", fill=True, split_gap=20.0)
    assert max(np.diff(one.t).max() for one in smoothed) < 0.15 and len(smoothed) == 5
    with pytest.raises(InputError, match="split_gap"):
        split_at_gaps(people, 0.0)


@pytest.mark.slow
def test_people_who_were_missed_can_be_left_out(cwd):
    rng = np.random.default_rng(0)
    detected = gt.TrackSet((walk(), walk(seed=1, track_id=2))).to_table()
    detected.loc[detected["track_id"] == 2, "y"] += 5.0
    detected = detected[["frame", "t", "x", "y"]]
    detected = detected[rng.random(len(detected)) < 0.8].sort_values("frame", kind="stable")
    detected.to_csv("found.csv", index=False)
    rows = {}
    for name, *options in (("filled",), ("left", "--no-fill")):
        ran("smooth", "found.csv", "--model", "position", "-o", f"{name}.csv", *options, program="graphtrack")
        rows[name] = gt.read(f"{name}.csv").n_frames
    assert rows["left"] <= len(detected) < rows["filled"]
    assert gt.smooth("found.csv", "position", fill=False).n_frames == rows["left"]
    assert gt.smooth("found.csv", "position").n_frames == rows["filled"]


def test_people_whom_the_file_names_come_back_and_absences_are_left_out(cwd):
    people = walk(1200).position  # 2 minutes at 10 Hz
    rows = [
        {"id": name, "t": 0.1 * k, "x": x + place, "y": y}
        for place, name in enumerate(("anna", "7"))
        for k, (x, y) in enumerate(people.tolist())
    ]
    table = pd.DataFrame(rows)
    away = (table.id == "anna") & (table.t > 20.0) & (table.t < 95.0)
    cells = table.copy()
    cells.loc[away, ["x", "y"]] = np.nan
    of_cells, of_rows = (gt.read(one) for one in (cells, table[~away]))
    found, notes = without_absences(of_cells)
    assert [len(one) for one in found] == [len(one) for one in of_rows]
    assert len(notes) == 1 and "749 rows left out, in which anna" in notes[0]
    with pytest.warns(InputWarning, match="anna had no observation for more than 60 s"):
        smoothed = gt.smooth(of_cells, "position")
    assert [len(one) for one in smoothed] == [len(one) for one in of_rows]
    # Numbers may be used again; names are not, unless it is asked for.
    assert split_at_gaps(of_rows)[1] == () and len(split_at_gaps(of_rows, 60.0)[0]) == 3
    numbered = gt.read(table[~away].assign(id=[4 if one == "anna" else 7 for one in table[~away].id]))
    assert len(split_at_gaps(numbered)[0]) == 3
    short = cells.assign(t=0.5 * cells.t)
    assert without_absences(gt.read(short))[1] == ()
