"""Crowd measures by PedPy (extra ``pedpy``): density and speed in zones, flow across lines, and counts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.walkable import AreaLike, WalkableArea
from graphtrack.interaction.people import Place, read_places
from graphtrack.io.formats.pedpy import EXTRA, to_pedpy
from graphtrack.packages import package
from graphtrack.tracks.track import TrackSet

if TYPE_CHECKING:
    import pandas as pd

Columns = dict[str, NDArray[Any]]

SPEED_SECONDS = 0.4
"""Length of the window in which speeds are measured."""

STEP = 0.4
"""Seconds between the rows on a zone, unless frames are further apart."""

CUT_OFF = 1.0
"""Metres around a person to which their Voronoi cell is limited."""

FLOW_SECONDS = 10.0
"""Shortest interval in which a flow is measured."""

_MARGIN = 1.0
"""Metres around all people, of the area that bounds Voronoi cells where none is given."""


@dataclass(frozen=True, eq=False)
class CrowdMeasures:
    """Measures of zones and lines; each is a dictionary of columns.

    Attributes
    ----------
    zones : a row for each zone: zone, area (m²), people, entered, left, mean_people, most_people, mean_stay
        (s), mean_density, most_density (1/m²), mean_speed (m/s)
    density : a row for each zone and time: zone, frame, t, people, density (people over area),
        voronoi_density (1/m²),
        speed (m/s, mean of the people inside)
    lines : a row for each line: line, length (m), crossed, to_left, to_right, flow (1/s), specific_flow
        (1/(m s))
    visits : a row for each stay of a person in a zone: zone, track_id, start, end, seconds
    crossings : a row for each person's first crossing of a line: line, track_id, frame, t, side ("left" or
        "right", of the way from the first to the second point), count (so far)
    flow : a row for each line and interval: line, flow (1/s), speed (m/s, mean at the crossings)
    """

    zones: Columns
    density: Columns
    lines: Columns
    visits: Columns
    crossings: Columns
    flow: Columns


class _Recording(NamedTuple):
    """Trajectories of PedPy, the speeds, and the Voronoi cells of some frames."""

    module: Any
    trajectory: Any
    speed: pd.DataFrame
    cells: pd.DataFrame
    thinned: Any
    t: Mapping[int, float]
    step: int

    @property
    def rate(self) -> float:
        return float(self.trajectory.frame_rate)


def crowd_measures(
    tracks: TrackSet, places: Sequence[Place] | str | Path, *, walkable: AreaLike | None = None
) -> CrowdMeasures:
    """Return crowd measures in zones and across lines, by PedPy.

    Densities are classical (people over area) and of Voronoi cells, which end 1 m from a person and at walls
    (Steffen & Seyfried 2010); speeds are those of 0.4 s of the path. Of a person's crossings of a line the
    first counts.

    Parameters
    ----------
    tracks : of a steady rate, without gaps, as `smooth` returns them
    places : zones (discs and convex polygons) and lines (two points), or their file (`read_places`)
    walkable : area in which people walk; None: no walls

    Raises
    ------
    InputError
        If PedPy is not installed, the times have no steady rate, a zone is not convex, or people are outside
        of the walkable area.
    """
    module = package("pedpy", EXTRA)
    places = read_places(places, lines=True) if isinstance(places, str | Path) else list(places)
    if not any(np.isfinite(track.position).all(axis=1).any() for track in tracks):
        raise InputError("no positions", "tracks with positions")
    recording = _recording(tracks, module, walkable, places)
    zones = [one for one in places if not one.is_line]
    lines = [one for one in places if one.is_line]
    of_zones = [_of_zone(one, recording) for one in zones]
    of_lines = [_of_line(one, recording) for one in lines]
    return CrowdMeasures(
        _table([summary for summary, _, _ in of_zones]),
        _joined([columns for _, columns, _ in of_zones]),
        _table([summary for summary, _, _ in of_lines]),
        _joined([visits for _, _, visits in of_zones]),
        _joined([columns for _, columns, _ in of_lines]),
        _joined([columns for _, _, columns in of_lines]),
    )


def _recording(
    tracks: TrackSet, module: Any, walkable: AreaLike | None, places: Sequence[Place]
) -> _Recording:
    trajectory = to_pedpy(tracks)
    data = trajectory.data[["id", "frame", "x", "y"]]
    trajectory = module.TrajectoryData(data=data, frame_rate=trajectory.frame_rate)
    rate = float(trajectory.frame_rate)
    area = _area(module, trajectory, walkable, places)
    step = max(1, round(STEP * rate))
    kept = data[data["frame"] % step == 0]
    thinned = module.TrajectoryData(data=kept, frame_rate=rate)
    try:
        speed = module.compute_individual_speed(
            traj_data=trajectory,
            frame_step=max(1, round(SPEED_SECONDS * rate / 2.0)),
            speed_calculation=module.SpeedCalculation.BORDER_SINGLE_SIDED,
        )
        cells = _cells(module, thinned, area)
    except Exception as error:  # PedPy's errors have no common class before 1.3
        raise InputError(f"tracks that PedPy cannot measure ({error})", _EXPECTED) from error
    t = {
        frame: at
        for track in tracks
        for frame, at in zip(track.frame.tolist(), track.t.tolist(), strict=True)
    }
    return _Recording(module, trajectory, speed, cells, thinned, t, step)


def _cells(module: Any, trajectory: Any, area: Any) -> pd.DataFrame:
    """Return the Voronoi cells of people, who are moved by 0.1 mm where their cells cannot be intersected.

    People in an exact pattern, such as a circle about the origin, have cells with vertices on each other's
    edges, with which GEOS ends.
    """
    shapely = package("shapely", EXTRA)
    limit = module.Cutoff(radius=CUT_OFF, quad_segments=8)
    try:
        return module.compute_individual_voronoi_polygons(
            traj_data=trajectory, walkable_area=area, cut_off=limit
        )
    except shapely.errors.GEOSException:
        data = trajectory.data[["id", "frame", "x", "y"]].copy()
        data[["x", "y"]] += np.random.default_rng(0).uniform(-1e-4, 1e-4, (len(data), 2))
        moved = module.TrajectoryData(data=data, frame_rate=trajectory.frame_rate)
        return module.compute_individual_voronoi_polygons(traj_data=moved, walkable_area=area, cut_off=limit)


_EXPECTED = "tracks of a steady rate without gaps, as graphtrack smooth writes them"


def _area(module: Any, trajectory: Any, walkable: AreaLike | None, places: Sequence[Place]) -> Any:
    """Return PedPy's walkable area: the given one, or a box around all people and places."""
    shapely = package("shapely", EXTRA)
    if walkable is None:
        points = np.concatenate([trajectory.data[["x", "y"]].to_numpy(), *(one.outline for one in places)])
        reach = _MARGIN + CUT_OFF + max((one.radius for one in places), default=0.0)
        low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
        return module.WalkableArea(shapely.box(*low, *high))
    geometry = WalkableArea.of(walkable).geometry
    if geometry.geom_type != "Polygon":
        raise InputError("a walkable area of several polygons", "one polygon, which may have holes")
    area = module.WalkableArea(geometry)
    outside = module.get_invalid_trajectory(traj_data=trajectory, walkable_area=area)
    if len(outside):
        people = len(np.unique(outside["id"]))
        found = f"{len(outside)} rows of {people} people outside of the walkable area"
        raise InputError(found, "people inside of it, as 'graphtrack smooth --walkable' keeps them")
    return area


