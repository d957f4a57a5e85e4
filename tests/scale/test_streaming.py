"""Data sets smoothed track by track: the bytes of the in-memory result, whatever the layout of the input."""

import json
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from selection import others_slow
from walks import walk, without

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.scale import dataset as writer
from graphtrack.scale import open_dataset, smooth_dataset


def people(n: int = 12) -> gt.TrackSet:
    """Tracks of several lengths and kinds of observation; one has a label, one no truth."""
    rng = np.random.default_rng(3)
    tracks = [
        walk(int(rng.integers(1, 60)), seed=k, classes=k % 3 == 0, uneven=k % 2 == 0, track_id=7 * k - 20)
        for k in range(n)
    ]
    tracks[1] = replace(tracks[1], label="square")
    tracks[2] = replace(tracks[2], true_position=None, true_body=None, true_head=None)
    return gt.TrackSet(tuple(tracks))


def in_memory(path: Path, output: Path, model: str, constants: Literal["default"] | None = None) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gt.InputWarning)
        gt.write(gt.smooth(gt.read(path), model, constants=constants), output)
    return output


@pytest.fixture(scope="module")
def table(tmp_path_factory) -> pd.DataFrame:
    path = tmp_path_factory.mktemp("table") / "table.parquet"
    gt.write(people(), path)
    return pd.read_parquet(path)


def shuffled(table: pd.DataFrame) -> pd.DataFrame:
    return table.sample(frac=1.0, random_state=1)


LAYOUTS = {
    "by track": lambda table: table,
    "by frame": lambda table: table.sort_values(["frame", "track_id"], kind="stable"),
    "in any order": shuffled,
}
SIZES = (1, 50, 100_000)


@pytest.mark.parametrize(
    ("model", "layout", "batch_frames"),
    others_slow(
        [(model, one, size) for model in ("position", "joint") for one in LAYOUTS for size in SIZES],
        [
            *(("position", layout, size) for layout, size in zip(LAYOUTS, SIZES, strict=True)),
            *(("joint", layout, size) for layout, size in zip(LAYOUTS, (*SIZES[1:], 1), strict=True)),
        ],
    ),
)
def test_the_bytes_of_the_in_memory_result(table, layout, batch_frames, model, tmp_path, monkeypatch):
    # Small row groups and blocks, so that tracks span them on both sides.
    monkeypatch.setattr("graphtrack.io.formats.native.ROW_GROUP", 64)
    monkeypatch.setattr(writer, "ROW_GROUP", 64)
    monkeypatch.setattr("graphtrack.scale.dataset.BLOCK", 17)
    path = tmp_path / "in.parquet"
    LAYOUTS[layout](table).to_parquet(path, index=False, row_group_size=23)
    expected = in_memory(path, tmp_path / "expected.parquet", model, "default")
    done: list[int] = []
    options = {"batch_frames": batch_frames, "constants": "default", "progress": done.append}
    outcome = smooth_dataset(path, tmp_path / "out.parquet", model, **options)
    assert (tmp_path / "out.parquet").read_bytes() == expected.read_bytes()
    assert pq.ParquetFile(expected).num_row_groups > 3
    assert outcome.n_smoothed == 12 and outcome.n_frames == sum(done) == len(table)
    of_input = tuple(note for note in outcome.notes if not note.startswith("not used by"))
    assert of_input == gt.read(path).summary.notes
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.slow
def test_well_known_names_are_read_and_written_as_of_one_file(table, tmp_path):
    named = table.rename(columns={"track_id": "ped_id", "t": "time", "x": "pos_x", "y": "pos_y"})
    folder = tmp_path / "data"
    folder.mkdir()
    half = len(named) // 2
    for k, part in enumerate((named[:half], named[half:])):
        part.to_parquet(folder / f"{k}.parquet")
    named.to_parquet(tmp_path / "whole.parquet")
    outcome = smooth_dataset(folder, tmp_path / "streamed.parquet", "joint")
    expected = in_memory(tmp_path / "whole.parquet", tmp_path / "expected.parquet", "joint")
    assert (tmp_path / "streamed.parquet").read_bytes() == expected.read_bytes()
    assert {"ped_id", "time", "pos_x", "pos_y"} <= set(pq.read_schema(expected).names)
    assert outcome.notes[0] == "read columns 'ped_id' as track_id, 'time' as t, 'pos_x' as x, 'pos_y' as y"
    assert not any("ignored" in note for note in outcome.notes)
    for name in ("time_ms", "pos_x_cm"):
        table.rename(
            columns={"t": "time_ms"} if name == "time_ms" else {"x": name, "y": "pos_y_cm"}
        ).to_parquet(tmp_path / "unit.parquet")
        with pytest.raises(InputError, match=f"column {name} when streaming.*--no-stream"):
            open_dataset(tmp_path / "unit.parquet")


