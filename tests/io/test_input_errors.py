"""Every bad input gives one `InputError` that names the place."""

import gzip
import os
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from format_samples import SAMPLES, TEXT_SAMPLES, Sample, name_of, sample_of
from refusals import refused

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputError, InputWarning
from graphtrack.interaction.group_files import read_groups
from graphtrack.interaction.people import read_places
from graphtrack.interaction.tables import read_gaze
from graphtrack.tracks.validation import LARGEST_ID

DELIMITED = tuple(sample for sample in TEXT_SAMPLES if sample.format != "caviar")


def line_with(data: bytes, fragment: bytes) -> int:
    return data.count(b"\n", 0, data.index(fragment)) + 1


@pytest.mark.parametrize("sample", SAMPLES, ids=name_of)
def test_missing_empty_binary_and_odd_paths(sample: Sample, tmp_path: Path) -> None:
    path = tmp_path / Path(sample.name).name
    assert refused(path, format=sample.format).path == str(path)
    assert "directory" in str(refused(tmp_path, format=sample.format))
    path.write_bytes(b"")
    assert "empty" in str(refused(path, format=sample.format))
    for text in (b"\n\n  \n", b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20):
        path.write_bytes(text)
        assert refused(path, format=sample.format).path == refused(path).path == str(path)
    assert "device" in str(refused(Path("/dev/zero")))
    assert refused(tmp_path / "null\0byte").expected == "a readable file"


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission(tmp_path: Path) -> None:
    path = sample_of("mot").write(tmp_path)
    path.chmod(0)
    assert "permission" in str(refused(path))


@pytest.mark.parametrize("sample", TEXT_SAMPLES, ids=name_of)
def test_what_is_no_finite_number(sample: Sample, tmp_path: Path) -> None:
    path = sample.write(tmp_path)
    data, number = path.read_bytes(), re.search(rb"[\d.]+", sample.number)
    assert number
    words = () if sample.format in ("csv", "ndjson") else ("nan", "NaN")  # empty cells of a table
    for text in (*words, "inf", "-Infinity", "abc", "1_0", "0x10", "1e999", "\u0663"):
        worse = sample.number.replace(number[0], text.encode(), 1)
        path.write_bytes(data.replace(sample.number, worse, 1))
        error = refused(path)
        assert error.line == line_with(data, sample.number) and error.column is not None
        assert repr(text) in error.found


@pytest.mark.parametrize(
    "sample", [s for s in DELIMITED if s.format not in ("ndjson", "trajnet")], ids=name_of
)
def test_rows_of_another_width(sample: Sample, tmp_path: Path) -> None:
    path = sample.write(tmp_path)
    lines = path.read_bytes().split(b"\n")
    mark = b"," if b"," in lines[3].split()[0] else b" "
    cells = lines[3].split(mark)
    for worse in (mark.join([b"1", b"1", *cells]), mark.join(cells[:2])):
        path.write_bytes(b"\n".join([*lines[:3], worse, *lines[4:]]))
        error = refused(path)
        assert error.line == 4 and "columns" in error.found


@pytest.mark.parametrize("sample", DELIMITED, ids=name_of)
def test_the_same_row_twice(sample: Sample, tmp_path: Path) -> None:
    path = sample.write(tmp_path)
    lines = path.read_bytes().rstrip().split(b"\n")
    path.write_bytes(b"\n".join([*lines, lines[-2], b""]))
    error = refused(path)
    if sample.format == "ucy":  # a control point beyond the number that was announced
        assert "end of the file" in error.expected
    else:
        assert error.line == len(lines) + 1


