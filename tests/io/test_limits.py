"""Files that claim more than they hold are refused before the memory is taken."""

import json
import sqlite3
import zipfile
import zlib
from pathlib import Path
from struct import pack

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from refusals import refused

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.io.formats.ros.bag import open_bag
from graphtrack.limits import LARGEST, RATIO_FROM, MemoryLimit
from graphtrack.model import Model
from graphtrack.tracks.gaps import filled, gaps_without_time
from perception.images.frames import FrameSource, read_image
from perception.storage import load_model

ROWS = 50_000_000


def over_the_limit(path: Path, **options: object) -> str:
    """Return the message for a file that is refused because of its size, and names the option."""
    error = refused(path, **options)
    assert error.path == str(path) and "--max-memory" in error.expected
    return error.found


def test_the_limit_of_a_file() -> None:
    small = MemoryLimit(Path("a"), 1000)
    small.check(RATIO_FROM, "content")
    with pytest.raises(InputError, match="more than 200 times its size"):
        small.check(RATIO_FROM + 1, "content")
    assert MemoryLimit(Path("a"), 2**40).most == MemoryLimit(Path("a")).most == LARGEST
    assert MemoryLimit(Path("a"), 1000, 0.5).most == 2**29


def parquet(path: Path, **columns: pa.Array) -> Path:
    n = len(next(iter(columns.values())))
    given = {name: pa.array(np.arange(n)) for name in ("frame", "t") if name not in columns}
    zeros = {name: pa.array(np.zeros(n)) for name in ("track_id", "x", "y") if name not in columns}
    table = pa.table({**given, **zeros, **columns})
    pq.write_table(table, path, compression="zstd", store_schema=False)
    return path


