"""Walkable areas against brute force, and paths that follow walls."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given as drawn
from hypothesis import strategies as st

from graphtrack.errors import InputError
from graphtrack.geometry.walkable import REACH, WALLS, WalkableArea

COURT = shapely.Polygon(
    [(0, 0), (10, 0), (10, 6), (6, 6), (6, 3), (0, 3)], [[(2, 1), (3, 1), (3, 2), (2, 2)]]
)


@pytest.fixture
def area():
    return WalkableArea(COURT)


def test_half_planes_touch_the_border_and_hold_the_position(area):
    rng = np.random.default_rng(0)
    position = np.column_stack([rng.uniform(-1, 11, 2000), rng.uniform(-1, 7, 2000)])
    walls = area.walls(position).reshape(-1, WALLS, 3)
    distance = shapely.distance(COURT.boundary, shapely.points(position))
    inside = area.contains(position)
    assert np.array_equal(inside, shapely.intersects(COURT, shapely.points(position)))
    there = np.any(walls[..., :2] != 0.0, axis=2)
    assert np.array_equal(there[:, 0], (distance <= REACH) | ~inside)
    depth = np.sum(walls[..., :2] * position[:, None], axis=2) - walls[..., 2]
    nearest = np.where(inside, distance, -distance)
    np.testing.assert_allclose(depth[there[:, 0], 0], nearest[there[:, 0]], atol=1e-9)
    assert np.all(depth[there & inside[:, None]] >= 0.0)
    np.testing.assert_allclose(np.linalg.norm(walls[there][:, :2], axis=1), 1.0)


def test_a_corner_has_two_walls(area):
    first, second = area.walls(np.array([[9.5, 0.3]])).reshape(WALLS, 3)
    np.testing.assert_allclose(first, [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(second, [-1.0, 0.0, -10.0], atol=1e-12)


def test_on_the_wall_itself_the_area_lies_ahead(area):
    for point, normal in (((5.0, 0.0), (0, 1)), ((2.5, 1.0), (0, -1)), ((6.0, 4.0), (1, 0))):
        found = area.walls(np.array([point]))[0, :2]
        np.testing.assert_allclose(found, normal, atol=1e-12)


def test_paths_follow_walls_and_cross_none(area):
    rng = np.random.default_rng(1)
    for _ in range(100):
        start = np.array([rng.uniform(3.2, 10), rng.uniform(0, 3)])
        path = area.confined(start + np.cumsum(rng.normal(0, 1.0, (8, 2)), axis=0), start)
        way = shapely.LineString([start, *path])
        assert COURT.buffer(1e-6).covers(way)
    free = np.array([[4.0, 1.0], [5.0, 2.0]])
    np.testing.assert_array_equal(area.confined(free, np.array([4.0, 0.5])), free)


def test_files_objects_and_what_is_none_of_them(area, tmp_path):
    (tmp_path / "a.wkt").write_text(COURT.wkt)
    feature = {"type": "Feature", "properties": {}, "geometry": json.loads(shapely.to_geojson(COURT))}
    (tmp_path / "a.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    for given in (tmp_path / "a.wkt", str(tmp_path / "a.geojson"), COURT, area):
        assert WalkableArea.of(given).geometry.equals(COURT)
    (tmp_path / "line.wkt").write_text("LINESTRING (0 0, 1 1)")
    (tmp_path / "broken.wkt").write_text("POLYGON ((0 0")
    (tmp_path / "endless.wkt").symlink_to("/dev/zero")
    for given, found in (
        (tmp_path / "line.wkt", "no polygon"),
        (tmp_path / "broken.wkt", "Exception"),
        (tmp_path / "missing.wkt", "No such file"),
        (shapely.Point(0, 0), "type Point"),
        (shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "not valid"),
        (tmp_path / "endless.wkt", "more than 256 MiB"),
        (3, "type int"),
    ):
        with pytest.raises(InputError, match=found):
            WalkableArea.of(given)


@drawn(st.floats(1.0001e8, 1.7e308), st.sampled_from([-1, 1]), st.sampled_from([0, 1]), st.booleans())
def test_coordinates_farther_than_positions_may_lie_are_refused(tmp_path_factory, far, sign, axis, in_file):
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners[2 if sign > 0 else 0, axis] = sign * far
    area: shapely.Polygon | Path = shapely.Polygon(corners)
    if in_file:
        area = tmp_path_factory.mktemp("areas") / "far.wkt"
        area.write_text(shapely.to_wkt(shapely.Polygon(corners), rounding_precision=-1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=r"within ±1e\+08|not valid") as error:
            WalkableArea.of(area)
    assert not in_file or "far.wkt" in str(error.value)


def test_a_passage_narrower_than_the_margins_confines_too():
    passage = shapely.box(0, 0, 10, 0.08)
    path = WalkableArea(passage).confined(np.array([[1.0, 0.5], [2.0, 0.04]]), np.array([0.5, 0.04]))
    assert passage.buffer(1e-6).covers(shapely.LineString([(0.5, 0.04), *path]))