def _of_zone(zone: Place, recording: _Recording) -> tuple[dict[str, Any], Columns, Columns]:
    """Return the summary of a zone, its rows over time, and the stays of people in it."""
    module, shapely = recording.module, package("shapely", EXTRA)
    outline = (
        shapely.Point(zone.outline[0]).buffer(zone.radius) if zone.radius else shapely.Polygon(zone.outline)
    )
    if not outline.is_valid or not np.isclose(outline.convex_hull.area, outline.area, rtol=1e-9):
        raise InputError(f"the zone {zone.name!r}", "a convex polygon, as PedPy needs")
    area = module.MeasurementArea(outline)
    density = module.compute_classic_density(traj_data=recording.thinned, measurement_area=area)
    of_cells, _ = module.compute_voronoi_density(
        individual_voronoi_data=recording.cells, measurement_area=area
    )
    speed = module.compute_mean_speed_per_frame(
        traj_data=recording.thinned, individual_speed=recording.speed, measurement_area=area
    )
    table = density.set_index("frame").join(
        [
            of_cells.set_index("frame")["density"].rename("voronoi_density"),
            speed.set_index("frame")["speed"],
        ]
    )
    frames = [frame for frame in table.index.tolist() if frame % recording.step == 0 and frame in recording.t]
    table = table.loc[frames]
    people = np.rint(table["density"].to_numpy() * outline.area).astype(np.int64)
    speeds = np.where(people > 0, table["speed"].to_numpy(), np.nan)
    columns: Columns = {
        "zone": np.full(len(frames), zone.name, object),
        "frame": np.array(frames, np.int64),
        "t": np.array([recording.t[frame] for frame in frames]),
        "people": people,
        "density": table["density"].to_numpy(),
        "voronoi_density": table["voronoi_density"].to_numpy(),
        "speed": speeds,
    }
    entered, left, visits = _visits(zone.name, outline, recording)
    seconds = visits["seconds"]
    summary = {
        "zone": zone.name,
        "area": outline.area,
        "people": len(np.unique(visits["track_id"])),
        "entered": entered,
        "left": left,
        "mean_people": float(people.mean()),
        "most_people": int(people.max()),
        "mean_stay": float(np.mean(seconds)) if len(seconds) else np.nan,
        "mean_density": float(columns["voronoi_density"].mean()),
        "most_density": float(columns["voronoi_density"].max()),
        "mean_speed": float(np.average(speeds[people > 0], weights=people[people > 0]))
        if people.any()
        else np.nan,
    }
    return summary, columns, visits


