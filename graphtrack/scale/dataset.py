"""`Dataset`: Parquet files read block by block as one native table; a file written shard by shard."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.column_names import with_synonyms
from graphtrack.io.formats.native import ROW_GROUP, arrow_errors, text_columns
from graphtrack.io.options import ReadOptions
from graphtrack.io.text import parse_number
from graphtrack.tracks.cells import (
    Cells,
    Layout,
    cells_of_arrow,
    check_type,
    labels,
    numbers,
    rows_of_cells,
)
from graphtrack.tracks.schema import INTEGERS, TEXTS, in_order, is_column, unknown
from graphtrack.tracks.table import Rows

BLOCK = 65_536
"""Rows read at a time."""

_BUFFER = 2**20
"""Bytes of a column read at a time, so that a file of one large row group needs no more memory."""

_SUFFIXES = (".parquet", ".pq")


@dataclass(frozen=True)
class DataFile:
    """One file of a data set.

    Attributes
    ----------
    path : of the file
    first_row : rows in the files before it
    n_rows : its rows
    columns : the columns of the native table that it has → their names in the file
    constants : column → its one value, from folders named ``column=value``
    foreign : (name, value) of such folders whose name is no column of the native table
    further : its columns that are none of the native table
    """

    path: Path
    first_row: int
    n_rows: int
    columns: Mapping[str, str]
    constants: Mapping[str, float | str]
    foreign: tuple[tuple[str, str], ...]
    further: tuple[str, ...]


@dataclass(eq=False)
class Dataset:
    """The files of a data set as one table of numbers.

    Attributes
    ----------
    path : the file or folder
    files : in the order of their names
    columns : the columns that any file has, in the order of writing
    ignored : columns that are not of the native table
    names : column of the native table → its name in the files, where that is another well-known one
    notes : on columns read under other names
    labels : what the numbers in columns of text stand for; it grows as blocks are read
    """

    path: Path
    files: tuple[DataFile, ...]
    columns: tuple[str, ...]
    ignored: tuple[str, ...]
    names: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    labels: list[str] = field(default_factory=lambda: [""])

    def __post_init__(self) -> None:
        self._codes = {label: code for code, label in enumerate(self.labels)}

    @property
    def n_rows(self) -> int:
        """Person-frames."""
        return sum(file.n_rows for file in self.files)

    def blocks(self, columns: Sequence[str] | None = None) -> Iterator[FloatArray]:
        """Matrices (n, columns + 1) of up to `BLOCK` rows; the last column is the number of the row, from 0.

        A missing number is NaN, a text its place in `labels`.
        """
        columns = self.columns if columns is None else columns
        for file in self.files:
            yield from self._blocks_of(file, columns)

    def _blocks_of(self, file: DataFile, columns: Sequence[str]) -> Iterator[FloatArray]:
        import pyarrow.parquet as pq

        stored = [file.columns[name] for name in columns if name in file.columns]
        row = 0
        with arrow_errors(file.path):
            # Without pre_buffer=False a row group's columns are fetched whole, whatever the buffer's size.
            parquet = pq.ParquetFile(
                file.path,
                read_dictionary=text_columns(pq.read_schema(file.path)),
                buffer_size=_BUFFER,
                pre_buffer=False,
                page_checksum_verification=True,
            )
        with parquet:
            batches = parquet.iter_batches(BLOCK, columns=stored)
            while True:
                with arrow_errors(file.path):
                    batch = next(batches, None)
                    if batch is None:
                        return
                    batch.validate(full=True)
                n = len(batch)
                cells = cells_of_arrow(batch.schema, batch.column, file.path, "parquet", row)
                block = np.full((n, len(columns) + 1), np.nan)
                for place, name in enumerate(columns):
                    if name in file.columns:
                        block[:, place] = self._numbers(cells, name, file.columns[name])
                    elif name in file.constants:
                        value = file.constants[name]
                        block[:, place] = self._code(value) if isinstance(value, str) else value
                    elif name in TEXTS:
                        block[:, place] = 0.0
                block[:, -1] = file.first_row + row + np.arange(n)
                row += n
                yield block

    def _numbers(self, cells: Cells, name: str, own: str) -> FloatArray | list[int]:
        """Return a column of a batch; ``own`` is its name in the file."""
        if name in TEXTS:
            return list(map(self._code, labels(cells, own)))
        try:
            return numbers(cells, own)
        except InputError as error:
            hint = "--no-stream reads dates and times" if name == "t" and error.line is None else ""
            raise error.at(hint=hint) from error

    def _code(self, label: object) -> int:
        if not isinstance(label, str):
            return 0
        code = self._codes.setdefault(label, len(self.labels))
        if code == len(self.labels):
            self.labels.append(label)
        return code

    def fail(
        self, found: str, expected: str, row: int | None = None, column: str | int | None = None
    ) -> InputError:
        """The error for one row of the data set (from 0), with the file that it stands in."""
        if row is None:
            return InputError(found, expected, path=self.path, column=column)
        file = next(file for file in reversed(self.files) if file.first_row <= row)
        return InputError(found, expected, path=file.path, line=row - file.first_row + 1, column=column)

    @contextmanager
    def located(self) -> Iterator[None]:
        """Replace the row of the data set in errors of the block by the file and the row in it."""
        try:
            yield
        except InputError as error:
            if error.path != str(self.path) or error.line is None:
                raise
            raise self.fail(error.found, error.expected, error.line - 1, error.column) from error


def open_dataset(path: str | Path) -> Dataset:
    """A Parquet file, or a folder with its subfolders, as one table.

    Files without a row are left out, and files and folders whose names begin with ``.`` or ``_``. Folders
    named ``column=value`` give their files a column. Columns of well-known names
    (`column_names.SYNONYMS`) are read as in a single file.

    Raises
    ------
    InputError
        If nothing is there, a file is not Parquet or has a column twice, no file has rows, or a well-known
        name has another unit than seconds or metres.
    """
    path = Path(path)
    files: list[DataFile] = []
    further: dict[str, None] = {}
    first_row = 0
    for place in _part_paths(path):
        file, more = _open(place, path, first_row)
        further |= dict.fromkeys(more)
        if file.n_rows:
            files.append(file)
            first_row += file.n_rows
    if not files:
        raise InputError("no rows", "at least one row", path=path)
    known = {name for file in files for name in (*file.columns, *file.constants)}
    of_files = dict.fromkeys(name for file in files for name in file.further)
    names, notes = _well_known([*in_order(known), *of_files], path)
    own = {name: key for key, name in names.items()}
    files = [
        replace(file, columns={**file.columns, **{own[name]: name for name in file.further if name in own}})
        for file in files
    ]
    ignored = tuple(name for name in further if name not in own)
    return Dataset(path, tuple(files), in_order(known | {*names}), ignored, names, notes)


def rows_of_block(
    path: Path, columns: Sequence[str], block: FloatArray, fps: float | None, texts: Mapping[int, str]
) -> Rows:
    """Return a matrix of `Dataset.blocks` as rows, checked cell by cell.

    Parameters
    ----------
    path : of the data set, for messages
    columns : names of its columns other than the last
    fps : frames a second, for rows without times
    texts : number in a column of text → text
    """
    cells = {name: block[:, place] for place, name in enumerate(columns)}
    for name in TEXTS:
        if name in cells:
            cells[name] = np.array([texts[code] for code in cells[name]], dtype=object)
    table = Cells(path, "parquet", cells, lambda row: int(block[row, -1]) + 1)
    return rows_of_cells(table, Layout(), fps=fps, strict=True)


def check_without_poses(dataset: Dataset, options: ReadOptions | None) -> None:
    """Raise InputError for poses of sensors, which are not read with a data set."""
    if options is not None and options.poses is not None:
        expected = "rows in the world (graphtrack convert --poses), or a file that fits into memory"
        raise dataset.fail("poses when streaming", expected)


def _well_known(names: list[str], path: Path) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return column of the native table → its other well-known name, and notes on it."""
    found, notes = with_synonyms(names, ReadOptions(), path)
    if not isinstance(found.columns, Mapping):
        return {}, notes
    for unit, key in ((found.time_unit, "t"), (found.units, "x")):
        if unit not in (None, "s", "m"):
            raise InputError(
                f"column {found.columns[key]} when streaming",
                "seconds and metres; --no-stream reads other units",
                path=path,
            )
    return dict(found.columns), notes