def test_parquet_rows_that_are_runs_of_one_value(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    with pq.ParquetWriter(path, pa.schema([(name, pa.int32()) for name in ("track_id", "frame")])) as file:
        zeros = pa.array(np.zeros(ROWS // 10, np.int32))
        for _ in range(10):
            file.write_table(pa.table([zeros, zeros], names=["track_id", "frame"]))
    assert "columns of 50000000 rows" in over_the_limit(path, fps=10.0)


def test_parquet_text_is_read_once_for_each_value(tmp_path: Path) -> None:
    n = 2000
    label = pa.DictionaryArray.from_arrays(pa.array(np.zeros(n, np.int32)), pa.array(["a" * 2**20]))
    path = parquet(tmp_path / "a.parquet", label=label, frame=pa.array(np.arange(n)))
    assert path.stat().st_size < 10**6
    tracks = gt.read(path, fps=10.0)
    assert len(tracks.tracks[0].label) == 2**20


def test_netcdf_arrays_that_are_not_stored(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.nc"
    with h5py.File(path, "w") as file:
        file.create_dataset("position", (ROWS, 2), "i1", chunks=(2**18, 2), fillvalue=0)
    assert path.stat().st_size < 10_000 and "arrays of 763 MiB" in over_the_limit(path)
    # The option raises the limit: it is read, and then refused for what it lacks.
    with h5py.File(path, "w") as file:
        file.create_dataset("position", (10**7, 2), "i1", chunks=(2**18, 2), fillvalue=0)
    over_the_limit(path)
    assert "--max-memory" not in refused(path, max_memory=1.0).expected


def test_a_new_key_in_every_row(tmp_path: Path) -> None:
    path = tmp_path / "a.ndjson"
    rows = ({"track_id": 1, "frame": k, "t": k, "x": 0, "y": 0, f"input_a{k}_b": 1} for k in range(20_000))
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert "20000 rows with one of 20005 keys" in over_the_limit(path)


ENDLESS = (
    "WITH RECURSIVE c(k) AS (SELECT 0 UNION ALL SELECT k+1 FROM c) SELECT k AS frame, 1 AS id, 0.0 AS pos_x"
)
TABLE = "CREATE TABLE trajectory_data(frame INTEGER, id INTEGER, pos_x REAL, pos_y REAL"


@pytest.mark.parametrize(
    ("statements", "found"),
    [
        ([f"CREATE VIEW trajectory_data AS {ENDLESS}, 0.0 AS pos_y FROM c"], "a view"),
        ([f"CREATE VIEW trajectory_data AS {ENDLESS}, 0.0 AS pos_y FROM c WHERE k < 0"], "a view"),
        ([f"{TABLE}, label TEXT AS (hex(zeroblob(100000000))))"], "computed content"),
        (["CREATE VIRTUAL TABLE trajectory_data USING fts5(frame, id, pos_x, pos_y)"], "computed content"),
    ],
    ids=["endless", "silent", "generated", "virtual"],
)
def test_databases_store_their_rows(tmp_path: Path, statements: list[str], found: str) -> None:
    path = tmp_path / "a.sqlite"
    database = sqlite3.connect(path)
    for statement in statements:
        database.execute(statement)
    if "label" in statements[0]:
        database.execute("INSERT INTO trajectory_data VALUES (0, 1, 0, 0)")
    database.commit()
    database.close()
    assert found in refused(path, format="jupedsim", fps=10.0).found


def test_a_text_that_a_database_repeats_without_storing_it(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    database = sqlite3.connect(path)
    database.execute(f"{TABLE})")
    database.executemany("INSERT INTO trajectory_data VALUES (?, 1, 0, 0)", [(k,) for k in range(20_000)])
    database.execute(f"ALTER TABLE trajectory_data ADD COLUMN label TEXT DEFAULT '{'a' * 2**20}'")
    database.commit()
    database.close()
    assert "rows" in over_the_limit(path, fps=10.0)


@pytest.mark.slow
def test_archives_of_models(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.npy", "w") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<f8", "fortran_order": False, "shape": (2**26,)}
        )
        for _ in range(2**9):
            file.write(bytes(2**20))
    with pytest.raises(InputError, match=r"arrays of 512 MiB, more than 200 times its size"):
        load_model(path)


def png(path: Path, columns: int, rows: int) -> Path:
    """Write the header of a PNG, and no pixels."""
    header = b"IHDR" + pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    checked = pack(">I", 13) + header + pack(">I", zlib.crc32(header))
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + checked + pack(">I", 0) + b"IEND" + pack(">I", zlib.crc32(b"IEND"))
    )
    return path


@pytest.mark.parametrize("size", [(30_000, 30_000), (10**6, 10**6), (400_000_000, 1)])
def test_images_of_too_many_pixels(tmp_path: Path, size: tuple[int, int]) -> None:
    path = png(tmp_path / "0001.png", *size)
    with pytest.raises(InputError, match="pixels"):
        read_image(path)
    (frame,) = FrameSource.open(tmp_path)
    assert frame.image is None and "pixels" in frame.reason
    assert read_image(png(tmp_path / "0002.png", 10, 10)) is None  # it has none


@pytest.mark.parametrize("last", [10**8, 2 * 10**9])
def test_frame_numbers_that_do_not_count_time_are_no_gap(last: int) -> None:
    track = gt.Track(1, frame=[0, 1, 2, last], t=[0.0, 0.1, 0.2, 50.0], position=np.zeros((4, 2)))
    tracks = gt.TrackSet((track,))
    assert filled(tracks).n_frames == 4 and gaps_without_time(tracks) == 1
    detections = {"frame": [0, 1, 2, 3, last], "t": [0.0, 0.1, 0.2, 0.3, 0.4], "x": [0.0] * 5, "y": [0.0] * 5}
    assert gt.associate(detections).n_frames < 10
    dense = gt.Track(1, frame=[0, 1, 2, 10**7], t=[0.0, 1e-6, 2e-6, 10.0], position=np.zeros((4, 2)))
    with pytest.raises(InputError, match="--no-fill"):
        filled(gt.TrackSet((dense,)))


@pytest.mark.parametrize(
    "key", ["a." * 100_000 + "a = 1", "[" + "1." * 100_000 + "1]", '["' + '","."' * 9999 + '"]']
)
def test_keys_of_many_parts(tmp_path: Path, key: str) -> None:
    path = tmp_path / "a.toml"
    path.write_text(key + "\n")
    with pytest.raises(InputError, match=r"a\.toml"):
        Model.load(path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no endless device")
def test_model_files_without_end(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.symlink_to("/dev/zero")
    with pytest.raises(InputError, match="more than 100,000,000 characters"):
        Model.load(path)


def test_integers_of_thousands_of_digits(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("[motion]\na = " + "1" * 5000 + "\n")
    with pytest.raises(InputError, match="no TOML"):
        Model.load(path)


def mcap(path: Path, messages: int, size: int, *, indexed: bool = True) -> Path:
    """Write messages of a topic with people, zeros that are packed well."""
    writing = pytest.importorskip("mcap.writer")
    pytest.importorskip("rosbags")
    kind = writing.IndexType.ALL if indexed else writing.IndexType.NONE
    with path.open("wb") as stream:
        writer = writing.Writer(stream, compression=writing.CompressionType.ZSTD, index_types=kind)
        writer.start("ros2")
        schema = writer.register_schema("geometry_msgs/msg/PoseArray", "ros2msg", b"")
        channel = writer.register_channel("/people", "cdr", schema)
        for k in range(messages):
            writer.add_message(channel, k, bytes(size), k)
        writer.finish()
    return path


@pytest.mark.parametrize("indexed", [True, False], ids=["with an index", "without"])
def test_chunks_that_unpack_to_any_size(tmp_path: Path, indexed: bool) -> None:
    path = mcap(tmp_path / "a.mcap", 1, 2**28, indexed=indexed)
    assert path.stat().st_size < 50_000 and "unpacked content" in over_the_limit(path)
    path = mcap(tmp_path / "b.mcap", 100, 2**20, indexed=indexed)  # each chunk is within the limit
    with open_bag(path) as bag, pytest.raises(InputError, match="messages of"):
        list(bag.messages(["/people"]))


@pytest.mark.slow
def test_chunks_that_declare_another_size(tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", 1, 2**28)
    content = path.read_bytes()
    (declared,) = {size for size in range(2**28, 2**28 + 4096) if content.count(pack("<Q", size)) == 2}
    path.write_bytes(content.replace(pack("<Q", declared), pack("<Q", 1000)))
    assert "unpacked content" in over_the_limit(path)


def test_a_database_is_opened_by_its_path(tmp_path: Path) -> None:
    storage = pytest.importorskip("rosbags.rosbag2").StoragePlugin.SQLITE3
    from recordings import people, person, record

    names = {"run%31.db3": 1.0, "run1.db3": 2.0, "a?mode=memory#b.db3": 3.0}
    for k, (name, x) in enumerate(names.items()):
        messages = [(t, people(t, [person("anna", x, 0.0)], "map")) for t in (0.1, 0.2, 0.3)]
        folder = record(tmp_path / f"bag{k}", {"/people": messages}, storage)
        (folder / f"bag{k}.db3").rename(tmp_path / name)
    for name, x in names.items():
        (track,) = gt.read(tmp_path / name)
        np.testing.assert_array_equal(track.position[:, 0], x)


def test_messages_of_a_bag_that_are_computed(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = tmp_path / "a.db3"
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE topics(id, name, type, serialization_format, offered_qos_profiles)")
    database.execute(
        "CREATE VIEW messages AS SELECT 1 AS topic_id, 0 AS timestamp, zeroblob(1000000000) AS data"
    )
    database.commit()
    database.close()
    assert "messages, which is a view" in refused(path).found
