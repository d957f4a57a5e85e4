"""One table in many forms: each has a way through, and the line that is suggested takes it, as printed."""

import re
import shlex
import sqlite3
from collections.abc import Callable
from pathlib import Path

import command
import numpy as np
import pandas as pd
import pytest
from format_samples import sample_of
from refusals import refused

from graphtrack import io
from graphtrack.cli.options import MetricReading
from graphtrack.errors import InputError
from graphtrack.io.suggestion import suggest
from graphtrack.tracks.track import TrackSet

STEPS = 12
T = np.arange(STEPS) / 10
PEOPLE = {"7": (1.5 + 1.25 * T, -0.25 + 0.1 * T), "12": (4.0 - 1.1 * T, 2.0 - 0.3 * T)}
UNIX = 1_763_892_000
START = np.datetime64("2025-11-23T10:00:00", "ms")


def table(**columns: object) -> pd.DataFrame:
    """The table; ``columns`` are its own names for id, frame, t, x and y, None for those that it has not."""
    names = {"id": "track_id", "frame": "frame", "t": "t", "x": "x", "y": "y"} | columns
    parts = []
    for who, (x, y) in PEOPLE.items():
        cells = {"id": int(who), "frame": np.arange(STEPS), "t": T, "x": np.round(x, 6), "y": np.round(y, 6)}
        parts.append(pd.DataFrame({name: cells[key] for key, name in names.items() if name is not None}))
    return pd.concat(parts, ignore_index=True)


def text(frame: pd.DataFrame, **options: object) -> bytes:
    return frame.to_csv(index=False, **options).encode()


PLAIN = {"id": "person", "frame": None, "t": "time", "x": "pos_x", "y": "pos_y"}


def times(name: str, values: Callable[[pd.Series], object]) -> pd.DataFrame:
    frame = table(**PLAIN | {"t": name})
    frame[name] = values(frame[name])
    return frame


def scaled(factor: float, **columns: object) -> pd.DataFrame:
    frame = table(**PLAIN | columns)
    places = list(frame.columns[-2:])
    frame[places] = (frame[places] * factor).round(9)
    return frame


def wide() -> pd.DataFrame:
    frame = pd.DataFrame({"time": T})
    for who, (x, y) in PEOPLE.items():
        frame[f"x_{who}"], frame[f"y_{who}"] = x, y
    return frame


def degrees() -> pd.DataFrame:
    pyproj = pytest.importorskip("pyproj")
    frame = table(**PLAIN | {"x": "longitude", "y": "latitude"})
    local = "+proj=tmerc +lat_0=48.13 +lon_0=11.57 +k=1 +datum=WGS84 +units=m"
    to_degrees = pyproj.Transformer.from_crs(local, "EPSG:4326", always_xy=True)
    frame["longitude"], frame["latitude"] = to_degrees.transform(frame.longitude, frame.latitude)
    return frame


def named(frame: pd.DataFrame, column: str) -> pd.DataFrame:
    return frame.assign(**{column: frame[column].map({7: "anna", 12: "björn"})})


def parquet(frame: pd.DataFrame) -> bytes:
    path = Path("made.parquet")
    frame.to_parquet(path)
    return path.read_bytes()


