"""Answers of queries, and files by their URLs."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import command
import numpy as np
import pandas as pd
import pytest

from graphtrack import io
from graphtrack.errors import InputError

QUERY = "select who as agent, seconds * 1000 as ms, east as x, north as y from walks where who <> 'eve'"
OPTIONS = {"columns": "id=agent,t=ms", "time_unit": "ms"}


def walks() -> pd.DataFrame:
    parts = [
        pd.DataFrame({"who": who, "seconds": np.arange(4), "east": k + np.arange(4.0), "north": 0.5})
        for k, who in enumerate(("anna", "bob", "eve"))
    ]
    return pd.concat(parts, ignore_index=True)


def check(path: Path | str, query: str) -> None:
    tracks = io.read(path, sql=query, **OPTIONS)
    assert [track.label for track in tracks] == ["anna", "bob"]
    np.testing.assert_array_equal(tracks[2].position, np.column_stack([1 + np.arange(4), np.full(4, 0.5)]))
    np.testing.assert_array_equal(tracks[2].t, np.arange(4))


def refused(path: Path | str, **options: object) -> str:
    with pytest.raises(InputError) as caught:
        io.read(path, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def sqlite(path: Path) -> Path:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("create table walks (who text, seconds integer, east real, north real)")
        connection.executemany("insert into walks values (?, ?, ?, ?)", walks().values.tolist())
        connection.commit()
    return path


@pytest.mark.parametrize("name", ["walks.csv", "walks.parquet", "walks.json", "walks.duckdb"])
def test_a_query_of_duckdb(name: str, tmp_path: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    path, query, table = tmp_path / name, QUERY.replace("from walks", "from input"), walks()
    if name.endswith("csv"):
        table.to_csv(path, index=False)
    elif name.endswith("parquet"):
        table.to_parquet(path)
    elif name.endswith("json"):
        table.to_json(path, orient="records", lines=True)
    else:
        query = QUERY
        with duckdb.connect(str(path)) as connection:
            connection.register("given", table)
            connection.execute("create table walks as select * from given")
    before = path.read_bytes()
    check(path, query)
    for wrong, said in (
        ("selec", "selec"),
        ("select * from nowhere", "nowhere"),
        (" ", "empty query"),
        ("create table mine (a integer)", "--"),
    ):
        assert said in refused(path, sql=wrong)
    assert path.read_bytes() == before
    assert "--columns" in refused(path, sql=query.replace("as agent", "as x1"))
    assert "delimiter with sql" in refused(path, sql=query, delimiter=";")


def test_a_query_of_sqlite(tmp_path: Path) -> None:
    path = sqlite(tmp_path / "walks.sqlite")
    check(path, QUERY)
    assert "nowhere" in refused(path, sql="select * from nowhere")
    assert "more than read" in refused(path, sql="delete from walks")
    (tmp_path / "walks.sqlite").write_bytes(path.read_bytes()[:700])
    assert refused(path, sql=QUERY)
    assert "no such file" in refused(tmp_path / "none.db", sql=QUERY).lower()


def test_a_query_of_a_database_with_a_url(tmp_path: Path) -> None:
    pytest.importorskip("sqlalchemy")
    url = f"sqlite:///{sqlite(tmp_path / 'walks.sqlite')}"
    check(url, QUERY)
    assert "nowhere" in refused(url, sql="select * from nowhere")
    assert "secret" not in refused("nosuch://me:secret@host/db", sql=QUERY)


@pytest.mark.parametrize("name", ["walks.parquet", "walks.csv"])
def test_a_file_by_its_url(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsspec = pytest.importorskip("fsspec")
    monkeypatch.chdir(tmp_path)
    url = f"memory://bucket/{name}"
    with fsspec.open(url, "wb") as stream:
        walks().to_csv(stream, index=False) if name.endswith("csv") else walks().to_parquet(stream)
    columns = "id=who,t=seconds,x=east,y=north"
    tracks = io.read(url, columns=columns)
    assert [track.label for track in tracks] == ["anna", "bob", "eve"]
    assert "each file once" in refused([url, url], columns=columns)
    done = command.run("info", url, "--columns", columns, program="graphtrack")
    assert done.returncode == 0 and url in done.stderr and "anna" in done.stdout
    walks().to_csv("walks.csv", index=False)
    assert len(io.read(f"file://{tmp_path}/walks.csv", columns=columns)) == 3
    for wrong in ("memory://bucket/none.csv", "nosuch://bucket/walks.csv", f"file://{tmp_path}/none.csv"):
        assert wrong in refused(wrong)
        done = command.run("info", wrong, program="graphtrack")
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1


WRITING = {
    "csv": [
        "copy (select 1) to 'stolen.csv'",
        "attach 'stolen.db' as s",
        "select 1; select 2",
        "set threads=1",
    ],
    "sqlite": ["attach 'stolen.db' as s", "vacuum into 'stolen.db'", "pragma user_version = 7"],
}


@pytest.mark.parametrize(("kind", "query"), [(kind, one) for kind, some in WRITING.items() for one in some])
def test_queries_read_and_write_nothing(kind, query, tmp_path, monkeypatch) -> None:
    if kind == "csv":
        pytest.importorskip("duckdb")
        walks().to_csv(tmp_path / "walks", index=False)
    else:
        sqlite(tmp_path / "walks")
    monkeypatch.chdir(tmp_path)
    before = (tmp_path / "walks").read_bytes()
    assert "--sql" in refused("walks", sql=query)
    assert [one.name for one in tmp_path.iterdir()] == ["walks"]
    assert (tmp_path / "walks").read_bytes() == before


def test_packages_that_a_url_needs_are_named(monkeypatch) -> None:
    fsspec = pytest.importorskip("fsspec")

    def lacking(*_: object) -> None:
        raise ImportError("HTTPFileSystem requires aiohttp")

    monkeypatch.setattr(fsspec, "open", lacking)
    assert "pip install" in refused("http://site.example/walks.csv")
