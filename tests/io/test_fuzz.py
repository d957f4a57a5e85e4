"""Random, damaged and long files: every reader returns or raises a `GraphtrackError` of one line, soon."""

import datetime
import json
import os
import random
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from format_samples import SAMPLES, Sample, sample_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from input_readers import OPTION_FILES, InputReader, as_checked, format_readers
from mutations import mutate

from graphtrack import io
from graphtrack.errors import GraphtrackError, InputWarning
from graphtrack.io.formats.boxes import read_coco
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from perception.models import load_classifier, model_path
from perception.storage import load_model

FOLDER = TemporaryDirectory()
READERS = (*OPTION_FILES, *format_readers(Path(FOLDER.name)))
BY_LABEL = {one.label: one for one in READERS}

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"
fuzzed = settings(
    max_examples=int(os.environ.get("GRAPHTRACK_FUZZ_EXAMPLES", "2000" if NIGHTLY else "8")),
    suppress_health_check=list(HealthCheck),
)

WORDS = st.sampled_from(
    [
        *"\0-\"',;\n=]}*\ufeff\u202e",
        *(["nan", "1e999", "0x1", "true", "null", "-0", "{}", "1,5", "1.5.5", "x_0", "2026-11-23T10:00:00"]),
        *("", "\r\n", "1" * 5000, "[" * 500, "a" * 140_000, "CURVEPOLYGON ((0 0, 1 0, 1 1, 0 0))"),
        "\ud800".encode("utf-8", "surrogatepass").decode("latin-1"),
    ]
)


def reads(one: InputReader, content: bytes) -> None:
    """Read a content; other exceptions than of this package pass."""
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", InputWarning)
        path = one.write(Path(folder), content)
        refused_or_read(lambda: one.read(path))


def refused_or_read(read: Any) -> None:
    try:
        read()
    except GraphtrackError as error:
        assert "\n" not in str(error)


def mutated(label: str, data: st.DataObject) -> bytes:
    """Return the content of a reader's example with some bytes, cells, lines or words changed."""
    content = BY_LABEL[label].content
    kind = data.draw(st.integers(0, 3))
    if kind == 0:
        return mutate(content, np.random.default_rng(data.draw(st.integers(0, 2**32))))
    if kind == 1:
        return data.draw(st.binary(max_size=200))
    start = data.draw(st.integers(0, len(content)))
    end = data.draw(st.integers(start, min(len(content), start + 40)))
    if kind == 2:
        words = data.draw(st.lists(WORDS, min_size=1, max_size=3))
        return content[:start] + "".join(words).encode() + content[end:]
    times = data.draw(st.integers(2, 30))
    return content[:start] + content[start:end] * times + content[end:]


@fuzzed
@pytest.mark.parametrize("label", sorted(BY_LABEL))
@given(data=st.data())
def test_changed_contents(label: str, data: st.DataObject) -> None:
    reads(BY_LABEL[label], mutated(label, data))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(10**400),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)


@st.composite
def changed_json(draw: st.DrawFn, value: Any) -> Any:
    """Return a JSON value with one of its parts replaced by any other."""
    if isinstance(value, dict | list) and value and draw(st.integers(0, 4)):
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        key = draw(st.sampled_from(keys))
        inner = draw(changed_json(value[key]))
        if isinstance(value, dict):
            return {**value, key: inner}
        return [*value[:key], inner, *value[key + 1 :]]
    return draw(JSON)