@pytest.mark.parametrize("sample", TEXT_SAMPLES, ids=name_of)
def test_encodings_and_gzip(sample: Sample, tmp_path: Path) -> None:
    path = sample.write(tmp_path)
    data = path.read_bytes()
    plain = io.read_identified(path, **sample.options)
    path.write_bytes(b"\xef\xbb\xbf" + data)
    assert io.read_identified(path, **sample.options).n_frames == plain.n_frames
    path.write_bytes(data.replace(b"\n", b"\r\n"))
    assert io.read_identified(path, **sample.options).n_frames == plain.n_frames
    packed = gzip.compress(data)
    path.write_bytes(packed)
    assert io.read_identified(path, **sample.options).n_frames == plain.n_frames
    for damaged in (packed[: len(packed) // 2], packed[:-6] + bytes([packed[-6] ^ 1]) + packed[-5:]):
        path.write_bytes(damaged)
        assert "gzip" in refused(path).found
    if sample.format != "caviar":  # XML declares its encoding itself, and UTF-16 is one of them
        path.write_bytes(data.decode().encode("utf-16"))
        assert io.read_identified(path, **sample.options).n_frames == plain.n_frames
        path.write_bytes(data.decode().encode("utf-16-be"))
        error = refused(path, format=sample.format)
        assert error.found == "UTF-16 text" and "--encoding" in error.expected
        path.write_bytes(data[:-1] + b"\xe9\n")
        assert refused(path, format=sample.format).found == "the byte 0xe9"


FRAME_AND_ID = {
    "csv": (r"^3,10,", "{id},{frame},"),
    "mot": (r"^1,1,", "{frame},{id},"),
    "towncentre": (r"^0,1,", "{frame},{id},"),
    "eth": (r"^1.0000000e\+00 1.0000000e\+00 ", "{frame} {id} "),
    "kitti": (r"^0 1 ", "{frame} {id} "),
}


@pytest.mark.parametrize("format", FRAME_AND_ID)
def test_absurd_frames_and_ids(format: str, tmp_path: Path) -> None:
    path = sample_of(format).write(tmp_path)
    pattern, row = FRAME_AND_ID[format]
    text = path.read_text()
    for frame, identity in (("1e300", 1), ("2.5", 1), (1, "1e300"), (1, "1.5"), ("4000000000", 1)):
        new = row.format(frame=frame, id=identity)
        worse, count = re.subn(pattern, new, text, count=1, flags=re.MULTILINE)
        assert count == 1
        path.write_text(worse)
        error = refused(path)
        assert "whole number" in error.expected
        assert error.line is not None and error.column in ("frame", "id", "track_id")


@pytest.mark.parametrize("sample", [s for s in SAMPLES if s.format in ("mot", "towncentre")], ids=name_of)
@pytest.mark.parametrize("size", ["0", "-5"])
def test_boxes_without_a_size(sample: Sample, size: str, tmp_path: Path) -> None:
    path = sample.write(tmp_path)
    cells = path.read_text().split(",")
    cells[4] = size
    path.write_text(",".join(cells))
    error = refused(path)
    assert (error.line, error.column) == (1, "width")


@pytest.mark.parametrize("format", ["csv", "mot", "towncentre", "eth"])
def test_frames_out_of_order_are_sorted_with_a_warning(format: str, tmp_path: Path) -> None:
    sample = sample_of(format)
    path = sample.write(tmp_path)
    in_order = io.read_identified(path)
    lines = path.read_bytes().rstrip().split(b"\n")
    header = 1 if format == "csv" else 0
    path.write_bytes(b"\n".join([*lines[:header], *reversed(lines[header:])]) + b"\n")
    with pytest.warns(InputWarning, match="out of order"):
        backwards = io.read_identified(path)
    assert any("out of order" in note for note in backwards.summary.notes)
    for a, b in zip(in_order, backwards, strict=True):
        np.testing.assert_array_equal(a.frame, b.frame)
        np.testing.assert_array_equal(a.position, b.position)


XML_ATTACKS = {
    "laughs": '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><dataset>&b;</dataset>',
    "external": '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///secret">]><dataset>&a;</dataset>',
    "document type": '<!DOCTYPE dataset SYSTEM "http://localhost/x.dtd"><dataset/>',
}


@pytest.mark.parametrize("attack", XML_ATTACKS.values(), ids=XML_ATTACKS)
def test_xml_with_entities_or_a_document_type_is_refused(attack: str, tmp_path: Path) -> None:
    path = tmp_path / "attack.xml"
    path.write_text('<?xml version="1.0"?>' + attack)
    assert "document type or entity" in refused(path).found


def test_damaged_xml_names_its_line(tmp_path: Path) -> None:
    path = sample_of("caviar").write(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:-4]))
    assert refused(path).line == len(lines) - 4
    path.write_text("<dataset></dataset>")
    assert "no objects" in refused(path).found


CAMERAS = {
    "singular": ("homography", "1 2 3\n2 4 6\n0 0 1\n", "singular"),
    "two rows": ("homography", "1 0 0\n0 1 0\n", "6 numbers"),
    "no number": ("homography", "1 0 0\n0 1 0\n0 0 nan\n", "nan"),
    "two columns": ("homography", "1 0\n0 1\n", "2 columns"),
    "three pairs": ("point_pairs", "0 0 0 0\n1 0 1 0\n1 1 1 1\n", "3 point pairs"),
    "a line": ("point_pairs", "0 0 0 0\n1 1 1 1\n2 2 2 2\n3 3 3 3\n", "line"),
    "one point": ("point_pairs", "0 0 0 0\n0 0 0 0\n0 0 0 0\n0 0 0 0\n", "identical points"),
    "three on a line": ("point_pairs", "0 0 0 0\n1 0 1 0\n2 0 2 0\n0 1 0 1\n", "line"),
    "three numbers": ("point_pairs", "0 0 0\n", "3 columns"),
}