@pytest.mark.slow
def test_a_folder_is_one_table_and_its_files_may_have_different_columns(table, tmp_path):
    whole = tmp_path / "whole.parquet"
    table.to_parquet(whole, index=False)
    folder = tmp_path / "parts"
    for track_id, rows in table.groupby("track_id"):
        part = folder / f"track_id={track_id}"
        part.mkdir(parents=True)
        rows.dropna(axis=1, how="all").drop(columns="track_id").to_parquet(part / "rows.parquet", index=False)
    (folder / "_SUCCESS").touch()
    expected = in_memory(whole, tmp_path / "expected.parquet", "joint")
    smooth_dataset(folder, tmp_path / "out.parquet", "joint")
    assert (tmp_path / "out.parquet").read_bytes() == expected.read_bytes()


def test_a_foreign_folder_key_may_not_split_a_track(table, tmp_path):
    for scene, rows in (("north", table.iloc[:200]), ("south", table.iloc[200:])):
        (tmp_path / "parts" / f"scene={scene}").mkdir(parents=True)
        rows.to_parquet(tmp_path / "parts" / f"scene={scene}" / "rows.parquet", index=False)
    split = table.track_id.iloc[199]
    assert table.track_id.iloc[200] == split
    with pytest.raises(InputError, match=f"track {split} in scene=north and in scene=south"):
        smooth_dataset(tmp_path / "parts", tmp_path / "out.parquet")
    whole = table[table.track_id != split]
    for scene, rows in (("north", whole.iloc[:150]), ("south", whole[whole.track_id > split])):
        rows = rows[rows.track_id < split] if scene == "north" else rows
        rows.to_parquet(tmp_path / "parts" / f"scene={scene}" / "rows.parquet", index=False)
    outcome = smooth_dataset(tmp_path / "parts", tmp_path / "out.parquet")
    assert "ignored columns scene" in outcome.notes


def test_failed_tracks_are_named_and_the_rest_is_what_comes_without_them(tmp_path):
    good = [walk(20, seed=k, track_id=k) for k in (1, 3)]
    good = [replace(track, true_position=None, true_body=None, true_head=None) for track in good]
    # Only the track that fails has truth, so the columns of the truth must go too.
    bad = without(walk(20, seed=2, track_id=2), "position", slice(None))
    gt.write(gt.TrackSet((good[0], bad, good[1])), tmp_path / "in.parquet")
    gt.write(gt.smooth(gt.TrackSet(tuple(good))), tmp_path / "expected.parquet")
    outcome = smooth_dataset(tmp_path / "in.parquet", tmp_path / "out.parquet", batch_frames=20)
    assert [failure.track_id for failure in outcome.failures] == [2]
    assert "position" in outcome.failures[0].reason
    assert (outcome.n_tracks, outcome.n_smoothed, outcome.n_frames) == (3, 2, 40)
    found = pd.read_parquet(tmp_path / "out.parquet")
    expected = pd.read_parquet(tmp_path / "expected.parquet")
    pd.testing.assert_frame_equal(found, expected, rtol=1e-12)
    gt.write(gt.TrackSet((bad,)), tmp_path / "bad.parquet")
    outcome = smooth_dataset(tmp_path / "bad.parquet", tmp_path / "nothing.parquet")
    assert outcome.n_smoothed == 0 and len(outcome.failures) == 1
    assert not (tmp_path / "nothing.parquet").exists()