COCO = {
    "images": [{"id": 1, "file_name": "a_0001.jpg"}, {"id": 2, "file_name": "a_0002.jpg"}],
    "categories": [{"id": 1, "name": "person", "keypoints": []}],
    "annotations": [
        {"image_id": k, "bbox": [1, 2, 30, 40], "category_id": 1, "track_id": 5, "score": 0.5, "iscrowd": 0}
        for k in (1, 2)
    ],
}
MMPOSE = [
    {
        "frame_id": 0,
        "instances": [{"keypoints": [[1, 2]] * 17, "keypoint_scores": [0.5] * 17, "bbox": [[1, 2, 3, 4]]}],
    }
]
MMPOSE_SCRIPT = {"instance_info": MMPOSE, "meta_info": {"keypoint_id2name": {"0": "nose", "1": "left_eye"}}}
OPENPOSE = {"people": [{"pose_keypoints_2d": [1.0, 2.0, 0.5] * 25}]}
DOCUMENTS = {
    "coco-detections": COCO,
    "coco-detections, format given": COCO["annotations"],
    "keypoints": json.loads(BY_LABEL["keypoints"].content),
    "walkable GeoJSON": json.loads(BY_LABEL["walkable GeoJSON"].content),
    "stream": json.loads(BY_LABEL["stream"].content),
    "ndjson-made": json.loads(BY_LABEL["ndjson-made"].content.split(b"\n")[0]),
    "trajnet-made.trajnet": json.loads(BY_LABEL["trajnet-made.trajnet"].content.split(b"\n")[-2]),
}


@fuzzed
@pytest.mark.parametrize(
    ("label", "document"),
    [*DOCUMENTS.items(), ("keypoints", MMPOSE), ("keypoints", MMPOSE_SCRIPT), ("keypoints", OPENPOSE)],
    ids=lambda value: value if isinstance(value, str) else "",
)
@given(data=st.data())
def test_json_of_other_types(label: str, document: Any, data: st.DataObject) -> None:
    reads(BY_LABEL[label], json.dumps(data.draw(changed_json(document))).encode())


CELLS = (
    st.none() | st.booleans() | st.integers(-(2**62), 2**62) | st.floats() | st.text(max_size=5)
) | st.binary(max_size=4)
NUMBERS = (pa.float64(), pa.float16(), pa.int8(), pa.uint64(), pa.bool_(), pa.null(), pa.decimal128(9, 2))
TEXTS = (pa.string(), pa.large_string(), pa.string_view(), pa.binary(), pa.binary(3))
TIMES = (pa.timestamp("ns", "UTC"), pa.timestamp("s"), pa.date32(), pa.time64("us"), pa.duration("ms"))
NESTED = (
    *(pa.list_(pa.float64()), pa.list_(pa.float32(), 2), pa.struct([("a", pa.int8())])),
    *(
        pa.map_(pa.string(), pa.int8()),
        pa.dictionary(pa.int8(), pa.string()),
        pa.dictionary(pa.int8(), pa.int64()),
    ),
)
COLUMN_TYPES = st.sampled_from([*NUMBERS, *TEXTS, *TIMES, *NESTED])
NAMES_OF_TABLE = [
    "track_id",
    "frame",
    "t",
    "x",
    "y",
    "head_deg",
    "head_p0",
    "label",
    "input_a",
    "u",
    "id",
    "time",
]


def value_of(kind: pa.DataType, k: int) -> Any:
    """Return a value of a type of Arrow."""
    known: list[Any] = [k, float(k), str(k), bytes([65, 66, 48 + k]), datetime.datetime(2026, 1, 1 + k)]
    known += [datetime.date(2026, 1, 1 + k), datetime.time(k), datetime.timedelta(k), [k, k], [[k, k]]]
    known += [{"a": k}, [("a", k)], True, None]
    for value in known:
        try:
            pa.array([value], kind)
        except (pa.ArrowException, TypeError, ValueError, OverflowError):
            continue
        return value
    return None