def _part_paths(path: Path) -> list[Path]:
    """The files of a data set, ordered by name."""
    if not path.exists():
        raise InputError("no such file", "an existing file or folder", path=path)
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError("a device", "a Parquet file or a folder of them", path=path)
    found = []
    for place in sorted(path.rglob("*")):
        hidden = any(part.startswith((".", "_")) for part in place.relative_to(path).parts)
        if hidden or place.is_dir():
            continue
        if not place.name.lower().endswith(_SUFFIXES):
            expected = f"a folder with files {' or '.join('*' + suffix for suffix in _SUFFIXES)} alone"
            raise InputError("a file of another kind", expected, path=place)
        found.append(place)
    if not found:
        raise InputError("a folder without Parquet files", "at least one", path=path)
    return found


def _open(place: Path, root: Path, first_row: int) -> tuple[DataFile, list[str]]:
    """A file, and the names of its columns, and of its folders, that are none of the native table."""
    import pyarrow.parquet as pq

    with arrow_errors(place), pq.ParquetFile(place) as parquet:
        schema, n_rows = parquet.schema_arrow, parquet.metadata.num_rows
    names = list(schema.names)
    if len(set(names)) < len(names):
        raise InputError("a column twice", "each column once", path=place)
    for name in filter(is_column, names):
        check_type(schema, name, place)
    constants: dict[str, float | str] = {}
    foreign: list[tuple[str, str]] = []
    for part in place.relative_to(root).parts[:-1]:
        name, sign, text = part.partition("=")
        if not sign:
            continue
        value = unquote(text)
        if name in names or name in constants:
            raise InputError(f"a column {name} and a folder {part}", "one of the two", path=place)
        if not is_column(name):
            foreign.append((name, value))
        elif name in TEXTS:
            constants[name] = value
        else:
            number = parse_number(value)
            if number is None:
                raise InputError(f"the folder {part}", f"a number after {name}=", path=place)
            constants[name] = number
    columns = {name: name for name in names if is_column(name)}
    further = unknown(names)
    file = DataFile(place, first_row, n_rows, columns, constants, tuple(foreign), tuple(further))
    return file, further + [name for name, _ in foreign]