@pytest.mark.parametrize(
    ("column", "value"),
    [("track_id", 1.5), ("track_id", np.nan), ("frame", 0.5), ("x", 1e12), ("x", np.inf), ("t", np.nan)],
)
def test_a_bad_value_is_told_with_its_file_row_and_column_and_nothing_is_left(table, column, value, tmp_path):
    folder, old = tmp_path / "parts", tmp_path / "out.parquet"
    folder.mkdir()
    rows = shuffled(table).astype({column: float})
    rows.iloc[:100].to_parquet(folder / "a.parquet", index=False)
    rows.iloc[141, rows.columns.get_loc(column)] = value
    rows.iloc[100:].to_parquet(folder / "b.parquet", index=False)
    old.write_text("old")
    with pytest.raises(InputError) as told:
        smooth_dataset(folder, old, batch_frames=40)
    assert (told.value.path, told.value.line, told.value.column) == (str(folder / "b.parquet"), 42, column)
    assert old.read_text() == "old"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["out.parquet", "parts"]


def test_what_is_not_a_data_set(table, tmp_path):
    def refused(path: Path, words: str) -> None:
        with pytest.raises(InputError, match=words):
            smooth_dataset(path, tmp_path / "out.parquet")

    refused(tmp_path / "absent", "no such file")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "without Parquet files")
    (tmp_path / "empty" / "notes.csv").write_text("x")
    refused(tmp_path / "empty", "file of another kind")
    (tmp_path / "text.parquet").write_text("track_id,frame")
    refused(tmp_path / "text.parquet", "damaged Parquet")
    table.to_parquet(tmp_path / "whole.parquet", index=False)
    (tmp_path / "cut.parquet").write_bytes((tmp_path / "whole.parquet").read_bytes()[:-100])
    refused(tmp_path / "cut.parquet", "damaged Parquet")
    for missing, words in (("t", "a column t"), ("y", "a column y next to x"), ("frame", "a column frame")):
        table.drop(columns=missing).to_parquet(tmp_path / "less.parquet", index=False)
        refused(tmp_path / "less.parquet", words)
    pixels = table.rename(columns={"x": "u", "y": "v"})
    pixels.to_parquet(tmp_path / "pixels.parquet", index=False)
    refused(tmp_path / "pixels.parquet", "pixels u, v without x, y")
    table.iloc[:0].to_parquet(tmp_path / "none.parquet", index=False)
    refused(tmp_path / "none.parquet", "no rows")
    text = table.assign(x="here")
    text.to_parquet(tmp_path / "text.parquet", index=False)
    refused(tmp_path / "text.parquet", "column x: found .here., expected a finite number")
    table.assign(t=pd.to_datetime(table.t, unit="s", utc=True)).to_parquet(tmp_path / "dates.parquet")
    refused(tmp_path / "dates.parquet", "--no-stream")
    assert not (tmp_path / "out.parquet").exists()


MEASURED = """
import json, resource, sys
from graphtrack.scale import smooth_dataset
smooth_dataset(sys.argv[1], sys.argv[2], "position", batch_frames=10_000)
print(json.dumps(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss))
"""


def peak_megabytes(n_tracks: int, folder: Path) -> float:
    """Peak memory of smoothing tracks of 250 frames, interleaved by frame, all in one row group."""
    path, length = folder / f"{n_tracks}.parquet", 250
    frame = np.repeat(np.arange(length), n_tracks)
    rng = np.random.default_rng(0)
    columns = {"track_id": np.tile(np.arange(n_tracks), length), "frame": frame, "t": frame / 10.0}
    columns |= {name: frame / 8.0 + rng.normal(0.0, 0.05, len(frame)) for name in ("x", "y")}
    pq.write_table(pa.table(columns), path, row_group_size=len(frame))
    # A process starts with the peak of the one that started it: a small shell stands between.
    arguments = ["sh", "-c", '"$@" && true', "sh", sys.executable, "-c", MEASURED, path]
    arguments.append(folder / f"{n_tracks}.out.parquet")
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=600, check=True)
    assert pq.ParquetFile(folder / f"{n_tracks}.out.parquet").metadata.num_rows == len(frame)
    return json.loads(done.stdout) / 1024.0


@pytest.mark.slow
def test_memory_does_not_grow_with_the_data(tmp_path):
    # Both exceed the size of full buffers; the remaining variation is some 30 MB from run to run.
    small, large = 1600, 6400
    before, after = peak_megabytes(small, tmp_path), peak_megabytes(large, tmp_path)
    covariances = (large - small) * 250 * 36 * 8 / 2**20
    assert after - before < 0.25 * covariances