def _visits(zone: str, outline: Any, recording: _Recording) -> tuple[int, int, Columns]:
    """Return how often people entered and left a zone, and their stays."""
    shapely = package("shapely", EXTRA)
    entered = left = 0
    people: list[NDArray[Any]] = []
    spans: list[FloatArray] = []
    for person, track in recording.trajectory.data.groupby("id"):
        inside = shapely.contains_xy(outline, track["x"].to_numpy(), track["y"].to_numpy())
        changes = np.diff(inside.astype(np.int8))
        entered, left = entered + int((changes > 0).sum()), left + int((changes < 0).sum())
        edges = np.flatnonzero(np.diff(inside.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
        start = np.array([recording.t[frame] for frame in track["frame"].to_numpy()[edges[:, 0]].tolist()])
        spans.append(np.column_stack([start, (edges[:, 1] - edges[:, 0]) / recording.rate]))
        people.append(np.full(len(edges), person, np.int64))
    start, seconds = np.concatenate(spans).T
    visits: Columns = {
        "zone": np.full(len(start), zone, object),
        "track_id": np.concatenate(people),
        "start": start,
        "end": start + seconds,
        "seconds": seconds,
    }
    return entered, left, visits


def _of_line(line: Place, recording: _Recording) -> tuple[dict[str, Any], Columns, Columns]:
    """Return the summary of a line, the crossings, and the flow in intervals."""
    module, rate = recording.module, recording.rate
    measured = module.MeasurementLine(line.outline)
    counts, crossed = module.compute_n_t(traj_data=recording.trajectory, measurement_line=measured)
    crossed = crossed.sort_values(["frame", "id"])
    sides = np.array([*_sides(line.outline, crossed, recording)], dtype=object)
    frames, n = crossed["frame"].to_numpy(dtype=np.int64), len(crossed)
    t = np.array([recording.t[frame] for frame in frames.tolist()])
    crossings: Columns = {
        "line": np.full(n, line.name, object),
        "track_id": crossed["id"].to_numpy(dtype=np.int64),
        "frame": frames,
        "t": t,
        "side": sides,
        "count": np.arange(1, n + 1),
    }
    flow: Columns = {"line": np.empty(0, object), "flow": np.empty(0), "speed": np.empty(0)}
    if n > 1 and frames[-1] > frames[0]:
        found = module.compute_flow(
            nt=counts,
            crossing_frames=crossed,
            individual_speed=recording.speed,
            delta_frame=round(FLOW_SECONDS * rate),
            frame_rate=rate,
        )
        flow = {
            "line": np.full(len(found), line.name, object),
            "flow": found["flow"].to_numpy(dtype=float),
            "speed": found["mean_speed"].to_numpy(dtype=float),
        }
    length = float(np.linalg.norm(line.outline[1] - line.outline[0]))
    all_frames = recording.trajectory.data["frame"]
    duration = (float(all_frames.max()) - float(all_frames.min())) / rate
    summary = {
        "line": line.name,
        "length": length,
        "crossed": n,
        "to_left": int((sides == "left").sum()),
        "to_right": int((sides == "right").sum()),
        "flow": n / duration if duration > 0.0 else np.nan,
        "specific_flow": n / duration / length if duration > 0.0 else np.nan,
    }
    return summary, crossings, flow


def _sides(line: FloatArray, crossed: pd.DataFrame, recording: _Recording) -> Iterator[str]:
    """Yield the side to which each person crosses a line, by the step in which they do."""
    along = line[1] - line[0]
    path_of = dict(iter(recording.trajectory.data.groupby("id")))
    for person, frame in zip(crossed["id"].tolist(), crossed["frame"].tolist(), strict=True):
        path = path_of[person]
        place = int(np.searchsorted(path["frame"].to_numpy(), frame))
        steps = path[["x", "y"]].to_numpy()[max(place - 1, 0) : place + 2]
        way = steps[-1] - steps[0]
        yield "left" if along[0] * way[1] - along[1] * way[0] > 0.0 else "right"


def _table(rows: list[dict[str, Any]]) -> Columns:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}


def _joined(parts: list[Columns]) -> Columns:
    return {name: np.concatenate([one[name] for one in parts]) for name in parts[0]} if parts else {}