class ShardWriter:
    """Collects rows and writes them in row groups of `ROW_GROUP`.

    Parameters
    ----------
    path : file to write, which the caller puts in its place
    columns : the columns that may come. Those that no shard had are left out in the end, which takes another
        file of the same size for a moment.
    names : of columns that have another name in the file
    """

    def __init__(self, path: Path, columns: Sequence[str], names: Mapping[str, str]) -> None:
        import pyarrow as pa

        self.path = path
        self.n_rows = 0
        self._columns = columns
        self._schema = pa.schema([(names.get(name, name), _type_of(name)) for name in columns])
        self._columns_found: set[str] = set()
        self._waiting: list[Any] = []
        self._n_waiting = 0
        self._file = _open_writer(path, self._schema)

    def __enter__(self) -> ShardWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self._finish()
        else:
            self._file.close()

    def add(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append the rows of a shard: equally long columns, ``track_id`` among them."""
        import pyarrow as pa

        n = len(columns["track_id"])
        if not n:
            return
        self._columns_found |= columns.keys()
        arrays = []
        for name, kind in zip(self._columns, self._schema, strict=True):
            values = columns.get(name)
            if values is None and name in TEXTS:
                values = np.full(n, "", dtype=object)
            if values is None:
                arrays.append(pa.nulls(n, kind.type))
            else:
                arrays.append(pa.array(values, type=kind.type, from_pandas=True))
        self._waiting.append(pa.table(arrays, schema=self._schema))
        self._n_waiting += n
        self.n_rows += n
        while self._n_waiting >= ROW_GROUP:
            self._write(ROW_GROUP)

    def _write(self, n: int) -> None:
        import pyarrow as pa

        # One chunk: where chunks end would show in the file's pages.
        table = pa.concat_tables(self._waiting).combine_chunks()
        self._file.write_table(table.slice(0, n), row_group_size=ROW_GROUP)
        self._n_waiting = len(table) - n
        # A copy by `take`: a slice would keep what was written in memory.
        self._waiting = [table.take(np.arange(n, len(table)))] if self._n_waiting else []

    def _finish(self) -> None:
        if self._n_waiting:
            self._write(self._n_waiting)
        self._file.close()
        own = zip(self._columns, self._schema.names, strict=True)
        names = [name for column, name in own if column in self._columns_found]
        if names and names != self._schema.names:
            self._leave_out_the_rest(names)

    def _leave_out_the_rest(self, names: list[str]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        kept = pa.schema([self._schema.field(name) for name in names])
        narrow = self.path.with_name(f"narrow.{self.path.name}")
        with pq.ParquetFile(self.path) as wide, _open_writer(narrow, kept) as file:
            for group in range(wide.num_row_groups):
                table = wide.read_row_group(group, columns=names).combine_chunks()
                file.write_table(table, row_group_size=ROW_GROUP)
        narrow.replace(self.path)


def _type_of(name: str) -> Any:
    import pyarrow as pa

    if name in INTEGERS:
        return pa.int64()
    return pa.string() if name in TEXTS else pa.float64()


def _open_writer(path: Path, columns: Any) -> Any:
    import pyarrow.parquet as pq

    return pq.ParquetWriter(path, columns, write_page_checksum=True)