@fuzzed
@given(
    types=st.dictionaries(st.sampled_from(NAMES_OF_TABLE), COLUMN_TYPES, max_size=3), with_null=st.booleans()
)
def test_parquet_of_other_types(types: dict[str, pa.DataType], with_null: bool, tmp_path: Path) -> None:
    columns: dict[str, Any] = {"track_id": [1, 1, 1], "frame": [0, 1, 2], "t": [0.0, 0.1, 0.2]}
    columns |= {"x": [0.0, 0.1, 0.2], "y": [0.0, 0.0, 0.0]}
    for name, kind in types.items():
        values = [value_of(kind, k) for k in range(3)]
        columns[name] = pa.array([None, *values[1:]] if with_null else values, kind)
    try:
        pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    except pa.ArrowException:  # of a type that Parquet lacks
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        refused_or_read(lambda: io.read_identified(tmp_path / "a.parquet"))
        refused_or_read(lambda: io.read_identified(tmp_path / "a.parquet", columns="id=track_id,t=t"))


ODD = CELLS | st.just(10**400) | st.just([1.0, 2.0]) | st.just([1.0]) | st.just({"a": 1}) | st.just(pd.NA)
ODD = ODD | st.just(pd.NaT) | st.just(np.array([1.0])) | st.just(np.float32(1)) | st.just(1j)


@fuzzed
@given(st.dictionaries(st.sampled_from(NAMES_OF_TABLE), st.lists(ODD, min_size=3, max_size=3), max_size=3))
def test_tables_in_memory_of_other_types(columns: dict[str, list[Any]]) -> None:
    table: dict[str, Any] = {"track_id": [1, 1, 1], "frame": [0, 1, 2], "t": [0.0, 0.1, 0.2]}
    table |= {"x": [0.0, 0.1, 0.2], "y": [0.0, 0.0, 0.0]}
    for name, cells in columns.items():
        table[name] = np.empty(3, dtype=object)
        table[name][:] = cells
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        refused_or_read(lambda: io.read_identified(pd.DataFrame(table)))
        refused_or_read(lambda: io.read_identified(table, columns="id=track_id,t=t"))


CARD = json.loads(str(np.load(model_path("templates"))["card"]))
ARRAYS = {name: values for name, values in np.load(model_path("templates")).items() if name != "card"}


@fuzzed
@given(
    content=changed_json(CARD),
    name=st.sampled_from([*ARRAYS]),
    change=st.sampled_from(["", "drop", "shape", "text", "cut"]),
)
def test_model_files(content: Any, name: str, change: str, tmp_path: Path) -> None:
    changed: dict[str, Any] = dict(ARRAYS)
    if change == "drop":
        del changed[name]
    elif change:
        shaped = {"shape": np.zeros((2, 0, 3)), "text": np.array("a"), "cut": np.ravel(ARRAYS[name])[:1]}
        changed[name] = shaped[change]
    path = tmp_path / "a.npz"
    np.savez_compressed(path, card=np.array(json.dumps(content)), **changed)
    refused_or_read(lambda: load_model(path)[0].text())
    refused_or_read(lambda: load_classifier("templates", path))


def test_deep_cards_and_coco_categories(tmp_path: Path) -> None:
    for deep in ("[" * 900 + "]" * 900, "[" * 50_000 + "]" * 50_000):
        path = tmp_path / "deep.npz"
        np.savez(path, card=np.array('{"kind": "templates", "parameters": {"a": ' + deep + "}}"))
        with pytest.raises(GraphtrackError, match="something else"):
            load_model(path)
    for category in ({"a": 1}, [1], None):
        document = {**COCO, "annotations": [{**COCO["annotations"][0], "category_id": category}]}
        source = Source(Path("a.json"), json.dumps(document).encode())
        with pytest.raises(GraphtrackError, match="category_id"):
            read_coco(source, ReadOptions(fps=10.0, metres_per_pixel=0.01))


MUTANTS = 60
SLOWEST_READ = 5.0
"""Seconds; a sample reads in milliseconds, so that this is a hang and not a slow machine."""

