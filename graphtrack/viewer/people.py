"""People on the ground and their series, as entities of a recording; rows may arrive in parts."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.report.lives import observed_angle
from graphtrack.report.style import ANGLE_COLOURS, NORMAL_95, longest_step, probability_ellipse
from graphtrack.tracks.display import VELOCITY_COLOUR, person_colour, rgb
from graphtrack.tracks.track import Track
from graphtrack.tracks.validation import finite_rows
from graphtrack.viewer.recording import IntArray, LoggedEntities

GROUND: Final = "ground"
PEOPLE: Final = "ground/people"
SERIES: Final = "series"

_SERIES_COLOURS = {"x": "#D8DCE2", "y": "#CC79A7", "speed": VELOCITY_COLOUR, **ANGLE_COLOURS}
_ARROWS = {"body": 0.06, "head": 0.045}
"""Symbol lengths relative to the visible ground; at least `_SHORTEST` metres."""
_SHORTEST = {"body": 0.7, "head": 0.5}
_DOT, _LINE, _ARROW = -5.0, -0.8, -1.8
"""Radii in screen points, which Rerun expects as negative values."""
_STRIPS = {"ellipse": 255, "trail": 255, "forecast": 130}
"""Lines and their opacity."""
_TRAIL, _TRAIL_POINTS = 4.0, 20
"""Length of the trail behind a person in seconds, and its number of points."""
CIRCLE: Final = np.linspace(0.0, 2.0 * np.pi, 33)
"""Angles of the points of an ellipse."""


@dataclass
class _Known:
    """Rows of the last seconds and last shown angles of a person."""

    t: FloatArray = field(default_factory=lambda: np.empty(0))
    frame: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    position: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    angles: dict[str, float] = field(default_factory=dict)


class LoggedPeople:
    """All shown people.

    Parameters
    ----------
    recording : recording to draw in
    size : size of the visible ground in metres
    names : track id → label; by default the id
    series : ids of people whose series are kept; None: all
    """

    def __init__(
        self,
        recording: LoggedEntities,
        size: float,
        names: Mapping[int, str] | None = None,
        series: Collection[int] | None = None,
    ) -> None:
        self._to, self.size, self._names = recording, size, {} if names is None else names
        self._in_series = series
        self._known: dict[int, _Known] = {}

    def add(self, track: Track) -> None:
        """Show new rows of a person, or replacements of earlier rows."""
        known = self._known.get(track.track_id) or self._begin(track.track_id)
        track = track[finite_rows(track.position)] if not finite_rows(track.position).all() else track
        if not len(track):
            return
        path, rr = f"{PEOPLE}/{track.track_id}", self._to.rr
        self._rows(path, track, rr.Points2D.columns(positions=track.position))
        for name, share in _ARROWS.items():
            length = max(_SHORTEST[name], share * self.size)
            self._arrows(f"{path}/{name}", track, observed_angle(track, name), length)
        if track.covariance is not None:
            self._ellipses(f"{path}/ellipse", track, track.covariance[:, :2, :2])
        first = self._remember(known, track)
        self._holes(path, known, first)
        trail = _trails(known.t, known.position)[first:]
        at = known.t[first:], known.frame[first:]
        self._to.rows(f"{path}/trail", *at, rr.LineStrips2D.columns(strips=trail))
        if self._in_series is None or track.track_id in self._in_series:
            self._series(track, known)
        recent = known.t >= known.t[-1] - _TRAIL
        known.t, known.frame, known.position = known.t[recent], known.frame[recent], known.position[recent]

    def leave(self, before: float) -> None:
        """Hide people who have no rows from a time on."""
        for track_id, known in list(self._known.items()):
            if len(known.t) and known.t[-1] + longest_step(known.t) < before:
                t, frame = _next(known.t, known.frame)
                self._to.clear(f"{PEOPLE}/{track_id}", t, frame)
                del self._known[track_id]

    def remove(self, track_id: int, t: float, frame: int) -> None:
        """Remove a person at a time after a revision."""
        known = self._known.get(track_id)
        if known is None:
            return
        self._to.clear(f"{PEOPLE}/{track_id}", np.array([t]), np.array([frame]))
        kept = known.t != t
        known.t, known.frame, known.position = known.t[kept], known.frame[kept], known.position[kept]

    def place(self, track_id: int, t: float) -> FloatArray | None:
        """Position (2,) of a person at a time of the last seconds; None where unknown."""
        known = self._known.get(track_id)
        if known is None or not len(known.t):
            return None
        row = int(np.argmin(np.abs(known.t - t)))
        return known.position[row] if abs(known.t[row] - t) < 1e-6 else None

    def _begin(self, track_id: int) -> _Known:
        """Add a person who appears or reappears; colours and names are logged once."""
        self._known[track_id] = known = _Known()
        path, rr = f"{PEOPLE}/{track_id}", self._to.rr
        named = self._names.get(track_id, str(track_id))
        shade = rgb(person_colour(track_id))
        self._to.static(
            path, rr.Points2D.from_fields(colors=[shade], radii=[_DOT], labels=[named], show_labels=True)
        )
        for name, opacity in _STRIPS.items():
            look = rr.LineStrips2D.from_fields(colors=[(*shade, opacity)], radii=[_LINE])
            self._to.static(f"{path}/{name}", look)
        for name, shown in ANGLE_COLOURS.items():
            self._to.static(f"{path}/{name}", rr.Arrows2D.from_fields(colors=[rgb(shown)], radii=[_ARROW]))
        for name, shown in _SERIES_COLOURS.items():
            if self._in_series is not None and track_id not in self._in_series:
                break
            names = [name, f"{name} − 1.96 σ", f"{name} + 1.96 σ"]
            lines = rr.SeriesLines.from_fields(colors=[rgb(shown)] * 3, widths=[2.0, 0.7, 0.7], names=names)
            self._to.static(f"{SERIES}/{track_id}/{name}", lines)
        return known

    def _rows(self, path: str, track: Track, columns: Any) -> None:
        self._to.rows(path, track.t, track.frame, columns)

    def _arrows(self, path: str, track: Track, angle: FloatArray | None, length: float) -> None:
        if angle is None or not np.isfinite(angle).any():
            return
        there = np.isfinite(angle)
        vector = length * np.column_stack([np.cos(angle), np.sin(angle)])
        columns = self._to.rr.Arrows2D.columns(origins=track.position[there], vectors=vector[there])
        self._rows(path, track, columns.partition(there.astype(int)))

    def _ellipses(self, path: str, track: Track, covariance: FloatArray) -> None:
        ellipse = probability_ellipse(covariance)
        there = np.isfinite(ellipse.semi_major)
        if not there.any():
            return
        turned = np.stack([np.cos(ellipse.angle), np.sin(ellipse.angle)], axis=-1)[there, None, :]
        along = ellipse.semi_major[there, None, None] * np.cos(CIRCLE)[:, None] * turned
        across = ellipse.semi_minor[there, None, None] * np.sin(CIRCLE)[:, None] * turned[..., ::-1] * [-1, 1]
        strips = track.position[there, None, :] + along + across
        columns = self._to.rr.LineStrips2D.columns(strips=strips)
        self._rows(path, track, columns.partition(there.astype(int)))

    @staticmethod
    def _remember(known: _Known, track: Track) -> int:
        """Insert new rows among the known rows, and return the index of the first."""
        t = np.concatenate([track.t, known.t])
        at, row = np.unique(t, return_index=True)  # for equal times the first, which is the new row
        known.t = at
        known.frame = np.concatenate([track.frame, known.frame])[row]
        known.position = np.concatenate([track.position, known.position])[row]
        return int(np.searchsorted(at, track.t[0]))

    def _holes(self, path: str, known: _Known, first: int) -> None:
        """Hide the person where the rows have a hole."""
        start = max(first - 1, 0)
        t, frame = known.t[start:], known.frame[start:]
        before = np.flatnonzero(np.diff(t) > longest_step(known.t))
        step, frames = _step(known.t, known.frame)
        self._to.clear(path, t[before] + step, frame[before] + frames)

    def _series(self, track: Track, known: _Known) -> None:
        values: dict[str, FloatArray | None] = {"x": track.position[:, 0], "y": track.position[:, 1]}
        speed = track.velocity
        values["speed"] = None if speed is None else np.hypot(speed[:, 0], speed[:, 1])
        std: dict[str, FloatArray | None] = {"x": track.std("x"), "y": track.std("y"), "speed": None}
        for name in ANGLE_COLOURS:
            angle = observed_angle(track, name)
            values[name] = None if angle is None else np.degrees(_unwrapped(angle, known.angles, name))
            std[name] = np.degrees(track.std(name))
        for name, value in values.items():
            if value is None or not np.isfinite(value).any():
                continue
            spread = std[name]
            there = np.isfinite(value)
            lines = value[there, None]
            if spread is not None and np.isfinite(spread[there]).all():
                lines = lines + NORMAL_95 * spread[there, None] * [0.0, -1.0, 1.0]
            columns = self._to.rr.Scalars.columns(scalars=lines.ravel())
            sizes = np.full(len(lines), lines.shape[1])
            at = track.t[there], track.frame[there]
            self._to.rows(f"{SERIES}/{track.track_id}/{name}", *at, columns.partition(sizes))


def _trails(t: FloatArray, position: FloatArray) -> FloatArray:
    """Return (n, points, 2) trails of n rows over the last seconds; no trail crosses a hole."""
    row = np.arange(len(t))
    after_hole = np.concatenate([[True], np.diff(t) > longest_step(t)])
    begun = np.maximum.accumulate(np.where(after_hole, row, 0))
    first = np.maximum(np.searchsorted(t, t - _TRAIL), begun)
    share = np.linspace(0.0, 1.0, _TRAIL_POINTS)
    return np.asarray(position[np.round(first[:, None] + (row - first)[:, None] * share).astype(int)])


def _unwrapped(angle: FloatArray, last: dict[str, float], name: str) -> FloatArray:
    """Return angles (n,) unwrapped at ±π, continuing the previous angles."""
    there = np.isfinite(angle)
    out = np.array(angle, dtype=float)
    if there.any():
        before = [last[one] for one in (name, *last) if one in last][:1]  # the head begins near the body
        out[there] = np.unwrap(np.concatenate([before, angle[there]]))[len(before) :]
        last[name] = float(out[there][-1])
    return out


def _step(t: FloatArray, frame: IntArray) -> tuple[float, int]:
    """Return seconds and frames from row to row."""
    times = np.unique(t)  # rows of several sensors may have one time
    if len(times) < 2:
        return 0.04, 1
    return float(np.median(np.diff(times))), max(1, int(np.median(np.diff(frame))))


def _next(t: FloatArray, frame: IntArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the expected time of the next row, (1,) each."""
    seconds, frames = _step(t, frame)
    return t[-1:] + seconds, frame[-1:] + frames