@pytest.mark.parametrize(("option", "text", "found"), CAMERAS.values(), ids=CAMERAS)
def test_files_that_make_no_camera(option: str, text: str, found: str, tmp_path: Path) -> None:
    path, camera = sample_of("mot").write(tmp_path), tmp_path / "camera.txt"
    camera.write_text("# u v X Y\n" + text)
    error = refused(path, **{option: camera})
    assert found in error.found and error.path == str(camera)


@pytest.mark.parametrize("sample", [s for s in SAMPLES if s.format in ("ucy", "kitti")], ids=name_of)
def test_a_missing_companion_is_named(sample: Sample, tmp_path: Path) -> None:
    path = sample.write(tmp_path)
    for name in sample.beside:
        content = (tmp_path / name).read_bytes()
        (tmp_path / name).unlink()
        error = refused(path)
        assert Path(name).name in str(error)
        (tmp_path / name).write_bytes(content)


def test_ego_poses_that_do_not_reach_a_frame(tmp_path: Path) -> None:
    path = sample_of("kitti").write(tmp_path)
    oxts = tmp_path / "oxts/0001.txt"
    oxts.write_text("".join(oxts.read_text().splitlines(keepends=True)[:3]))
    error = refused(path)
    assert error.column == "frame" and error.line == line_with(path.read_bytes(), b"\n3 1 ") + 1


BAD_NATIVE = {
    "no frame": ("track_id,x,y,t\n1,0,0,0\n", "frame", None),
    "no position": ("track_id,frame,t\n1,0,0\n", None, None),
    "x without y": ("track_id,frame,x,t\n1,0,0,0\n", "y", None),
    "no time": ("track_id,frame,x,y\n1,0,0,0\n", "t", None),
    "empty id": ("track_id,frame,t,x,y\n,0,0,0,0\n", "track_id", 2),
    "empty time": ("track_id,frame,t,x,y\n1,0,0,0,0\n\n1,1,,0,0\n", "t", 4),
    "time goes back": ("track_id,frame,t,x,y\n1,0,5,0,0\n1,1,4,0,0\n", "t", 3),
    "zero spread": ("track_id,frame,t,x,y,pos_std\n1,0,5,0,0,0\n", "pos_std", 2),
    "negative score": ("track_id,frame,t,x,y,score\n-1,0,5,0,0,-0.5\n", "score", 2),
    "half an appearance": (
        "track_id,frame,t,x,y,appearance_0,appearance_1\n-1,0,5,0,0,1,\n",
        "appearance_1",
        2,
    ),
    "negative kappa": ("track_id,frame,t,x,y,body_kappa\n1,0,5,0,0,-1\n", "body_kappa", 2),
    "far away": ("track_id,frame,t,x,y\n1,0,5,1e30,0\n", "x", 2),
    "classes missing": ("track_id,frame,t,x,y,body_p0\n1,0,5,0,0,1\n", "body_p1", None),
    "column twice": ("track_id,frame,t,x,y,x\n1,0,5,0,0,1\n", None, 1),
    "header only": ("track_id,frame,t,x,y\n", None, None),
    "pixels only": ("track_id,frame,t,u,v\n1,0,0,5,5\n", None, None),
    "two labels": ("track_id,frame,t,x,y,label\n1,0,0,5,5,a\n1,1,1,5,5,b\n", "label", 3),
}


