"""Arguments of the public functions: each form works, or one error names the expected value."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import graphtrack as gt
from graphtrack.baselines.hungarian import HungarianParameters
from graphtrack.baselines.intentional import IntentionalParameters
from graphtrack.baselines.particle_filter import ParticleOptions
from graphtrack.learning import fit
from graphtrack.simulation.corpus import CorpusParameters
from graphtrack.simulation.detector import Detector
from graphtrack.tracks.track import Track, TrackSet
from perception.synthetic.head_clips import HeadClipParameters

PEOPLE = gt.simulate("separate", n_tracks=3, n_steps=12, rng=np.random.default_rng(0))
PERSON = PEOPLE.by_id(1)
TABLE = PEOPLE.to_table()
COLUMNS = {name: TABLE[name].tolist() for name in TABLE}


def refused(call, *arguments, **options) -> str:
    with pytest.raises(gt.InputError) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("given") / "tracks.csv"
    gt.write(PEOPLE, path)
    return path


FORMS = {
    "a path": lambda path: path,
    "a path as text": str,
    "paths": lambda path: [path],
    "a table": lambda path: TABLE,
    "columns": lambda path: COLUMNS,
    "tracks": lambda path: list(PEOPLE),
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_whatever_holds_tracks_is_taken_everywhere(form, path, tmp_path) -> None:
    given = form(path)
    for function in (gt.smooth, gt.track_online):
        for one, other in zip(function(given, "position"), function(PEOPLE, "position"), strict=True):
            np.testing.assert_allclose(one.position, other.position, atol=1e-9)
    assert [s.track.track_id for s in gt.solve(given, "position")] == [0, 1, 2]
    assert gt.compare(given, ["kf"], model="position").rows
    assert gt.score(given, PEOPLE).together == gt.score(PEOPLE, given).together
    assert len(gt.add_noise(given, position_std=0.1, rng=np.random.default_rng(0))) == 3
    for entry in OTHERS:
        entry(given, tmp_path)


OTHERS = [
    lambda given, folder: gt.groups(given),
    lambda given, folder: gt.forecast(given, horizon=0.4),
    lambda given, folder: gt.associate(given),
    lambda given, folder: gt.write_report(folder / "report.html", given),
    lambda given, folder: gt.view(given, save=folder / "view.rrd"),
]


def test_a_track_gives_a_track_and_a_file_is_read_once(path, tmp_path) -> None:
    for function in (gt.smooth, gt.track_online):
        assert type(function(PERSON, "position")) is Track
        assert type(function(TrackSet((PERSON,)), "position")) is TrackSet
    gt.write(PERSON, tmp_path / "one.csv")
    assert len(gt.read(tmp_path / "one.csv")) == 1
    link = tmp_path / "link.csv"
    link.symlink_to(path)
    for second in (path, str(path), link):
        assert "again, expected each file once" in refused(gt.read, [path, second])


ENTRIES = [gt.smooth, gt.solve, gt.track_online, gt.compare, fit]


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.__name__)
def test_positions_alone_are_told_how_to_become_a_track(entry) -> None:
    for positions in (np.zeros((4, 2)), [[0.0, 1.0]] * 4):
        said = refused(entry, positions)
        assert "of shape (4, 2)" in said and "Track(0, frame=np.arange(4), t=np.arange(4) / fps" in said
    for nonsense in (np.zeros((4, 3)), 7, None, [], [1, [2]], b"tracks.csv"):
        assert "expected a TrackSet, a Track, a table or the path of a file" in refused(entry, nonsense)
    assert "no/such.csv" in refused(entry, "no/such.csv")
    for other in OTHERS:
        assert "no such file" in refused(other, "missing.csv", Path())
        for wrong in (None, 3, [1, 2]):
            refused(other, wrong, Path())


def test_columns_that_are_none_are_named() -> None:
    assert "x (3)" in refused(TrackSet.from_table, COLUMNS | {"x": [1.0, 2.0, 3.0]})
    assert "column x: found an array of shape (36, 2)" in refused(
        TrackSet.from_table, COLUMNS | {"x": np.zeros((36, 2))}
    )
    assert "column y" in refused(TrackSet.from_table, COLUMNS | {"y": 0.0})
    assert "found a list, expected a DataFrame, or a dict of columns" in refused(TrackSet.from_table, [1])


@pytest.mark.parametrize("zone", [None, "Europe/Zurich"])
def test_dates_and_times_become_seconds_and_come_back(zone) -> None:
    begin = pd.Timestamp("2024-02-29 12:00:00.25", tz=zone)
    seconds = np.tile(np.arange(12) / 10, 3)
    dates, durations = begin + pd.to_timedelta(seconds, unit="s"), pd.to_timedelta(seconds, unit="s")
    found = TrackSet.from_table(TABLE.assign(t=dates))
    midnight = 12 * 3600.0 + 0.25 - (3600.0 if zone else 0.0)
    np.testing.assert_allclose(found.by_id(2).t, midnight + np.arange(12) / 10, atol=1e-6)
    assert list(found.to_table(as_read=True)["t"]) == list(dates)
    found = TrackSet.from_table(TABLE.assign(t=durations))
    np.testing.assert_allclose(found.by_id(2).t, np.arange(12) / 10, atol=1e-6)
    assert any("durations are written as seconds" in note for note in found.summary.notes)
    assert "column x: found dates or times" in refused(
        TrackSet.from_table, TABLE.assign(x=pd.to_timedelta(seconds, unit="s"))
    )
    gap = TABLE.assign(t=begin + pd.to_timedelta(np.where(seconds == 0.5, np.nan, seconds), unit="s"))
    assert "column t: found an empty cell" in refused(TrackSet.from_table, gap)


TOO_LARGE = {
    "position": 2e8,
    "position_std": 2e8,
    "pixel": -2e6,
    "body": 1e5,
    "body_kappa": 1e10,
    "head_likelihood": 1e13,
    "true_position": -1e300,
    "velocity": np.inf,
    "covariance": np.inf,
}
SMALL = {"position_std": 0.0, "body_kappa": -1.0, "head_likelihood": -0.1}


@pytest.mark.parametrize(("name", "value"), [*TOO_LARGE.items(), *SMALL.items()])
def test_a_number_out_of_bounds_is_named_with_its_frame(name: str, value: float) -> None:
    tails = {"position": (2,), "pixel": (2,), "true_position": (2,), "velocity": (2,), "covariance": (6, 6)}
    values = np.ones((12, *tails.get(name, (12,) if "likelihood" in name else ())))
    values[0] = np.nan
    assert getattr(replace(PERSON, **{name: values}), name) is not None
    values[5] = value
    said = refused(replace, PERSON, **{name: values})
    assert f"{name} = {value:g} in frame 5 of track 1" in said and "expected a number " in said


def test_arrays_of_another_shape_are_told_the_right_one() -> None:
    said = refused(replace, PERSON, position=np.zeros((12, 3)))
    assert "position of shape (12, 3)" in said and "shape (12, 2): x and y in metres" in said
    assert "body" in refused(replace, PERSON, body=["north"] * 12)
    assert "track_id 1.5" in refused(replace, PERSON, track_id=1.5)
    for unit in ("timedelta64[ns]", "datetime64[s]"):
        assert "expected seconds" in refused(replace, PERSON, t=np.arange(12).astype(unit))
    assert "frame 3000000000" in refused(replace, PERSON, frame=np.arange(12) + 3_000_000_000 - 11)


SEEN = {
    "position": [(1e300, 3.0), (1.0, 2.0, 3.0), (1.0,), 4.0, "ab", (None, 1.0), (np.nan, 0.0)],
    "pixel": [(2e6, 0.0)],
    "position_std": [0.0, 1e9, (1.0, 1.0), "x"],
    "head": [1e5, np.inf, [0.1]],
    "head_kappa": [-1.0, 1e10],
    "head_likelihood": [(1.0,) * 8, (-1.0,) * 12, (1e13,) * 12],
    "t": [1e12, np.nan, None, "now"],
    "frame": ["a", 1.5, True, None],
    "inputs": [5, "a"],
}


@pytest.mark.parametrize("engine", ["chain", "fixed-lag", "isam2"])
def test_an_observation_that_no_engine_could_use_names_its_channel_and_changes_nothing(engine) -> None:
    smoother, plain = (gt.OnlineSmoother("separate", engine=engine) for _ in range(2))
    seen = [{"t": 0.1 * k, "position": (0.1 * k, 0.0), "head": 0.2} for k in range(6)]
    for k, good in enumerate(seen):
        for name, values in SEEN.items() if k == 3 else ():
            for value in values:
                said = refused(smoother.update, gt.Observation(**good | {name: value}))
                assert said.startswith(f"found {name} = ") and "number" in said
        found, expected = (one.update(gt.Observation(**good)) for one in (smoother, plain))
        np.testing.assert_array_equal(found.covariance, expected.covariance)


def test_a_detection_that_no_tracker_could_use_names_its_channel_and_changes_nothing() -> None:
    tracker = gt.OnlineTracker("position")
    good = {"t": 0.1, "position": (0.1, 0.0), "head": 0.2}
    tracker.update(0.0, [(0.0, 0.0)])
    before = json.dumps(tracker.state())
    for name, values in SEEN.items():
        for value in values:
            said = refused(tracker.update, 0.1, [gt.Observation(**good | {name: value})])
            assert said.startswith(f"found {name} = ") and "number" in said
    for wrong in ("x", None, [0.1]):
        assert refused(tracker.update, wrong, []).startswith("found t = ")
    for sensor in (5, "a\nb"):
        assert refused(tracker.update, 0.1, [(0.0, 0.0)], sensor).startswith("found sensor = ")
    assert json.dumps(tracker.state()) == before
    tracker.update(0.1, [gt.Observation(**good, frame=np.int64(3))])


def test_what_cannot_be_read_or_written_is_refused(path, tmp_path) -> None:
    for wrong in (None, 3, [path, 3], {path}):
        assert "a path" in refused(gt.read, wrong)
    for wrong in (None, TABLE, [PERSON, PERSON]):
        assert "TrackSet" in refused(gt.write, wrong, tmp_path / "out.csv")
    with (tmp_path / "open.txt").open("w") as stream:
        assert "path of a file" in refused(gt.write, PEOPLE, stream)
    assert "found a int among tracks" in refused(TrackSet, (1, 2))
    assert not (tmp_path / "out.csv").exists()


def test_masked_values_are_missing() -> None:
    position = np.array(PERSON.position)
    position[4] = 1e3
    masked = np.ma.masked_greater(position, 100.0)
    position[4] = np.nan
    np.testing.assert_array_equal(replace(PERSON, position=masked).position, position)
    whole = np.ma.masked_equal(np.arange(12), 3)
    assert np.flatnonzero(np.isnan(replace(PERSON, head=whole).head)).tolist() == [3]


def test_settings_that_are_no_numbers_are_refused() -> None:
    for wrong in ("10", True, np.nan):
        assert "Hz to resample to" in refused(gt.smooth, PERSON, model="position", resample=wrong)
        assert "lag" in refused(gt.track_online, PERSON, model="position", lag=wrong)
        assert "fps" in refused(gt.simulate, fps=wrong)
        assert "n_tracks" in refused(gt.simulate, n_tracks=wrong)


OUT_OF_RANGE = [
    (IntentionalParameters, {"variant": "other"}),
    (IntentionalParameters, {"displacement": "none"}),
    (IntentionalParameters, {"displacement_steps": 1}),
    (IntentionalParameters, {"strength_steps": 0}),
    (IntentionalParameters, {"bin_difference": "straight"}),
    (IntentionalParameters, {"process_variance": 0.0}),
    (IntentionalParameters, {"observation_variance": np.nan}),
    (IntentionalParameters, {"weight_rate": np.inf}),
    (HungarianParameters, {"gate": 0.0}),
    (HungarianParameters, {"hits": 3, "frames": 2}),
    (HungarianParameters, {"longest_gap": -1.0}),
    (HungarianParameters, {"position_std": np.nan}),
    (CorpusParameters, {"tracks": 0}),
    (CorpusParameters, {"steps": 100}),
    (CorpusParameters, {"speed": 0.0}),
    (CorpusParameters, {"head_std": -1.0}),
    (CorpusParameters, {"turn_steps": (3, 3)}),
    (CorpusParameters, {"turn_steps": (0, 1, 1, 1, 1, 1)}),
    (Detector, {"missed": 1.5}),
    (Detector, {"occluded_share": -0.1}),
    (Detector, {"occluded_seconds": np.nan}),
    (Detector, {"clutter": -1.0}),
    (Detector, {"clutter_count": "some"}),
    (Detector, {"clutter": 1.5, "clutter_count": "fixed"}),
    (HeadClipParameters, {"frames": 0}),
    (HeadClipParameters, {"clutter": -1.0}),
    (HeadClipParameters, {"occlusion": (0, 5)}),
    (HeadClipParameters, {"occlusion": (90, 25)}),
    (ParticleOptions, {"particles": 0}),
    (ParticleOptions, {"particles": 2.5}),
    (ParticleOptions, {"paths": 0}),
    (ParticleOptions, {"resample_below": 1.5}),
    (ParticleOptions, {"pose": "nearest"}),
]


@pytest.mark.parametrize(("kind", "wrong"), OUT_OF_RANGE)
def test_parameters_out_of_range_are_refused_by_name(kind, wrong) -> None:
    assert next(iter(wrong)) in refused(kind, **wrong)