CAMERAS = {
    "homography": b"0.01 0 0\n0 -0.01 0\n0 0.0001 1\n",
    "point_pairs": b"# u v X Y\n0 0 0 0\n100 0 1 0\n100 100 1 -1\n0 100 0 -1.1\n50 50 0.5 -0.5\n",
}
BESIDE = [(sample, name) for sample in SAMPLES for name in sample.beside]
BESIDE += [(sample_of("mot"), name) for name in CAMERAS]


@pytest.mark.parametrize(("sample", "name"), BESIDE, ids=[name for _, name in BESIDE])
def test_damaged_companions_and_cameras_are_read_or_refused(
    sample: Sample, name: str, tmp_path: Path
) -> None:
    path, options = sample.write(tmp_path), dict(sample.options)
    if name in CAMERAS:
        options[name] = tmp_path / name
    whole, refused = CAMERAS.get(name) or (tmp_path / name).read_bytes(), set()
    for seed in range(MUTANTS):
        (tmp_path / name).write_bytes(mutate(whole, np.random.default_rng(seed)))
        start = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", InputWarning)
            try:
                as_checked(io.read_identified(path, **options))
            except GraphtrackError as error:
                refused.add(str(error))
        assert time.perf_counter() - start < SLOWEST_READ
    assert refused


LENGTH = 2**20
HANG = 900.0
"""Seconds of a part of the readers, which need some for all texts; quadratic time would be hours."""

CHARACTERS = [bytes([code]) for code in range(128)]
PAIRS = [first + second for first in CHARACTERS for second in CHARACTERS if first != second]

SEED = int(os.environ.get("GRAPHTRACK_FUZZ_SEED", "0"))
"""``make test-all`` sets that of the day."""


def texts(seed: int, singles: int, pairs: int) -> Iterator[bytes]:
    """Yield a mebibyte of each of so many characters, and of so many pairs of them."""
    chosen = random.Random(seed)
    yield from (character * LENGTH for character in chosen.sample(CHARACTERS, singles))
    yield from (pair * (LENGTH // 2) for pair in chosen.sample(PAIRS, pairs))


def contents(content: bytes, text: bytes) -> Iterator[bytes]:
    """Yield the text alone, and within the first line and the middle of a valid content."""
    first, _, rest = content.partition(b"\n")
    middle = len(first) // 2
    yield text
    yield first[:middle] + text + first[middle:] + b"\n" + rest
    yield content[: len(content) // 2] + text + content[len(content) // 2 :]


def read_all(part: int, parts: int, every: int, seed: int, singles: int, pairs: int) -> None:
    """Read texts with a part of the readers; what is read is printed before, so that a hang names it.

    Of so many texts each reader has one, in turn.
    """
    warnings.simplefilter("ignore")
    with TemporaryDirectory() as folder:
        for k, one in list(enumerate(READERS))[part::parts]:
            for text in islice(texts(seed + k, singles, pairs), k % every, None, every):
                for place, content in enumerate(contents(one.content, text)):
                    print(one.label, text[:2], place, flush=True)
                    try:
                        one.read(one.write(Path(folder) / "long", content))
                    except GraphtrackError as error:
                        assert "\n" not in str(error) and len(str(error)) < 4000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "parts", "every", "singles", "pairs"),
    [
        pytest.param(0, 1, 2, 1, 1, id="some"),
        *(pytest.param(k, 4, 1, 128, 64, id=f"all-{k}", marks=pytest.mark.slow) for k in range(4)),
    ],
)
def test_a_mebibyte_of_few_characters_is_read_or_refused_soon(
    part: int, parts: int, every: int, singles: int, pairs: int
) -> None:
    command = [sys.executable, __file__, *map(str, (part, parts, every, SEED, singles, pairs))]
    hang = HANG if singles < len(CHARACTERS) else 4 * HANG
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=hang, check=False, env=environment)
    assert done.returncode == 0, (done.stdout[-200:], done.stderr[-2000:])


if __name__ == "__main__":
    read_all(*map(int, sys.argv[1:]))