VARIANTS: dict[str, Callable[[], bytes]] = {
    "the native table": lambda: text(table()),
    "other names": lambda: text(table(id="agent_id", frame="frame_id", t="timestamp", x="pos_x", y="pos_y")),
    "units in brackets": lambda: text(table(id="Person", t="Time [s]", x="X [m]", y="Y [m]")),
    "camel case": lambda: text(table(id="trackId", frame="frameNumber", t="timeStamp", x="posX", y="posY")),
    "semicolons": lambda: text(table(), sep=";"),
    "semicolons and decimal commas": lambda: text(table(**PLAIN), sep=";", decimal=","),
    "spaces": lambda: re.sub(rb",", b"   ", text(table(**PLAIN))),
    "a line for Excel": lambda: b"sep=;\r\n" + text(table(**PLAIN), sep=";"),
    "UTF-16": lambda: text(table(**PLAIN), sep="\t").decode().encode("utf-16"),
    "UTF-16 without a mark": lambda: text(table(**PLAIN)).decode().encode("utf-16-le"),
    "Windows' letters": lambda: text(named(table(**PLAIN), "person")).decode().encode("cp1252"),
    "text identities": lambda: text(named(table(**PLAIN), "person")),
    "ISO times": lambda: text(times("datetime", lambda t: [f"{START + round(1e3 * s)}" for s in t])),
    "ISO times with a zone": lambda: text(
        times("timestamp", lambda t: [f"{START + round(1e3 * s)}+01:00".replace("T", " ") for s in t])
    ),
    "unix seconds": lambda: text(times("timestamp", lambda t: (UNIX + t).map("{:.3f}".format))),
    "unix milliseconds": lambda: text(
        times("timestamp", lambda t: (UNIX * 1000 + (t * 1000).round()).astype(int))
    ),
    "unix nanoseconds": lambda: text(times("stamp", lambda t: UNIX * 10**9 + (t * 1e9).round().astype(int))),
    "milliseconds in the name": lambda: text(times("time_ms", lambda t: (t * 1000).round().astype(int))),
    "milliseconds by their steps": lambda: text(times("time", lambda t: (t * 1000).round().astype(int))),
    "frames and no times": lambda: text(table(id="person", t=None)),
    "a column of row numbers": lambda: table(**PLAIN).to_csv().encode(),
    "columns besides": lambda: text(table(**PLAIN).assign(note="a, b", speed=1.0, colour="red")),
    "centimetres": lambda: text(scaled(100.0, x="x_cm", y="y_cm")),
    "feet": lambda: text(scaled(1.0 / 0.3048, x="x (ft)", y="y (ft)")),
    "millimetres by their speeds": lambda: text(scaled(1000.0)),
    "degrees": lambda: text(degrees()),
    "wide": lambda: text(wide()),
    "NDJSON": lambda: table(**PLAIN).to_json(orient="records", lines=True).encode(),
    "Parquet with dates": lambda: parquet(
        times("timestamp", lambda t: pd.to_datetime(START) + pd.to_timedelta(t, unit="s"))
    ),
    "names with commas": lambda: text(table(**PLAIN | {"id": "person, id", "x": "x, [m]", "y": "y, [m]"})),
}


@pytest.fixture
def here(cwd: Path) -> Path:
    return cwd


def run_suggested(path: Path, monkeypatch: pytest.MonkeyPatch, *more: object) -> tuple[TrackSet, str]:
    """The tracks that the suggested line reads, run as it was printed, and the line."""
    done = command.ran("info", path, "--suggest", *more, program="graphtrack")
    (line,) = done.stdout.splitlines()
    read: list[TrackSet] = []
    tracks_of = MetricReading.tracks

    def kept(*arguments: object, **options: object) -> TrackSet:
        read.append(tracks_of(*arguments, **options))  # type: ignore[arg-type]
        return read[-1]

    monkeypatch.setattr(MetricReading, "tracks", kept)
    program, *arguments = shlex.split(line)
    done = command.ran(*arguments, program=program)
    return read[0], line


