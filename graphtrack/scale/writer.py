"""A Parquet file that is written shard by shard, with the same bytes as when it is written at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.io.readers.native_parquet import ROW_GROUP
from graphtrack.table.schema import INTEGERS


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
        self._seen: set[str] = set()
        self._waiting: list[Any] = []
        self._n_waiting = 0
        self._file = _open(path, self._schema)

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
        self._seen |= columns.keys()
        arrays = []
        for name, field in zip(self._columns, self._schema, strict=True):
            values = columns.get(name)
            if values is None and name == "label":
                values = np.full(n, "", dtype=object)
            if values is None:
                arrays.append(pa.nulls(n, field.type))
            else:
                arrays.append(pa.array(values, type=field.type, from_pandas=True))
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
        names = [name for column, name in own if column in self._seen]
        if names and names != self._schema.names:
            self._leave_out_the_rest(names)

    def _leave_out_the_rest(self, names: list[str]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        kept = pa.schema([self._schema.field(name) for name in names])
        narrow = self.path.with_name(f"narrow.{self.path.name}")
        with pq.ParquetFile(self.path) as wide, _open(narrow, kept) as file:
            for group in range(wide.num_row_groups):
                table = wide.read_row_group(group, columns=names).combine_chunks()
                file.write_table(table, row_group_size=ROW_GROUP)
        narrow.replace(self.path)


def _type_of(name: str) -> Any:
    import pyarrow as pa

    if name in INTEGERS:
        return pa.int64()
    return pa.string() if name == "label" else pa.float64()


def _open(path: Path, columns: Any) -> Any:
    import pyarrow.parquet as pq

    return pq.ParquetWriter(path, columns, write_page_checksum=True)
