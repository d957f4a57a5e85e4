"""Crowd measures against what is known of the paths: counts, densities, speeds and flow."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command import run

import graphtrack as gt
from graphtrack.interaction.people import Place, read_places
from graphtrack.report.crowd import crowd_sections

RATE = 10.0
SQUARE = np.array([[0.0, -5.0], [10.0, -5.0], [10.0, 5.0], [0.0, 5.0]])
ZONE, LINE = Place("hall", SQUARE), Place("door", np.array([[5.0, -5.0], [5.0, 5.0]]))


def walkers(n: int = 6, speed: float = 1.2, step: float = 1.0, frames: int = 150) -> gt.TrackSet:
    """People who walk through the square one after the other, every third in the other direction."""
    rows = []
    for one in range(n):
        way = -1.0 if one % 3 == 2 else 1.0
        for k in range(frames):
            x = 5.0 + way * (speed * (k / RATE - 6.0))
            frame = k + round(one * step * RATE)
            rows.append({"track_id": one, "frame": frame, "t": frame / RATE, "x": x, "y": 0.5 * one - 1.0})
    return gt.TrackSet.from_table(pd.DataFrame(rows))


def test_counts_stays_speeds_and_flow_are_those_of_the_paths() -> None:
    found = gt.crowd_measures(walkers(), [ZONE, LINE])
    (zone,), (line,) = (pd.DataFrame(one).to_dict("records") for one in (found.zones, found.lines))
    assert (zone["people"], zone["entered"], zone["left"]) == (6, 6, 6)
    assert zone["mean_stay"] == pytest.approx(10.0 / 1.2, abs=0.15)
    assert zone["mean_speed"] == pytest.approx(1.2)
    assert zone["area"] == pytest.approx(100.0)
    assert np.unique(found.visits["track_id"]).tolist() == [*range(6)]
    np.testing.assert_allclose(np.sort(found.visits["start"]), 6.0 - 5.0 / 1.2 + np.arange(6), atol=0.11)
    np.testing.assert_allclose(found.visits["end"] - found.visits["start"], found.visits["seconds"])
    np.testing.assert_allclose(found.visits["seconds"], 10.0 / 1.2, atol=0.11)
    # Left of the way from below to above is the side of smaller x.
    assert (line["crossed"], line["to_right"], line["to_left"]) == (6, 4, 2)
    assert line["length"] == 10.0 and line["specific_flow"] == pytest.approx(line["flow"] / 10.0)
    np.testing.assert_allclose(found.crossings["t"], 6.0 + np.arange(6), atol=0.11)
    np.testing.assert_array_equal(found.crossings["side"], ["right", "right", "left"] * 2)
    np.testing.assert_allclose(found.flow["speed"], 1.2, atol=1e-9)
    assert found.flow["flow"] == pytest.approx(1.2, abs=0.05)  # six people in five seconds


def test_who_leaves_a_zone_and_returns_stays_twice() -> None:
    t = np.arange(100) / RATE
    x = np.where((t >= 2.0) & (t < 5.0), 15.0, 5.0)  # outside for three seconds
    rows = [{"track_id": 7, "frame": k, "t": t[k], "x": x[k], "y": 0.0} for k in range(len(t))]
    found = gt.crowd_measures(gt.TrackSet.from_table(pd.DataFrame(rows)), [ZONE])
    np.testing.assert_allclose(found.visits["start"], [0.0, 5.0])
    np.testing.assert_allclose(found.visits["end"], [2.0, 10.0])
    (zone,) = pd.DataFrame(found.zones).to_dict("records")
    assert (zone["people"], zone["mean_stay"]) == (1, pytest.approx(3.5))


def test_people_in_an_exact_pattern_have_cells() -> None:
    """Cells of people on circles about the origin meet in one point, at which GEOS cannot intersect them."""
    angles = np.arange(8) * np.pi / 4.0
    circles = np.concatenate([r * np.stack([np.cos(angles), np.sin(angles)], axis=1) for r in (1.0, 3.0)])
    rows = [
        {"track_id": one, "frame": k, "t": k / RATE, "x": x, "y": y}
        for one, (x, y) in enumerate(circles.tolist())
        for k in range(5)
    ]
    zone = Place("round", SQUARE - [5.0, 0.0])
    found = gt.crowd_measures(gt.TrackSet.from_table(pd.DataFrame(rows)), [zone])
    assert np.all(found.density["people"] == 16)
    np.testing.assert_allclose(found.density["voronoi_density"], 0.16, rtol=1e-3)


@pytest.mark.parametrize("spacing", [0.8, 1.2])
def test_the_density_of_a_grid_is_that_of_its_cells(spacing: float) -> None:
    places = spacing * np.stack(np.meshgrid(np.arange(9), np.arange(9)), axis=-1).reshape(-1, 2)
    rows = [
        {"track_id": one, "frame": k, "t": k / RATE, "x": x, "y": y}
        for one, (x, y) in enumerate(places.tolist())
        for k in range(5)
    ]
    low, high = 2.5 * spacing, 5.5 * spacing  # along the borders of cells
    zone = Place("inside", np.array([[low, low], [high, low], [high, high], [low, high]]))
    found = gt.crowd_measures(gt.TrackSet.from_table(pd.DataFrame(rows)), [zone])
    np.testing.assert_allclose(found.density["voronoi_density"], spacing**-2, rtol=1e-6)
    np.testing.assert_array_equal(found.density["people"], 9)
    np.testing.assert_allclose(found.density["speed"], 0.0, atol=1e-12)


def test_turning_the_scene_changes_nothing() -> None:
    tracks, turn = walkers(), np.array([[0.0, -1.0], [1.0, 0.0]])
    turned = tracks.map(lambda track: gt.Track(**{**_columns(track), "position": track.position @ turn.T}))
    places = [Place(one.name, one.outline @ turn.T) for one in (ZONE, LINE)]
    first, second = gt.crowd_measures(tracks, [ZONE, LINE]), gt.crowd_measures(turned, places)
    for name in ("zones", "lines", "density", "crossings"):
        for column, values in getattr(first, name).items():
            other = getattr(second, name)[column]
            if values.dtype.kind == "f":
                np.testing.assert_allclose(other, values, atol=1e-7)
            else:
                np.testing.assert_array_equal(other, values)


def _columns(track: gt.Track) -> dict:
    return {"track_id": track.track_id, "frame": track.frame, "t": track.t}


def test_walls_and_zones_that_cannot_be_measured_are_errors() -> None:
    import shapely

    with pytest.raises(gt.InputError, match="people outside of the walkable area"):
        gt.crowd_measures(walkers(), [ZONE], walkable=shapely.box(0.0, -5.0, 10.0, 5.0))
    hook = Place("hook", np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [3.0, 1.0], [0.0, 4.0]]))
    with pytest.raises(gt.InputError, match=r"zone 'hook'.*convex"):
        gt.crowd_measures(walkers(), [hook])


@pytest.fixture
def files(cwd: Path) -> Path:
    gt.write(walkers(), "tracks.csv")
    Path("places.csv").write_text("name,polygon\nhall,0 -5 10 -5 10 5 0 5\ndoor,5 -5 5 5\n")
    return cwd


def test_the_command_writes_tables_and_the_report_a_section(files: Path) -> None:
    done = run(
        "crowd",
        "tracks.csv",
        "--places",
        "places.csv",
        "-o",
        "out",
        "--json",
        "out.json",
        program="graphtrack",
    )
    assert done.returncode == 0, done.stderr
    assert {one.name for one in Path("out").iterdir()} == {
        f"{name}.csv" for name in ("zones", "density", "visits", "lines", "crossings", "flow")
    }
    assert len(pd.read_csv("out/crossings.csv")) == 6
    summary = json.loads(Path("out.json").read_text())
    assert summary["lines"][0]["crossed"] == 6 and summary["zones"][0]["zone"] == "hall"
    (section,) = crowd_sections(walkers(), read_places("places.csv", lines=True))
    tables = [one for one in section.items if type(one).__name__ == "DataTable"]
    assert [table.title for table in tables] == ["Zones", "Lines"]
    assert any("PedPy" in getattr(one, "text", "") for one in section.items)


def test_a_line_is_no_target_of_gaze(files: Path) -> None:
    with pytest.raises(gt.InputError, match="three corners"):
        read_places("places.csv")