@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS)
def test_every_variant_is_read_by_the_line_that_is_suggested(
    variant: Callable[[], bytes], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = here / "some walks.csv"
    path.write_bytes(variant())
    try:
        as_it_stands: TrackSet | None = io.read_identified(path)
    except InputError as error:
        as_it_stands = None
        assert "--" in str(error), error
    tracks, line = run_suggested(path, monkeypatch)
    assert len(tracks) == len(PEOPLE)
    for track, (x, y) in zip(tracks, PEOPLE.values(), strict=True):
        np.testing.assert_allclose(track.position, np.column_stack([x, y]), atol=1e-5)
        step = 0.04 if "--fps" in line else 0.1
        np.testing.assert_allclose(np.diff(track.t), step, atol=1e-6)
        assert track.label in ("", "anna", "björn", "7", "12")
    doubts = ("faster than", "--time-unit ms if")
    if as_it_stands is not None and not any(
        doubt in note for note in as_it_stands.summary.notes for doubt in doubts
    ):
        assert "--" not in line


def test_what_cannot_be_read_is_told_with_what_is_missing(here: Path) -> None:
    for content, said in (
        ("person,time,speed\n1,0,1\n1,1,1\n", "no columns of positions"),
        ("person,x,y\n1,0,1\n1,1,1\n", "no column of times"),
        ("person,time,x,y\n1,0,left,1\n1,1,right,1\n", "'left'"),
        ("", "empty"),
    ):
        (here / "table.csv").write_text(content)
        done = command.run("info", "table.csv", "--suggest", program="graphtrack")
        assert done.returncode == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1, (
            done.stderr
        )
    with sqlite3.connect(here / "people.gpkg") as connection:
        connection.execute("create table gpkg_contents (x)")
    for look in (io.read_identified, suggest):
        with pytest.raises(InputError, match="GeoPackage"):
            look(here / "people.gpkg")
    done = command.run("info", "table.csv", "--suggest", "--select", 5, program="graphtrack")
    assert done.returncode == 2 and "--suggest" in done.stderr


TABLE = "track_id,frame,t,x,y\n" + "".join(f"7,{k},{k / 10},{1.5 + k / 8},-0.25\n" for k in range(4))
NAMES = {";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "spaces"}


def options_named(error: InputError) -> dict[str, str]:
    """The options that the message recommends."""
    words = shlex.split(error.expected.split("; ")[-1].removesuffix(" reads it"))
    assert words and all(word.startswith("--") for word in words[::2])
    return {name.removeprefix("--"): value for name, value in zip(words[::2], words[1::2], strict=True)}


@pytest.mark.parametrize("name", ["table.csv", "table.txt", "table"])
@pytest.mark.parametrize("before", ["", "sep={mark}\r\n", "\n"], ids=["", "sep", "empty"])
@pytest.mark.parametrize(("mark", "decimal"), [(";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", ".")])
def test_a_native_table_is_diagnosed(mark: str, decimal: str, before: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    table = TABLE.replace(",", mark).replace(".", decimal)
    path.write_text(before.format(mark=mark) + table)
    error = refused(path)
    assert NAMES[mark] in error.found and ("decimal commas" in error.found) == (decimal == ",")
    assert str(refused(path, format="csv")) == str(error)
    track = io.read_identified(path, **options_named(error)).by_id(7)
    np.testing.assert_allclose(track.position[:, 0], 1.5 + np.arange(4) / 8)


@pytest.mark.parametrize("mark", [";", "\t"])
@pytest.mark.parametrize("format", [None, "mot"])
def test_numbers_without_a_header_are_diagnosed(format: str | None, mark: str, tmp_path: Path) -> None:
    path = sample_of("mot").write(tmp_path)
    expected = io.read_identified(path)
    path.write_text(path.read_text().replace(",", mark))
    error = refused(path, format=format)
    assert NAMES[mark] in error.found
    found = io.read_identified(path, **options_named(error))
    np.testing.assert_array_equal(found.by_id(1).pixel, expected.by_id(1).pixel)


def test_a_line_before_the_header_and_a_decimal_comma_are_named(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("sep=,\n" + TABLE)
    error = refused(path)
    assert (
        error.found == "the line 'sep=,'" and io.read_identified(path, **options_named(error)).n_frames == 4
    )
    path.write_text('track_id,frame,t,x,y\n7,0,"0,5",1,2\n')
    error = refused(path)
    assert "decimal point" in error.expected and (error.line, error.column) == (2, "t")


PIXELS = {
    "px and py": table(**PLAIN | {"x": "px", "y": "py"}),
    "pixels in the unit": table(**PLAIN | {"x": "x [px]", "y": "y [px]"}),
    "image_x": table(**PLAIN | {"x": "image_x", "y": "image_y"}),
}


@pytest.mark.parametrize("frame", PIXELS.values(), ids=PIXELS)
def test_names_that_say_pixels_ask_for_a_camera(
    frame: pd.DataFrame, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame.iloc[:, -2:] *= 100.0  # in centimetres the speeds would be those of people
    frame.to_csv("walks.csv", index=False)
    done = command.run("info", "walks.csv", "--suggest", program="graphtrack")
    assert done.returncode == 2 and "--metres-per-pixel" in done.stderr and not done.stdout
    tracks, line = run_suggested(here / "walks.csv", monkeypatch, "--metres-per-pixel", 0.01)
    assert "u=" in line and "--units" not in line and "--metres-per-pixel 0.01" in line
    for track, (x, y) in zip(tracks, PEOPLE.values(), strict=True):
        np.testing.assert_allclose(track.position, np.column_stack([x, -y]), atol=1e-5)


def boxed(**names: str) -> pd.DataFrame:
    frame = table(t=None).drop(columns=["x", "y"])
    left = np.concatenate([100.0 + 2.0 * np.arange(STEPS), 400.0 - 2.0 * np.arange(STEPS)])
    columns = {
        "left": left,
        "top": 200.0,
        "right": left + 40.0,
        "bottom": 300.0,
        "width": 40.0,
        "height": 100.0,
    }
    columns |= {"center_x": left + 20.0, "center_y": 250.0, "head": 0.5, "kind": "Pedestrian"}
    for key, name in names.items():
        frame[name] = columns[key]
    return frame


BOXED = {
    "corners": boxed(left="x1", top="y1", right="x2", bottom="y2"),
    "sizes": boxed(left="left", top="top", width="width", height="height"),
    "centres": boxed(center_x="xCenter", center_y="yCenter", width="width", height="height"),
    "odd ids": boxed(left="x1", top="y1", right="x2", bottom="y2").rename(columns={"track_id": "obj"}),
}


@pytest.mark.parametrize("frame", BOXED.values(), ids=BOXED)
@pytest.mark.parametrize("header", [True, False])
def test_boxes_are_no_people_and_no_metres(
    frame: pd.DataFrame, header: bool, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not header and "x1" not in frame:
        pytest.skip("only corners are known by their numbers")
    frame.to_csv("boxes.csv", index=False, header=header)
    tracks, line = run_suggested(here / "boxes.csv", monkeypatch, "--metres-per-pixel", 0.01)
    assert "*" not in line and "--units" not in line and len(tracks) == 2
    for track, left in zip(tracks, (100.0, 400.0), strict=True):
        np.testing.assert_allclose(track.position[0], [0.01 * (left + 20.0), -3.0])


def test_angles_by_name_and_range(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for values, key in ((90.0, "head_deg"), (1.5, "head_rad")):
        table(id="obj").assign(head_angle=values).to_csv("walks.csv", index=False)
        tracks, line = run_suggested(here / "walks.csv", monkeypatch)
        assert f"{key}=head_angle" in line and tracks[0].head is not None
        assert tracks[0].head[0] == pytest.approx(np.deg2rad(values) if key == "head_deg" else values)


@pytest.mark.parametrize("count", ["timestep", "step_id", "Scan"])
@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_counted_scenarios_of_driving_data(
    count: str, ending: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Columns as in Argoverse 2: counts without a rate, angles by their name, and a flag."""
    frame = table(id="track_id", x="position_x", y="position_y", t=None).rename(columns={"frame": count})
    frame.insert(0, "observed", np.arange(len(frame)) % 3 > 0)
    frame = frame.assign(heading=0.7, object_type="pedestrian")
    path = here / f"scenario.{ending}"
    frame.to_parquet(path) if ending == "parquet" else frame.to_csv(path, index=False)
    refused = command.run("info", path, program="graphtrack")
    assert refused.returncode == 2 and "--suggest" in refused.stderr
    assert "--fps is missing" in command.ran("info", path, "--suggest", program="graphtrack").stderr
    tracks, line = run_suggested(path, monkeypatch)
    assert f"frame={count},x=position_x,y=position_y,body_rad=heading" in line and "--fps" in line
    for track in tracks:
        assert len(track) == STEPS and track.observed is None
        np.testing.assert_allclose(track.body, 0.7)
    with_rate, rated = run_suggested(path, monkeypatch, "--fps", 10)
    assert "--fps 10" in rated and with_rate[0].t[-1] == pytest.approx((STEPS - 1) / 10)


@pytest.mark.parametrize("mark", ["\t", " ", ","])
@pytest.mark.parametrize("order", [("frame", "track_id", "x", "y"), ("track_id", "frame", "x", "y")])
def test_tables_without_a_header_get_numbers(
    order: tuple[str, ...], mark: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = table(t=None)[list(order)]
    frame["frame"] = 10 * frame["frame"] + 780
    frame.sort_values("frame").astype(float).to_csv("walks.txt", sep=mark, index=False, header=False)
    done = command.run("info", "walks.txt", program="graphtrack")
    assert done.returncode == 2 and "--suggest" in done.stderr and "--delimiter" not in done.stderr
    tracks, line = run_suggested(here / "walks.txt", monkeypatch)
    assert f"frame={order.index('frame') + 1},id={order.index('track_id') + 1},x=3,y=4" in line
    assert [track.track_id for track in tracks] == [7, 12]
    np.testing.assert_allclose(tracks[0].position[:, 0], PEOPLE["7"][0])


def test_a_comment_that_names_the_columns_is_their_order(here: Path) -> None:
    frame = table(t=None)[["frame", "track_id", "x", "y"]]
    (here / "walks.txt").write_text("# frame ped x y\n" + frame.to_csv(sep=" ", index=False, header=False))
    tracks = io.read_identified(here / "walks.txt", fps=10, units="m")
    assert [track.track_id for track in tracks] == [7, 12] and suggest(here / "walks.txt").options


@pytest.mark.slow
def test_estimates_are_read_by_the_options_that_smooth_prints(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They keep the names, units and convention of their input; none of their own columns is proposed."""
    people = table(id="who", t="time", x="px", y="py").assign(head_angle=40.0)
    people["time"] = 100 * np.tile(np.arange(STEPS), len(PEOPLE))
    people.to_csv("walks.csv", index=False)
    asked = ["--columns", "id=who,t=time,u=px,v=py,head_deg=head_angle", "--time-unit", "ms"]
    asked += ["--metres-per-pixel", "1", "--angles", "clockwise from image up"]
    done = command.run(
        "smooth", "walks.csv", "-o", "s.csv", *asked, "--intervals", "95", program="graphtrack"
    )
    assert done.returncode == 0, done.stderr
    (line,) = (one for one in done.stderr.splitlines() if "s.csv is read by: " in one)
    words = shlex.split(line.partition("is read by: ")[2])
    again = dict(zip((word[2:].replace("-", "_") for word in words[::2]), words[1::2], strict=True))
    tracks = io.read_identified(here / "s.csv", **again)
    assert [len(track) for track in tracks] == [STEPS, STEPS]
    np.testing.assert_allclose(tracks[0].t, T)
    for track in tracks:
        np.testing.assert_allclose(np.degrees(track.head), 50.0, atol=25.0)  # clockwise from up
        assert track.body is not None and track.velocity is not None
    proposed = suggest(here / "s.csv").options.get("columns", "")
    assert "head_deg=head_angle" in proposed and "heading_deg" not in proposed and "_low" not in proposed
