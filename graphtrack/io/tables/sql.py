"""The rows of a query: of DuckDB on its databases and on files, of SQLite, of what SQLAlchemy connects to."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from graphtrack.errors import InputError
from graphtrack.io.tables.cells import Cells, cells_of_arrow, cells_of_frame
from graphtrack.remote import RemoteFile

TABLE = "input"
"""What a file that is a table itself is called in a query."""

_SQLITE = b"SQLite format 3\0"
_READERS = {b"PAR1": "read_parquet", b"{": "read_json", b"[": "read_json"}


def cells_of_query(place: Path, query: str) -> Cells:
    """The cells of a query's answer.

    Parameters
    ----------
    place : a database of DuckDB or SQLite, a table as a file (CSV, Parquet, JSON), or the URL of a database
    query : one statement that gives rows; a file's are called ``input``

    Raises
    ------
    InputError
        Where the database, or the query, cannot be used.
    """
    if not query.strip():
        raise InputError("an empty query", "one such as select * from input (--sql)")
    if isinstance(place, RemoteFile):
        return _of_url(place, query)
    try:
        with place.open("rb") as stream:
            head = stream.read(16)
    except OSError as error:
        raise InputError(error.strerror or str(error), "a database or a table", path=place) from error
    return _of_sqlite(place, query) if head == _SQLITE else _of_duckdb(place, query, head)


def _of_duckdb(place: Path, query: str, head: bytes) -> Cells:
    try:
        import duckdb
    except ImportError as error:
        raise InputError("no package duckdb", "the extra: pip install 'graphtrack[sql]'") from error
    import pyarrow as pa

    own = head[8:12] == b"DUCK"
    try:
        with duckdb.connect(str(place) if own else ":memory:", read_only=own) as connection:
            if not own:
                reader = next(
                    (r for mark, r in _READERS.items() if head.lstrip().startswith(mark)), "read_csv"
                )
                rows = getattr(connection, reader)(str(place))
                rows.create_view(TABLE)
            kinds = [one.type for one in duckdb.extract_statements(query)]
            # Others write files (copy, export, attach) or settings, and give rows all the same.
            if kinds != [duckdb.StatementType.SELECT]:
                raise InputError("a query that is no single select", "a select (--sql)", path=place)
            answer = connection.sql(query)
            return cells_of_arrow(pa.table(answer), place, "sql")
    except duckdb.Error as error:
        raise _told(error, place) from error


def _of_sqlite(place: Path, query: str) -> Cells:
    try:
        with closing(sqlite3.connect(f"{place.absolute().as_uri()}?mode=ro", uri=True)) as connection:
            connection.set_authorizer(_reads_alone)
            cursor = connection.execute(query)
            if cursor.description is None:
                raise InputError("a query without rows", "a select (--sql)", path=place)
            return _of_rows(place, [one[0] for one in cursor.description], cursor.fetchall())
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_AUTH:
            raise InputError("a query that does more than read", "a select (--sql)", path=place) from error
        raise _told(error, place) from error


_READING = {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE}


def _reads_alone(action: int, *_: str | None) -> int:
    """SQLite's answer to what a query does: others than reading (attach) make files."""
    return sqlite3.SQLITE_OK if action in _READING else sqlite3.SQLITE_DENY


def _of_url(place: RemoteFile, query: str) -> Cells:
    try:
        import sqlalchemy
    except ImportError as error:
        raise InputError("no package sqlalchemy", "the extra: pip install 'graphtrack[sql]'") from error
    shown = Path(str(place).split("@")[-1])  # without a password
    try:
        engine = sqlalchemy.create_engine(str(place))
        with engine.connect() as connection:
            answer = connection.execute(sqlalchemy.text(query))
            if not answer.returns_rows:
                raise InputError("a query without rows", "a select (--sql)", path=shown)
            return _of_rows(shown, list(answer.keys()), [tuple(row) for row in answer])
    except (sqlalchemy.exc.SQLAlchemyError, ImportError) as error:
        raise _told(error, shown) from error


def _of_rows(place: Path, names: list[str], rows: list[tuple[Any, ...]]) -> Cells:
    import pandas as pd

    # Each column as pandas would have it: numbers as numbers, dates as dates.
    columns = {
        k: pd.Series([row[k] for row in rows], dtype=object).infer_objects() for k in range(len(names))
    }
    frame = pd.DataFrame(columns)
    frame.columns = pd.Index(names)
    cells = cells_of_frame(frame)
    return Cells(place, "sql", cells.columns, lambda row: row + 1, cells.zones)


def _told(error: Exception, place: Path) -> InputError:
    """The first line of what a database says."""
    said = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
    return InputError(said, "a query that can be answered (--sql)", path=place)