@pytest.mark.parametrize(("text", "column", "line"), BAD_NATIVE.values(), ids=BAD_NATIVE)
def test_native_tables(text: str, column: str | None, line: int | None, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    error = refused(path)
    assert error.column == column and error.line == line


def test_options_that_do_not_exist_or_make_no_sense(tmp_path: Path) -> None:
    path = sample_of("mot").write(tmp_path)
    (tmp_path / "gt.txt").write_text("1,1,10,20,30,40,0,1,1\n1,2,10,20,30,40,1,3,1\n")
    assert "1 marked to be ignored" in refused(tmp_path / "gt.txt").found
    assert "fsp" in refused(path, fsp=25).found and "fps" in refused(path, fps=0.0).found
    assert "fps" in refused(path, fps=float("nan")).found
    assert "nonsense" in refused(path, format="nonsense").found
    with pytest.raises(InputError):
        io.read_identified([])


TOO_LARGE = [2**53, 2**53 + 1, -(2**53), -(2**53) - 1, 2**62, 2**63 + 2**53]


def rows(identity: int, n: int = 3) -> pd.DataFrame:
    k = np.arange(n)
    return pd.DataFrame({"track_id": identity, "frame": k, "t": k / 10, "x": 0.1 * k, "y": 0.0})


def csv(identity: int, folder: Path, n: int = 3) -> gt.TrackSet:
    text = rows(0, n).to_csv(index=False).replace("\n0,", f"\n{identity},")
    (folder / "a.csv").write_text(text)
    return io.read_identified(folder / "a.csv")


def parquet(identity: int, folder: Path) -> gt.TrackSet:
    rows(identity).to_parquet(folder / "a.parquet")
    return io.read_identified(folder / "a.parquet")


def table(identity: int, folder: Path) -> gt.TrackSet:
    return gt.TrackSet.from_table(rows(identity))


def other(format: str, before: str, after: str) -> Callable[[int, Path], gt.TrackSet]:
    """A sample of a format with the id of its first rows in place of 1."""

    def read(identity: int, folder: Path) -> gt.TrackSet:
        path = sample_of(format).write(folder)
        path.write_text(path.read_text().replace(before, after.format(identity), 1))
        return io.read_identified(path)

    return read


READERS = {
    "csv": csv,
    "long csv": partial(csv, n=10_000),  # pyarrow reads it
    "parquet": parquet,
    "table": table,
    "mot": other("mot", "1,1,", "1,{},"),
    "eth": other("eth", "1.0000000e+00 1.0000000e+00", "1.0000000e+00 {}"),
    "towncentre": other("towncentre", "0,1,", "0,{},"),
    "kitti": other("kitti", "0 1 Ped", "0 {} Ped"),
    "caviar": other("caviar", 'object id="0"', 'object id="{}"'),
}


@pytest.mark.parametrize("reader", READERS)
def test_the_largest_identity_is_itself_and_larger_ones_are_refused(reader: str, tmp_path: Path) -> None:
    assert LARGEST_ID in {track.track_id for track in READERS[reader](LARGEST_ID, tmp_path)}
    for identity in TOO_LARGE:
        with pytest.raises(InputError, match="id") as caught:
            READERS[reader](identity, tmp_path)
        assert caught.value.line is not None


def test_files_with_the_largest_identities_are_merged_into_one_that_can_be_read(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        pd.concat([rows(0), rows(LARGEST_ID)]).to_csv(tmp_path / name, index=False)
    merged = io.read_identified([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert len({track.track_id for track in merged}) == 4
    io.write(merged, tmp_path / "merged.csv")
    assert {track.track_id for track in io.read_identified(tmp_path / "merged.csv")} == {
        t.track_id for t in merged
    }


SMALL_TABLES = [
    (read_groups, "0.0 < ID_001 ID_x >\n", "line 1: found 'ID_x', expected the id of a person"),
    (read_groups, "0.0 < ID_001 >\n0.0 < ID_001 >\n", "line 2: found 0, expected a time after"),
    (read_groups, "1 2\n2 3\n", "line 2: found person 2 in a second group"),
    (read_groups, "frame,track_id,group\n0,1,0\n0,1,1\n", "line 3: found person 1 twice in frame 0"),
    (read_groups, "frame,track_id,group\n0,1,1.5\n", "line 2, column group: found '1.5'"),
    (read_groups, "\n", "expected groups"),
    (read_places, "name,x,y,radius\na,0,0,\n", "line 2: found place 'a' with neither radius nor polygon"),
    (read_places, "name,x,y,radius\na,0,0,0\n", "line 2, column radius: found 0, expected metres above 0"),
    (read_places, "name,x,y,radius\na,0,0,1\na,1,0,1\n", "line 3, column name: found the name 'a' again"),
    (read_places, "name,polygon\na,0 0 1 1\n", "found 4 numbers, expected x y of three corners or more"),
    (read_places, "name,x,y,radius\na,q,0,1\n", "line 2, column x: found 'q'"),
    (read_places, "name,x,y\na,0,0\n", "expected name and x, y, radius, or name and polygon"),
    (read_gaze, "frame,track_id\n1,1\n", "no column target"),
    (
        read_gaze,
        "frame,track_id,target\n1,1,1\n",
        "line 2, column target: found '1', expected another person",
    ),
    (
        read_gaze,
        "frame,track_id,target\n1,1,-2\n",
        "line 2, column target: found '-2', expected an id, the name of a place, or -1",
    ),
    (
        read_gaze,
        "frame,track_id,target\n1,1,0.5\n",
        "line 2, column target: found '0.5', expected a whole number",
    ),
    (read_gaze, "frame,track_id,target\n1,1,2\n1,1,3\n", "line 3"),
]


@pytest.mark.parametrize(("reader", "text", "message"), SMALL_TABLES)
def test_tables_of_groups_places_and_looks_are_refused_by_their_line(
    reader: Callable[[Path], object], text: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "table.txt"
    path.write_text(text)
    with pytest.raises(InputError) as told:
        reader(path)
    assert message in str(told.value)
