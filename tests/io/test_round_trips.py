"""Round trips through CSV, gzip, Parquet and DataFrames."""

import tempfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from format_samples import made_tracks
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graphtrack import io
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.formats import native
from graphtrack.io.source import Source
from graphtrack.tracks.cells import numbers
from graphtrack.tracks.table import arrow_array
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import LARGEST_ID

METRES = st.floats(-1e6, 1e6, allow_subnormal=False)
ANGLES = st.floats(-np.pi, np.pi, exclude_min=True)
OPTIONAL = {
    "position_std": (st.floats(1e-6, 1e3),),
    "body": (ANGLES,),
    "head_likelihood": (st.floats(1e-9, 1.0), 12),
    "score": (st.floats(0.0, 1e6),),
    "velocity": (METRES, 2),
    "true_body": (ANGLES,),
}


@st.composite
def tracks(draw: st.DrawFn) -> TrackSet:
    """Track sets with any of the channels, any of their cells missing."""
    names = st.sampled_from([*OPTIONAL, "covariance", "inputs"])
    optional, appearance = draw(st.sets(names)), draw(st.integers(0, 11))
    ids = draw(st.lists(st.integers(-LARGEST_ID, LARGEST_ID), min_size=1, max_size=3, unique=True))
    made = []
    for identity in sorted(ids):
        n = draw(st.integers(1, 5))
        frame = np.cumsum(draw(hnp.arrays(np.int64, n, elements=st.integers(1, 1000))))
        missing = draw(hnp.arrays(bool, n))

        def channel(
            elements: st.SearchStrategy[float], *tail: int, n: int = n, missing=missing
        ) -> np.ndarray:
            values = draw(hnp.arrays(float, (n, *tail), elements=elements))
            values[missing] = np.nan
            return values

        channels = {"position": channel(METRES, 2)}
        channels |= {name: channel(*of) for name, of in OPTIONAL.items() if name in optional}
        if "covariance" in optional:
            variance = channel(st.floats(1e-6, 1e3), 6)
            covariance = np.full((n, 6, 6), np.nan)
            covariance[:, np.arange(6), np.arange(6)] = variance
            covariance[missing] = np.nan
            channels["covariance"] = covariance
        inputs = {}
        if "inputs" in optional:
            inputs = {"goal": channel(st.floats(width=64, allow_nan=False, allow_infinity=False), 2)}
            inputs["Area_2a"] = channel(METRES)
        if appearance:
            inputs["appearance"] = channel(st.floats(-1e6, 1e6), appearance)
        label = draw(st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), max_size=8))
        made.append(Track(identity, frame, frame / 7.0, **channels, label=label, inputs=inputs))
    return TrackSet(tuple(made))


def assert_same(a: TrackSet, b: TrackSet) -> None:
    assert [t.track_id for t in a] == [t.track_id for t in b]
    for one, other in zip(a, b, strict=True):
        assert one.label == other.label
        for field in fields(Track):
            x, y = getattr(one, field.name), getattr(other, field.name)
            if x is None or (isinstance(x, np.ndarray) and field.name != "position" and np.isnan(x).all()):
                assert y is None
            elif isinstance(x, np.ndarray):
                # Radians go through degrees, and variances through standard deviations.
                np.testing.assert_allclose(y, x, rtol=1e-14, atol=0.0)
        given = {name: values for name, values in one.inputs.items() if not np.isnan(values).all()}
        assert given.keys() == other.inputs.keys()
        for name, values in given.items():
            np.testing.assert_array_equal(other.inputs[name], values)


@pytest.mark.filterwarnings("ignore::graphtrack.errors.InputWarning")
@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".ndjson", ".csv.gz", ".jsonl.gz"])
@settings(max_examples=15)
@given(written=tracks())
def test_files_give_back_the_tracks(suffix: str, written: TrackSet) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"tracks{suffix}"
        io.write(written, path)
        read = io.read_identified(path)
        assert_same(written, read)
        assert_same(written, TrackSet.from_table(written.to_table()))
        assert read.summary.rows_read == read.summary.rows_used == written.n_frames
        assert [entry.name for entry in Path(folder).iterdir()] == [path.name]


CELL = st.one_of(
    st.just(""),
    st.floats(-1e6, 1e6).map(repr),
    st.integers(-1000, 1000).map(str),
    st.sampled_from(
        ["nan", "inf", "1e9999", "x", "+1", ".5", "5.", " 1 ", '"2"', "1_0", "0x1", "NA", "null"]
    ),
)


