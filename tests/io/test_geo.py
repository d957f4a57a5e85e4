"""Tracks as GeoDataFrames, GeoPackage and GeoParquet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command import run

import graphtrack as gt
from graphtrack.forecasting.recorded import read_forecasts
from graphtrack.interaction.tables import read_group_table

COLUMNS = {"id": "agent", "t": "timestamp", "lat": "lat", "lon": "lon"}
SPEC = ",".join(f"{key}={name}" for key, name in COLUMNS.items())


def walks() -> pd.DataFrame:
    """Two people who go north; one lacks a position."""
    times = [f"2025-11-23T10:00:0{k}.5Z" for k in range(4)]
    steps = 48.137 + 1e-5 * np.arange(4)
    anna = pd.DataFrame({"agent": "anna", "timestamp": times, "lat": steps, "lon": 11.575})
    bob = anna.assign(agent="bob", lon=11.576)
    bob.loc[1, ["lat", "lon"]] = np.nan
    return pd.concat([anna, bob], ignore_index=True)


def test_points_keep_their_places_times_and_names_in_files(tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    points = gt.to_geopandas(gt.read(walks(), columns=COLUMNS))
    points.to_file(tmp_path / "walks.gpkg")
    points.to_parquet(tmp_path / "walks.parquet")
    given = walks().dropna()
    read = geopandas.read_file(tmp_path / "walks.gpkg"), geopandas.read_parquet(tmp_path / "walks.parquet")
    for found in read:
        assert found.crs.to_epsg() == 4326
        np.testing.assert_allclose(found.geometry.x, given.lon, atol=1e-9)
        np.testing.assert_allclose(found.geometry.y, given.lat, atol=1e-9)
        assert list(found["agent"]) == list(given.agent)
        expected = pd.to_datetime(given.timestamp).dt.tz_localize(None).to_numpy()
        assert (found["time"].to_numpy() == expected.astype(found["time"].dtype.str)).all()


def test_the_command_line_writes_them_by_the_ending(tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    walks().to_csv(tmp_path / "walks.csv", index=False)
    for ending in ("gpkg", "geoparquet"):
        more = ("--columns", SPEC, "--model", "position", "-o", tmp_path / f"smoothed.{ending}")
        done = run("smooth", tmp_path / "walks.csv", *more, program="graphtrack")
        assert done.returncode == 0, done.stderr
    layer = geopandas.read_file(tmp_path / "smoothed.gpkg")
    table = geopandas.read_parquet(tmp_path / "smoothed.geoparquet")
    assert layer.crs.to_epsg() == table.crs.to_epsg() == 4326
    np.testing.assert_allclose(layer.geometry.x, table.geometry.x)
    # Both are tables too.
    again = gt.read(tmp_path / "smoothed.geoparquet", columns=COLUMNS)
    frame = gt.read(layer.drop(columns="geometry"), columns=COLUMNS)
    assert [track.label for track in again] == [track.label for track in frame] == ["anna", "bob"]
    with pytest.raises(gt.InputError, match=r"GeoPackage.*read_file"):
        gt.read(tmp_path / "smoothed.gpkg")
    with pytest.raises(gt.InputError, match="only written"):
        gt.read(tmp_path / "smoothed.gpkg", format="geopackage")


def test_tables_of_groups_looks_and_forecasts_name_people(tmp_path: Path) -> None:
    walks().assign(body_deg=90.0, head_deg=90.0).to_csv(tmp_path / "walks.csv", index=False)
    for command in ("groups", "attention", "forecast"):
        out = tmp_path / f"{command}.csv"
        done = run(command, tmp_path / "walks.csv", "--columns", SPEC, "-o", out, program="graphtrack")
        assert done.returncode == 0, done.stderr
        table = pd.read_csv(out)
        names = dict(zip(table["track_id"], table["label"], strict=True))
        assert names == {1: "anna", 2: "bob"}, command
    looks = pd.read_csv(tmp_path / "attention.csv")
    others = looks[looks["kind"] == "person"]
    assert list(others["target_label"]) == [{"1": "anna", "2": "bob"}[str(one)] for one in others["target"]]
    assert looks[looks["kind"] != "person"]["target_label"].isna().all()
    read_group_table(tmp_path / "groups.csv")
    read_forecasts(tmp_path / "forecast.csv")
