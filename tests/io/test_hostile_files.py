"""Files that are made to break a reader or a writer: one error each, in bounded time and memory."""

import gzip
import json
import os
import resource
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from command import run
from refusals import refused

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.interaction.parameters import GroupParameters

HEADER = "track_id,frame,t,x,y"
ROWS = [HEADER, *(f"1,{k},{k / 10},{k / 20},0" for k in range(20))]
TEXT = "\n".join(ROWS) + "\n"


def command(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "graphtrack", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, timeout=300, check=False, **options)


@pytest.mark.slow
def test_a_table_of_a_million_columns_is_read_and_its_names_are_not_all_listed(tmp_path: Path) -> None:
    n = 10**6
    path = tmp_path / "wide.csv"
    names = ",".join(f"c{k}" for k in range(n))
    path.write_text(f"{HEADER},{names}\n" + "".join(row + ",1" * n + "\n" for row in ROWS[1:3]))
    done = command("info", path)  # it ran for more than half an hour
    assert done.returncode == 0 and len(done.stdout + done.stderr) < 2000
    assert "999990 more" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("text", [b"\n" * 2**20, b"1" * 2**20], ids=["blank", "endless"])
def test_a_gzip_bomb_is_refused_in_little_memory(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "bomb.csv.gz"
    path.write_bytes(gzip.compress(HEADER.encode() + b"\n") + 300 * gzip.compress(text))

    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (2**31, 2**31))

    done = command("info", path, preexec_fn=bounded)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "more than 200 times its size" in done.stderr


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "ndjson", "ndjson.gz", "parquet", "sqlite", "txt", "nc"])
def test_a_full_disk_is_one_error_in_every_format(
    tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if ending == "nc":
        pytest.importorskip("h5netcdf")
    source, output = tmp_path / "in.csv", tmp_path / "out" / f"o.{ending}"
    output.parent.mkdir()
    x = np.random.default_rng(0).normal(size=20_000)
    rows = (f"1,{k},{k / 10},{value:.9f},{-value:.9f}\n" for k, value in enumerate(x))
    source.write_text(HEADER + "\n" + "".join(rows))

    # Bytecode of modules that are imported here for the first time would be cut off, too.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, before[1]))
    try:
        done = run("convert", source, "-o", output, program="graphtrack")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert done.returncode == 2, done.stderr
    said = [line for line in done.stderr.splitlines() if str(source) not in line and "note" not in line]
    assert len(said) == 1, done.stderr
    assert said[0].startswith(f"error: {output}: found File too large when writing")
    assert not list(output.parent.iterdir())


def test_a_geopackage_that_cannot_be_completed_is_an_error_of_writing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    geopandas = pytest.importorskip("geopandas")

    def full(*arguments: object, **options: object) -> None:
        raise pyogrio.errors.FeatureError("failed to insert:\ndisk is full")

    monkeypatch.setattr(geopandas.GeoDataFrame, "to_file", full)
    (tmp_path / "in.csv").write_text(TEXT)
    done = run("convert", tmp_path / "in.csv", "-o", tmp_path / "o.gpkg", program="graphtrack")
    assert done.returncode == 2 and "found failed to insert: disk is full when writing" in done.stderr
    assert [one.name for one in tmp_path.iterdir()] == ["in.csv"]


@pytest.mark.slow
def test_the_table_of_info_ends(tmp_path: Path) -> None:
    rows = (f"{k},0,0,{k},0\n" for k in range(1001))
    (tmp_path / "in.csv").write_text(HEADER + "\n" + "".join(rows))
    done = run("info", tmp_path / "in.csv", program="graphtrack")
    assert done.returncode == 0 and "1001 tracks" in done.stdout
    assert "only the first 1,000 tracks are shown; --json writes all" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["öut.csv", os.fsdecode(b"\xff\xfeo.csv")])
def test_terminals_that_are_not_utf8_show_escapes(tmp_path: Path, name: str) -> None:
    (tmp_path / "in.csv").write_text(TEXT)
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = command("convert", tmp_path / "in.csv", "-o", tmp_path / name, env=environment)
    assert done.returncode == 0, done.stderr
    done = command("info", tmp_path / name, env=environment)
    assert done.returncode == 0, done.stderr
    assert "1 track" in done.stdout and "Traceback" not in done.stderr