@settings(max_examples=100)
@given(st.lists(st.tuples(CELL, CELL), min_size=1, max_size=6), st.sampled_from(["\n", "\r\n", "\n\n"]))
def test_the_fast_reader_of_csv_agrees_with_the_slow_one(rows: list[tuple[str, str]], end: str) -> None:
    text = end.join(["track_id,x,other", *(f"1,{a},{b}" for a, b in rows)])
    source = Source(Path("table.csv"), text.encode())

    def read(small: int) -> np.ndarray | tuple[str, int | None]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(native, "_SMALL", small)
            cells = native.read_csv(source)
        try:
            assert len(numbers(cells, "track_id")) == len(rows)
            return numbers(cells, "x")
        except InputError as error:
            return error.found, error.line

    np.testing.assert_equal(read(0), read(10**9))


def test_the_fast_reader_reads_wide_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "wide.csv"
    path.write_text("t,a.x,a.y,b.x,b.y\n0,1,2,,\n1,3,4,5,6\n")
    columns = {"t": "t", "x": "*.x", "y": "*.y"}
    slow = io.read_identified(path, columns=columns)
    monkeypatch.setattr(native, "_SMALL", 0)
    assert_same(slow, io.read_identified(path, columns=columns))


def test_pixels_become_metres_by_a_homography(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("track_id,frame,t,u,v\n1,0,0,100,200\n1,1,1,110,200\n1,2,2,110,-2000\n1,3,3,,\n")
    homography = np.array([[0.01, 0.0, 0.0], [0.0, -0.01, 0.0], [0.0, 0.001, 1.0]])
    tracks = io.read_identified(path, homography=homography)
    assert tracks.summary.refused == {"at or beyond the camera's horizon": 1}
    np.testing.assert_allclose(tracks.by_id(1).position[:2], np.array([[1.0, -2.0], [1.1, -2.0]]) / 1.2)
    assert np.isnan(tracks.by_id(1).position[2]).all()
    np.testing.assert_array_equal(tracks.by_id(1).pixel[:2], [[100, 200], [110, 200]])
    assert tracks.camera == GroundCamera.from_homography(homography)


def test_several_files_are_merged_under_ids_of_their_own(tmp_path: Path) -> None:
    plain = made_tracks().map(lambda track: replace(track, label=""))
    for name in ("first", "second"):
        io.write(plain, tmp_path / f"{name}.csv.gz")
    merged = io.read_identified([tmp_path / "first.csv.gz", tmp_path / "second.csv.gz"])
    assert [track.label for track in merged] == ["first", "first", "second", "second"]
    assert len({track.track_id for track in merged}) == 4
    assert merged.summary.rows_used == 2 * plain.n_frames
    assert any("renumbered" in note for note in merged.summary.notes)


@pytest.mark.parametrize("with_camera", [False, True])
def test_mot_text_gives_back_positions(with_camera: bool, tmp_path: Path) -> None:
    camera = GroundCamera.from_homography(np.array([[0.02, 0, -5], [0, -0.02, 30], [0, 0.002, 0.2]]))
    path = tmp_path / "made.txt"
    written = replace(made_tracks(), camera=camera if with_camera else None)
    io.write(written, path)
    read = io.read_identified(path)
    for one, other in zip(written, read, strict=True):
        seen = np.isfinite(one.position).all(axis=1)
        np.testing.assert_array_equal(other.frame, one.frame[seen])
        np.testing.assert_array_equal(other.position, one.position[seen])
        if with_camera:
            np.testing.assert_allclose(other.pixel, camera.ground_to_image(other.position), atol=2e-3)
        else:
            assert other.pixel is None
    io.write(made_tracks(), path, homography=np.diag([0.01, -0.01, 1.0]))
    np.testing.assert_allclose(np.loadtxt(path, delimiter=",")[:, 5], 170.0)


@pytest.mark.parametrize(
    "values",
    [
        np.array([1.5, np.nan, -0.0, np.inf]),
        np.arange(20.0)[::2],
        np.array([3, -(2**62)]),
        np.array(["Zoë", None, ""], dtype=object),
        np.array([], dtype=object),
        np.array(["2026-01-01", "NaT"], dtype="datetime64[us]"),
        np.array([True, False]),
    ],
)
def test_columns_are_what_pyarrow_makes_of_them(values: np.ndarray) -> None:
    found, expected = arrow_array(values), pa.array(values, from_pandas=True)
    found.validate(full=True)
    assert found.type == expected.type and found.equals(expected)


def test_writing_to_places_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "folder.csv", tmp_path / "absent" / "a.csv", tmp_path / "file" / "a.csv"):
        with pytest.raises(InputError):
            io.write(made_tracks(), path)
    for path, format in ((tmp_path / "a.xyz", None), (tmp_path / "a.txt", "eth")):
        with pytest.raises(InputError):
            io.write(made_tracks(), path, format=format)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "folder.csv"]
