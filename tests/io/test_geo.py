"""Tracks as GeoDataFrames, trajectories of movingpandas, and Moving Features JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import graphtrack as gt

COLUMNS = {"id": "agent", "t": "timestamp", "lat": "lat", "lon": "lon"}


def walks() -> pd.DataFrame:
    """Two people who go north; of one a place is missing."""
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
    for found in (
        geopandas.read_file(tmp_path / "walks.gpkg"),
        geopandas.read_parquet(tmp_path / "walks.parquet"),
    ):
        assert found.crs.to_epsg() == 4326
        np.testing.assert_allclose(found.geometry.x, given.lon, atol=1e-9)
        np.testing.assert_allclose(found.geometry.y, given.lat, atol=1e-9)
        assert list(found["agent"]) == list(given.agent)
        expected = pd.to_datetime(given.timestamp).dt.tz_localize(None).to_numpy()
        assert (found["time"].to_numpy() == expected.astype(found["time"].dtype.str)).all()


def test_trajectories_are_people() -> None:
    pytest.importorskip("movingpandas")
    found = gt.to_movingpandas(gt.read(walks(), columns=COLUMNS))
    assert {one.id: one.size() for one in found.trajectories} == {"anna": 4, "bob": 3}
    assert found.trajectories[0].get_length() == pytest.approx(3 * 1.112, abs=0.01)
    plain = gt.to_movingpandas(
        gt.read({"track_id": [1] * 3, "frame": range(3), "t": [0, 0.5, 1], "x": range(3), "y": [0] * 3})
    )
    assert plain.trajectories[0].get_duration().total_seconds() == 1.0


def test_moving_features(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    path = tmp_path / "walks.mfjson"
    gt.to_mfjson(gt.read(walks(), columns=COLUMNS), path)
    content = json.loads(path.read_text())
    assert content["type"] == "FeatureCollection" and "CRS84" in content["crs"]["properties"]["name"]
    anna, bob = content["features"]
    assert (anna["id"], bob["id"]) == ("anna", "bob")
    assert anna["temporalGeometry"]["datetimes"] == list(walks().timestamp[:4])
    np.testing.assert_allclose(
        bob["temporalGeometry"]["coordinates"], walks().dropna()[["lon", "lat"]][4:], atol=1e-9
    )
    gt.to_mfjson(
        gt.read({"track_id": [1, 1], "frame": [0, 1], "t": [0.0, 0.04], "x": [0, 0.05], "y": [0, 0]}), path
    )
    assert json.loads(path.read_text())["features"][0]["temporalGeometry"]["datetimes"] == [0.0, 40.0]