def test_a_comment_before_the_header_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\n# recorded in the hall\n" + TEXT)
    with pytest.raises(InputError, match=r"line 2: found a comment, expected a header"):
        gt.read(path)
    path.write_text("#" + TEXT.replace("track_id", "id", 1))
    assert gt.read(path).n_frames == 20  # NumPy's savetxt writes names behind this mark


def test_lists_and_workbooks_are_told_what_they_are(tmp_path: Path) -> None:
    for name in ("a.json", "a.txt"):
        (tmp_path / name).write_text('[{"track_id": 1, "frame": 0, "t": 0, "x": 0, "y": 0}]')
        assert gt.read(tmp_path / name).n_frames == 1
        (tmp_path / name).write_text('[{"track_id": 1}, 2]')
        assert "expected a list of objects" in str(refused(tmp_path / name))
    keys = ",".join(f'{{"k{k}": 1}}' for k in range(6000))  # each row has all keys of the table
    (tmp_path / "a.json").write_text(f"[{keys}]")
    assert "rows with one of 6000 keys" in str(refused(tmp_path / "a.json"))
    for name in ("a.xlsx", "a.csv"):
        with zipfile.ZipFile(tmp_path / name, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("xl/workbook.xml", "<workbook/>" * 99)
        assert (
            "Excel" in refused(tmp_path / name).found and "saved as CSV" in refused(tmp_path / name).expected
        )


@pytest.mark.parametrize("name", ["label", "who"])
def test_half_a_surrogate_pair_is_no_text(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.ndjson"
    row = {"track_id": 1, "frame": 0, "t": 0.0, "x": 0.0, "y": 0.0, name: "\ud800"}
    options = {}
    if name == "who":
        del row["track_id"]
        options = {"columns": "id=who"}
    path.write_text(json.dumps(row) + "\n")
    said = str(refused(path, **options))
    assert "line 1" in said and "surrogate" in said  # it was an error of the output, without a place


def test_brackets_without_end_in_a_model_file_are_one_error(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("a = " + "[" * 50_000 + "]" * 50_000)
    for load in (gt.Model.load, gt.ForecastParameters.load, GroupParameters.load):
        with pytest.raises(InputError, match="brackets within brackets"):
            load(path)


def test_labels_are_no_formulas_where_a_spreadsheet_is_asked_for(tmp_path: Path) -> None:
    label = "=cmd|' /C calc'!A0"
    path, sheet = tmp_path / "a.csv", tmp_path / "sheet.csv"
    path.write_text("track_id,frame,t,x,y,label\n" + "".join(f'1,{k},{k},0,0,"{label}"\n' for k in range(3)))
    done = run("convert", path, "-o", sheet, "--spreadsheet", program="graphtrack")
    assert done.returncode == 0 and f"'{label}" in sheet.read_text()
    assert gt.read(sheet).tracks[0].label == f"'{label}"
    path.write_text("who,frame,t,x,y\n" + "".join(f"@anna,{k},{k},0,0\n" for k in range(3)))
    named = ("--columns", "id=who")
    done = run("convert", path, "-o", sheet, "--spreadsheet", *named, program="graphtrack")
    assert done.returncode == 0 and '\n"\'@anna",' in sheet.read_text()
    run("convert", path, "-o", sheet, *named, program="graphtrack")
    assert '\n"@anna",' in sheet.read_text()  # unchanged without the option
    done = run("convert", path, "-o", tmp_path / "a.ndjson", "--spreadsheet", *named, program="graphtrack")
    assert done.returncode == 2 and "--spreadsheet" in done.stderr


@pytest.mark.parametrize(
    "character", [*"\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069", "\ufeff"]
)
def test_the_direction_of_writing_is_not_changed_in_the_terminal(tmp_path: Path, character: str) -> None:
    path = tmp_path / f"a{character}.csv"
    path.write_text("track_id,frame,t,x,y,label,odd" + character + "\n" + f"1,0,0,0,0,a{character}b,\n")
    for words in (
        ("info", path),
        ("info", path, "--columns", f"x={character}"),
        ("smooth", path, "-o", tmp_path),
    ):
        done = run(*words, program="graphtrack")
        assert character not in done.stdout + done.stderr, words
