"""Walkable areas of streams: `graphtrack track - --walkable`, its saved state, and the service."""

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from command import Done, run

from graphtrack.geometry.walkable import WalkableArea

CORRIDOR = shapely.union_all([shapely.box(0, 0, 20, 2), shapely.box(18, 0, 20, 12)])
NOISE = 0.3
Rows = list[dict[str, Any]]


def corridor_rows(people: int, seed: int, identities: bool = True, near: bool = False) -> Rows:
    """Rows of people who walk round the corner of a corridor 4 s after each other, perhaps near a wall."""
    rng, rows = np.random.default_rng(seed), []
    for k in range(people):
        aside = 0.15 if near else rng.uniform(0.12, 1.88)
        corners = np.array([[0.3, aside], [20.0 - aside, aside], [20.0 - aside, 11.7]])
        along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
        at = np.arange(0.0, along[-1], 0.26)
        path = np.column_stack([np.interp(at, along, corners[:, axis]) for axis in range(2)])
        for step, (x, y) in enumerate(np.round(rng.normal(path, NOISE), 3).tolist()):
            frame = 20 * k + step
            row = {"frame": frame, "t": round(0.2 * frame, 3), "x": x, "y": y, "pos_std": NOISE}
            rows.append(({"track_id": k} if identities else {}) | row)
    return sorted(rows, key=lambda row: row["frame"])


def share_outside(answers: Rows, least: int = 400) -> float:
    position = np.array([[one["x"], one["y"]] for one in answers if one.get("x") is not None])
    assert len(position) > least
    return 1.0 - float(WalkableArea(CORRIDOR).contains(position).mean())


@pytest.fixture
def area(tmp_path: Path) -> Path:
    path = tmp_path / "corridor.wkt"
    path.write_text(CORRIDOR.wkt)
    return path


def track(rows: Rows, *options: object) -> tuple[Done, Rows]:
    given = ("--model", "position", "--engine", "fixed-lag", *options)
    done = run("track", "-", *given, program="graphtrack", rows=rows)
    return done, [json.loads(line) for line in done.stdout.splitlines()]


def test_estimates_of_a_stream_stay_inside(area: Path) -> None:
    rows = corridor_rows(5, 4)
    _, plain = track(rows)
    done, walled = track(rows, "--walkable", area)
    assert done.returncode == 0 and len(walled) == len(plain) == len(rows) > 500
    assert share_outside(plain) > 0.01 and share_outside(walled) <= 0.001


def test_tracked_detections_of_a_stream_stay_inside(area: Path) -> None:
    rows = corridor_rows(2, 5, identities=False, near=True)
    _, plain = track(rows, "--lag", "1")
    _, walled = track(rows, "--lag", "1", "--walkable", area, "--forecast", "2")
    assert share_outside(plain, 200) > 0.01 and share_outside(walled, 200) == 0.0
    ahead = np.array([[at["x"], at["y"]] for one in walled if "forecast" in one for at in one["forecast"]])
    assert len(ahead) > 1000 and WalkableArea(CORRIDOR.buffer(1e-6)).contains(ahead).all()


def test_an_area_travels_to_other_processes() -> None:
    area = pickle.loads(pickle.dumps(WalkableArea(CORRIDOR)))
    position = np.random.default_rng(0).uniform(-1.0, 13.0, (50, 2))
    np.testing.assert_array_equal(area.walls(position), WalkableArea(CORRIDOR).walls(position))
    assert area.digest() == WalkableArea(CORRIDOR.reverse()).digest()
    assert area.digest() != WalkableArea(CORRIDOR.buffer(0.01)).digest()


@pytest.mark.parametrize("command", [["track", "-"], ["serve", "--port", "0"]])
def test_an_area_that_is_none_is_refused_before_any_row(command: list[str], tmp_path: Path) -> None:
    path = tmp_path / "line.wkt"
    path.write_text("LINESTRING (0 0, 1 1)")
    done = run(*command, "--walkable", path, program="graphtrack")
    assert done.returncode == 2 and "no polygon" in done.stderr
