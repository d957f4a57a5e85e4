"""Tables with their own names, units and value types: read as declared, written as read."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputError
from graphtrack.io.column_names import with_synonyms
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import rows_of_file, tracks_given
from graphtrack.tracks.time import from_dates, from_numbers, from_text

STEPS = np.arange(4)
X = {"anna": 1.5 + STEPS / 8, "bob": 4.0 - STEPS / 16}
COLUMNS = {"id": "agent", "time": "timestamp", "x": "pos_x", "y": "pos_y"}
SPEC = "id=agent,t=timestamp,x=pos_x,y=pos_y"


def frame(times: object = STEPS / 10, scale: float = 1.0) -> pd.DataFrame:
    """Two people in four steps."""
    parts = [
        pd.DataFrame({"agent": who, "timestamp": times, "pos_x": x * scale, "pos_y": -0.25 * scale})
        for who, x in X.items()
    ]
    return pd.concat(parts, ignore_index=True)


def check(tracks: gt.TrackSet) -> None:
    """That these are Anna and Bob."""
    assert [track.label for track in tracks] == list(X)
    for track in tracks:
        np.testing.assert_allclose(track.position, np.column_stack([X[track.label], np.full(4, -0.25)]))
        np.testing.assert_allclose(np.diff(track.t), 0.1, atol=3e-7)  # seconds of 1970 have no more digits
        np.testing.assert_array_equal(np.diff(track.frame), 1)


NANOSECONDS = 1_763_892_000_123_456_789
TIMES = {
    "seconds": (STEPS / 10, {}),
    "milliseconds": (STEPS * 100, {"time_unit": "ms"}),
    "unix seconds": (1_763_892_000.5 + STEPS / 10, {}),
    "unix milliseconds": (1_763_892_000_040 + STEPS * 100, {"time_unit": "ms"}),
    "unix microseconds": (1_763_892_000_040_001 + STEPS * 100_000, {"time_unit": "us"}),
    "unix nanoseconds": (NANOSECONDS + STEPS * 100_000_000, {"time_unit": "ns"}),
    "ISO": ([f"2025-11-23 10:00:00.{k}" for k in STEPS], {}),
    "ISO with a zone": ([f"2025-11-23T23:59:59.{k}00+05:30" for k in STEPS], {"time_unit": "iso"}),
    "ISO to nanoseconds": ([f"2025-11-23T10:00:00.{k}23456789Z" for k in STEPS], {"time_unit": "iso"}),
}


@pytest.mark.parametrize("name", ["table.csv", "table.parquet", "table.ndjson", "in memory"])
@pytest.mark.parametrize("times", TIMES.values(), ids=TIMES)
def test_a_table_is_read_as_said_and_written_as_read(times, name: str, tmp_path: Path) -> None:
    given, options = times
    table, path = frame(given), tmp_path / name
    if name == "in memory":
        tracks = io.read_identified(table, columns=COLUMNS, **options)
    else:
        write = {"csv": table.to_csv, "parquet": table.to_parquet}.get(name[6:])
        if write is None:
            table.to_json(path, orient="records", lines=True, double_precision=15)
        else:
            write(path, index=False)
        tracks = io.read_identified(path, columns=SPEC, **options)
    check(tracks)
    for ending in (".csv", ".parquet", ".ndjson"):
        out = tmp_path / f"out{ending}"
        io.write(tracks, out)
        check(io.read_identified(out, columns=COLUMNS, **options))
    back = tracks.to_table(as_read=True)
    assert list(back["agent"]) == list(table["agent"]) and "label" not in back
    if isinstance(given, list) or given.dtype.kind == "i":
        assert list(back["timestamp"])[:4] == list(given)
    else:
        np.testing.assert_array_equal(back["timestamp"][:4], given)
    assert list(pd.read_parquet(tmp_path / "out.parquet")["timestamp"]) == list(back["timestamp"])
    assert {"track_id", "t", "x"} < set(tracks.to_table())


def test_frames_of_pandas_and_polars_keep_their_dates() -> None:
    polars = pytest.importorskip("polars")
    for zone in (None, "Europe/Berlin"):
        times = pd.date_range("2025-10-26 01:59:59.8", periods=4, freq="100ms", tz=zone)
        table = frame(times)
        for one in (table, polars.from_pandas(table), {name: table[name] for name in table}):
            tracks = io.read_identified(one, columns=COLUMNS)
            check(tracks)
            assert list(tracks.to_table(as_read=True)["timestamp"]) == list(table["timestamp"])
    native = {"agent": "label", "timestamp": "t", "pos_x": "x", "pos_y": "y"}
    table = frame().rename(columns=native).assign(track_id=[1] * 4 + [2] * 4, frame=[*STEPS, *STEPS])
    check(tracks_given(polars.from_pandas(table)))


@pytest.mark.parametrize(("units", "metre"), [("cm", 0.01), ("mm", 0.001), ("ft", 0.3048), ("m", 1.0)])
def test_units_of_length(units: str, metre: float, tmp_path: Path) -> None:
    tracks = io.read_identified(frame(scale=1.0 / metre), columns=COLUMNS, units=units)
    check(tracks)
    moving = tracks.map(lambda track: replace(track, velocity=track.position))
    native, back = moving.to_table(), moving.to_table(as_read=True)
    np.testing.assert_allclose(back[["pos_x", "vx"]] * metre, native[["x", "vx"]], rtol=1e-12)
    assert list(back["agent"]) == ["anna"] * 4 + ["bob"] * 4


@given(count=st.integers(0, 2**62), steps=st.lists(st.integers(1, 10**12), min_size=1, max_size=5))
@settings(max_examples=100)
def test_whole_counts_come_back_to_the_last_digit(count: int, steps: list[int]) -> None:
    for unit, size in (("ns", 1), ("us", 1000), ("ms", 10**6)):
        values = (count // 2 // size) + np.cumsum([0, *steps])
        t, scale = from_numbers(values, unit)
        if values[0] * size >= 10**17 * 2:
            np.testing.assert_array_equal(scale.restored(t), values)


def test_text_and_dates_come_back_and_count_from_midnight() -> None:
    texts = ["2024-02-29T23:59:59.999-01:00", "2024-02-29T24:00:00.000-01:00".replace("29T24", "29T23")]
    t, scale = from_text([texts[0], ""], None)
    assert scale.restored(t[:1])[0] == texts[0] and np.isnan(t[1]) and t[0] == 3599.999
    dates = np.array(["2024-02-29T23:59:59.999", "NaT"], dtype="M8[us]")
    t, scale = from_dates(dates, "", None)
    assert t[0] == 86399.999 and np.isnan(t[1]) and scale.restored(t[:1])[0] == dates[0]


IDENTITIES = {
    "numbers": (["7", "12"], [7, 12]),
    "text": (["anna", "bob"], ["anna", "bob"]),
    "leading zeros": (["007", "12"], ["007", "12"]),
    "some of them numbers": (["12", "4ab"], ["12", "4ab"]),
    "beyond the bounds": (["9007199254740993", "1"], ["9007199254740993", "1"]),
}


@pytest.mark.parametrize("case", IDENTITIES.values(), ids=IDENTITIES)
def test_identities_come_back_as_they_were(case, tmp_path: Path) -> None:
    said, back = case
    path = tmp_path / "table.csv"
    path.write_text("who,t,x,y\n" + "".join(f"{who},{k},{k},0\n" for who in said for k in STEPS))
    tracks = io.read_identified(path, columns="id=who")
    assert list(tracks.to_table(as_read=True)["who"][::4]) == back and len(tracks.select(said[0])) == 1


def test_files_of_one_scene_count_from_the_same_and_keep_their_people(tmp_path: Path) -> None:
    days = [[f"2025-11-{day}T10:00:0{k}Z" for k in STEPS] for day in (23, 24)]
    for k, day in enumerate(days):
        frame(day).to_csv(tmp_path / f"{k}.csv", index=False)
    tracks = io.read_identified([tmp_path / "0.csv", tmp_path / "1.csv"], columns=COLUMNS)
    back = tracks.to_table(as_read=True)
    assert list(back["agent"].unique()) == ["anna", "bob", "anna (2)", "bob (2)"]
    assert list(back["timestamp"].unique()) == [*days[0], *days[1]]
    frame(days[0]).assign(agent=[1] * 4 + [2] * 4).to_csv(tmp_path / "1.csv", index=False)
    error = refused([tmp_path / "0.csv", tmp_path / "1.csv"], columns=COLUMNS)
    assert "numbers in" in error.found and "text in" in error.found


def test_columns_for_each_person_and_columns_that_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    wide = pd.DataFrame({"time": STEPS / 10})
    for who, x in X.items():
        wide[f"{who}_x"], wide[f"{who}_y"] = x, -0.25
    wide.loc[1, ["bob_x", "bob_y"]] = np.nan
    wide.to_csv(path, index=False)
    tracks = io.read_identified(path, columns="t=time,x=*_x,y=*_y")
    assert [len(track) for track in tracks] == [4, 3] and [track.label for track in tracks] == list(X)
    io.write(tracks, tmp_path / "long.csv")
    assert [track.label for track in io.read_identified(tmp_path / "long.csv", columns="t=time")] == list(X)
    assert "match" in refused(path, columns="t=time,x=x_*,y=y_*").expected
    wide.drop(columns="bob_y").to_csv(path, index=False)
    assert refused(path, columns="t=time,x=*_x,y=*_y").column == "bob_y"
    frame().to_csv(path, index=False, header=False, sep=" ")
    check(io.read_identified(path, columns="id=1,t=2,x=3,y=4", delimiter="space"))


def test_detections_have_times_and_no_identities(tmp_path: Path) -> None:
    path = tmp_path / "seen.csv"
    frame([f"2025-11-23T10:00:00.{k}Z" for k in STEPS]).drop(columns="agent").to_csv(path, index=False)
    options = {"columns": "t=timestamp,x=pos_x,y=pos_y"}
    assert "columns" in refused(path, associate="never", **options).expected
    rows = rows_of_file(path, None, ReadOptions(**options))
    assert not rows.has_identity and rows.as_read is not None and rows.as_read.time is not None
    assert rows.as_read.time.restored(rows.channels["t"])[1] == "2025-11-23T10:00:00.1Z"


WRONG = {
    "nothing": ({"columns": ""}, "no columns"),
    "no pair": ({"columns": "id"}, "'id'"),
    "no name": ({"columns": "id="}, "without a name"),
    "no key": ({"columns": "=agent"}, "without a name"),
    "an unknown key": ({"columns": "who=agent"}, "who=agent"),
    "a key twice": ({"columns": "id=agent,track_id=timestamp"}, "twice"),
    "a column twice": ({"columns": "x=pos_x,y=pos_x"}, "two meanings"),
    "a column that is not there": ({"columns": "id=nobody"}, "no column 'nobody'"),
    "half a place": ({"columns": "lat=pos_x"}, "lat alone"),
    "two places": ({"columns": "lat=pos_x,lon=pos_y,x=timestamp"}, "lat, lon"),
    "open quotes": ({"columns": '"id=agent'}, "columns"),
    "an unknown unit": ({"units": "inch"}, "inch"),
    "an unknown unit of time": ({"time_unit": "h"}, "time_unit"),
    "an unknown encoding": ({"encoding": "utf-99"}, "encoding"),
    "an encoding of bytes": ({"encoding": "base64"}, "encoding"),
    "a long delimiter": ({"delimiter": "ab"}, "delimiter"),
    "a letter between cells": ({"delimiter": "a"}, "delimiter"),
    "a decimal of no kind": ({"decimal": ";"}, "decimal"),
    "another format": ({"columns": SPEC, "format": "mot"}, "mot"),
    "ISO for numbers": ({"columns": SPEC, "time_unit": "iso"}, "'0.0'"),
    "counts too large": ({"columns": SPEC.replace("t=timestamp", "t=late"), "time_unit": "s"}, "1.7"),
}


@pytest.mark.parametrize("case", WRONG.values(), ids=WRONG)
def test_what_makes_no_sense_is_told_in_a_line(case, tmp_path: Path) -> None:
    options, said = case
    path = tmp_path / "table.csv"
    frame().assign(late=1_763_892_000_123_456_789).to_csv(path, index=False)
    assert said in str(refused(path, **options))


CELLS = {
    "text for a place": ("pos_x", "here", None),
    "an endless place": ("pos_x", "inf", None),
    "not a number": ("pos_y", "inf", None),
    "no time": ("timestamp", "", None),
    "no identity": ("agent", "", None),
    "a day that never was": ("timestamp", "2025-02-30T10:00:00", "iso"),
    "a year beyond the bounds": ("timestamp", "0025-02-20T10:00:00", "iso"),
    "a decimal comma": ("pos_x", '"1,5"', None),
}


@pytest.mark.parametrize("case", CELLS.values(), ids=CELLS)
def test_a_bad_cell_is_named_by_line_and_by_the_name_of_the_file(case, tmp_path: Path) -> None:
    column, cell, unit = case
    path = tmp_path / "table.csv"
    rows = [["agent", "timestamp", "pos_x", "pos_y"]]
    rows += [["anna", f"2025-02-20T10:00:0{k}" if unit else str(k), "1", "2"] for k in range(4)]
    rows[3][rows[0].index(column)] = cell
    path.write_text("\n".join(map(",".join, rows)) + "\n")
    error = refused(path, columns=COLUMNS, time_unit=unit)
    assert (error.line, error.column) == (4, column)
    path.write_text("agent,timestamp,pos_x,pos_y\n" + "".join(f"anna,{t},0,0\n" for t in (0, 1, 2, 1)))
    error = refused(path, columns=COLUMNS)  # a clock that jumps
    assert "anna again at 1" in error.found and error.line == 5


def test_degrees_become_metres_and_come_back(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    path, out = tmp_path / "table.csv", tmp_path / "out.csv"
    table = frame().assign(pos_y=48.137 + np.r_[STEPS, STEPS] * 1e-5, pos_x=11.575)
    table.to_csv(path, index=False)
    options = {"columns": "id=agent,t=timestamp,lat=pos_y,lon=pos_x"}
    tracks = io.read_identified(path, **options)
    # A degree of latitude is 111.2 km there.
    steps = np.diff(tracks.by_id(1).position, axis=0)
    np.testing.assert_allclose(steps, [[0.0, 1.112]] * 3, atol=2e-3)
    io.write(tracks, out)
    np.testing.assert_allclose(pd.read_csv(out)[["pos_x", "pos_y"]], table[["pos_x", "pos_y"]], atol=1e-10)
    again = io.read_identified(out, **options)
    np.testing.assert_allclose(again.by_id(1).position, tracks.by_id(1).position, atol=1e-6)
    # The same places by easting and northing.
    from pyproj import Transformer

    east, north = Transformer.from_crs(4326, 25832, always_xy=True).transform(table.pos_x, table.pos_y)
    table.assign(pos_x=east, pos_y=north).to_csv(path, index=False)
    metres = io.read_identified(path, columns=COLUMNS, crs="EPSG:25832")
    np.testing.assert_allclose(metres.by_id(1).position, tracks.by_id(1).position, atol=1e-3)
    np.testing.assert_allclose(metres.to_table(as_read=True)["pos_x"], east, atol=1e-6)


PLACES = {
    "no such system": ({"crs": "EPSG:1"}, "1,48,11", "EPSG:1"),
    "no system": ({"crs": "Munich"}, "1,48,11", "Munich"),
    "a system of heights": ({"crs": "EPSG:5773"}, "1,48,11", "EPSG:5773"),
    "half a place": ({}, "1,48,", "no place"),
    "a latitude that is none": ({}, "1,148,11", "148"),
    "metres for degrees": ({}, "1,5331000,691000", "--crs"),
    "nothing but gaps": ({}, "1,,", "no place"),
    "not a number": ({}, "1,inf,11", "'inf'"),
    "a word for half a place": ({}, "1,nan,11", "no place"),
    "two units": ({"crs": "EPSG:4326", "units": "cm"}, "1,48,11", "units"),
}


@pytest.mark.parametrize("case", PLACES.values(), ids=PLACES)
def test_places_that_are_none_are_told_in_a_line(case, tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    options, row, said = case
    path = tmp_path / "table.csv"
    path.write_text(f"t,lat,lon\n{row}\n")
    assert said in str(refused(path, columns="lat=lat,lon=lon", **options))


PEOPLE = (7, 8, 9)


def rows(names):
    """Rows of three people under other names: native column → name."""
    native = [
        {"track_id": one, "frame": k, "t": k / 10, "x": round(0.1 * k + one, 3), "y": float(one)}
        for k in range(12)
        for one in PEOPLE
    ]
    return [{name: row[key] for key, name in names.items()} for row in native]


def written(rows, path):
    if path.suffix == ".csv":
        pd.DataFrame(rows).to_csv(path, index=False)
    elif path.suffix == ".parquet":
        pd.DataFrame(rows).to_parquet(path)
    else:
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


def is_read(tracks):
    assert [one.track_id for one in tracks] == list(PEOPLE)
    for one in tracks:
        np.testing.assert_allclose(one.position[:, 0], 0.1 * np.arange(12) + one.track_id)
        np.testing.assert_allclose(np.diff(one.t), 0.1)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".ndjson"])
@pytest.mark.parametrize(
    "name", ["id", "ID", "person", "agent_id", "ped_id", "pedestrian", "tid", "Track ID", "PersonID"]
)
def test_identities_are_kept_under_their_common_names(tmp_path, suffix, name):
    names = {"frame": "frame", "track_id": name, "x": "x", "y": "y"}
    tracks = gt.read(written(rows(names), tmp_path / f"a{suffix}"), fps=10)
    is_read(tracks)
    assert any("as track_id" in note for note in tracks.summary.notes)


def test_units_in_names_count_and_native_columns_are_what_they_are(tmp_path):
    table = rows({"t": "t", "track_id": "id", "x": "x", "y": "y"})
    factors = {"id": ("id", 1), "t": ("time_ms", 1000), "x": ("pos_x_cm", 100), "y": ("pos_y_cm", 100)}
    units = [{name: of * row[key] for key, (name, of) in factors.items()} for row in table]
    is_read(gt.read(written(units, tmp_path / "a.csv")))
    native = rows({name: name for name in ("t", "track_id", "frame", "x", "y")})
    both = [row | {"id": 1, "time": 5.0, "pos_x": 0.0} for row in native]
    is_read(gt.read(written(both, tmp_path / "a.csv")))
    path = written(rows({"frame": "frame", "track_id": "device", "x": "x", "y": "y"}), tmp_path / "a.csv")
    assert any("'device' may be an identity" in note for note in gt.read(path, fps=10).summary.notes)


def test_two_names_of_one_column_are_an_error(tmp_path):
    table = [row | {"person": 1} for row in rows({"frame": "frame", "track_id": "id", "x": "x", "y": "y"})]
    with pytest.raises(InputError, match=r"'id' and 'person'.*--columns id=NAME"):
        gt.read(written(table, tmp_path / "a.csv"), fps=10)
    is_read(gt.read(tmp_path / "a.csv", fps=10, columns="id=id"))


def test_pixels_are_never_taken_for_metres():
    options, notes = with_synonyms(["frame", "track_id", "u", "v", "pos_x", "pos_y"], ReadOptions())
    assert options.columns is None and not notes


FOREIGN = {"label": ["car", "van"], "observed": [True, False], "score": ["a", "b"], "vx": [1e300, 2.0]}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("name", FOREIGN)
def test_columns_of_common_names_are_read_only_if_they_are_named(tmp_path, name, suffix):
    names = {"track_id": "agent", "frame": "frame", "t": "t", "x": "px", "y": "py"}
    table = [row | {name: FOREIGN[name][row["frame"] % 2]} for row in rows(names)]
    path = written(table, tmp_path / f"a{suffix}")
    tracks = gt.read(path, columns="id=agent,x=px,y=py")
    is_read(tracks)
    assert all(track.label == "" and track.score is None and track.velocity is None for track in tracks)
    assert any(f"columns {name} were not read" in note for note in tracks.summary.notes)
    good = [row | {"score": 0.5, "label": f"P{row['agent']}"} for row in rows(names)]
    tracks = gt.read(written(good, path), columns="id=agent,x=px,y=py,score=score")
    assert all((track.score == 0.5).all() and track.label == "" for track in tracks)


@pytest.mark.parametrize("ending", ["csv", "parquet", "ndjson"])
@pytest.mark.parametrize("text", [False, True])
def test_what_was_read_by_numbers_reads_back_with_the_same_options(tmp_path, ending, text):
    table = frame(scale=100.0).assign(agent=["P1"] * 4 + ["P2"] * 4 if text else [7] * 4 + [9] * 4)
    table.assign(head=0.1).to_csv(tmp_path / "a.txt", index=False, header=False)
    options = {"columns": "id=1,t=2,x=3,y=4,head_rad=5", "units": "cm"}
    tracks = gt.read(tmp_path / "a.txt", **options)
    smoothed = gt.smooth(tracks, "position")
    out = tmp_path / f"b.{ending}"
    for one in (tracks, smoothed):
        gt.write(one, out)
        again = gt.read(out, **options)
        assert [track.label for track in again] == (["P1", "P2"] if text else ["", ""])
        for before, after in zip(one, again, strict=True):
            np.testing.assert_allclose(after.position, before.position, atol=1e-12)
            np.testing.assert_array_equal(after.t, before.t)
            assert (before.head is None) == (after.head is None)
    assert again.by_id(1 if text else 7).velocity is not None


@pytest.mark.parametrize("repeats", [1, 3000])  # pyarrow reads large files
def test_text_identities_and_words_for_empty_cells_under_native_names(tmp_path, repeats):
    words = ["NA", "NaN", "null", "nan", "None", ""]
    lines = ["track_id,frame,t,x,y,head_deg,label"]
    for k in range(6 * repeats):
        lines += [f"P{who},{k},{k / 10},{who},{k},{words[k % 6] if who else 20},NA" for who in (0, 1)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    tracks = gt.read(tmp_path / "a.csv")
    assert [track.track_id for track in tracks] == [1, 2]
    assert all(track.label == "NA" for track in tracks)  # a word of its own in a column of text
    assert tracks.by_id(2).head is None and np.isfinite(tracks.by_id(1).head).all()
    gt.write(tracks, tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_text().splitlines()[1].startswith('"P0",0,')
    names = {name: name for name in ("track_id", "frame", "t", "x", "y")}
    error = refused(written([*rows(names)[:5], rows(names)[6] | {"track_id": "P7"}], tmp_path / "c.csv"))
    assert error.line == 7 and "--columns id=track_id" in error.expected  # a mistake among numbers


def test_errors_name_people_as_the_file_does(tmp_path):
    (tmp_path / "a.csv").write_text("track_id,frame,t,x,y\nanna,0,0,0,0\nanna,1,1,0,0\nanna,1,2,0,0\n")
    assert refused(tmp_path / "a.csv").found == "track anna again in frame 1"
    (tmp_path / "a.csv").write_text("track_id,frame,t,x,y,label\nbob,0,0,0,0,a\nbob,1,1,0,0,b\n")
    assert "one label for track bob" in refused(tmp_path / "a.csv").expected
    (tmp_path / "a.csv").write_text("track_id,frame,t,x,y\nbob,0,0,0,0\nbob,1,0,0,0\n")
    assert "of track bob" in refused(tmp_path / "a.csv").found


def test_whole_numbers_with_a_point_are_numbers(tmp_path):
    (tmp_path / "a.csv").write_text("who,t,x,y\n1.0,0,0,0\n1.0,1,0,0\n20.,0,0,0\nNA,5,0,0\n")
    error = refused(tmp_path / "a.csv", columns="id=who")
    assert error.line == 5 and error.found == "an empty cell"
    (tmp_path / "a.csv").write_text("who,t,x,y\n1.0,0,0,0\n1.0,1,0,0\n20.,0,0,0\n")
    assert [track.track_id for track in gt.read(tmp_path / "a.csv", columns="id=who")] == [1, 20]


PAIRS = {
    "metres": (("x", "y"), {}),
    "own names": (("pos_x", "pos_y"), {"columns": "id=track_id,t=t,x=pos_x,y=pos_y"}),
    "pixels": (("u", "v"), {"metres_per_pixel": 0.01}),
    "places": (("lat", "lon"), {"columns": "id=track_id,t=t,lat=lat,lon=lon"}),
    "truth": (("true_x", "true_y"), {}),
}


@pytest.mark.parametrize("ending", ["csv", "parquet", "ndjson", "memory"])
@pytest.mark.parametrize("pair", PAIRS)
def test_half_a_position_is_none(pair: str, ending: str, tmp_path: Path) -> None:
    """Such rows are as those without both, and one note counts them."""
    (first, second), options = PAIRS[pair]
    rows = pd.DataFrame({"track_id": 1, "frame": range(12), "t": np.arange(12) / 10, "x": 0.0, "y": 1.0})
    if pair != "truth":
        rows = rows.drop(columns=["x", "y"])
    rows[first], rows[second] = 48.0 + np.arange(12) / 1e5, 11.0
    halves, whole = rows.copy(), rows.copy()
    halves.loc[[2, 7], first] = halves.loc[[4], second] = np.nan
    halves.loc[9, [first, second]] = np.nan
    whole.loc[[2, 4, 7, 9], [first, second]] = np.nan

    def read(table: pd.DataFrame, name: str) -> gt.TrackSet:
        if ending == "memory":
            return gt.read(table, **options)
        path = tmp_path / f"{name}.{ending}"
        if ending == "ndjson":
            table.to_json(path, orient="records", lines=True)
        else:
            table.to_csv(path, index=False) if ending == "csv" else table.to_parquet(path)
        return gt.read(path, **options)

    found, expected = read(halves, "halves"), read(whole, "whole")
    assert found.n_frames == 12
    pd.testing.assert_frame_equal(found.to_table(), expected.to_table())
    (note,) = set(found.summary.notes) - set(expected.summary.notes)
    assert note.startswith("3 rows with only one of ") and note.endswith("without a position")


def test_detections_with_times_alone_are_read(tmp_path):
    (tmp_path / "scan.csv").write_text("t,x,y\n0,0,0\n0,1,1\n0.1,0.1,0\n0.1,1.1,1\n")
    found = gt.associate(tmp_path / "scan.csv")
    assert [len(one) for one in found] == [2, 2]
    np.testing.assert_allclose(found[0].t, [0.0, 0.1])
