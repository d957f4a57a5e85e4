"""Tracks in a window of Rerun, or in a file for one: `graphtrack view`, and `view` in Python."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.association.associate import tracks_of
from graphtrack.errors import InputError
from graphtrack.io.atomic import check_place
from graphtrack.io.sensors import SensorScene
from graphtrack.report.interaction import behaviour_of
from graphtrack.report.lives import observed_angle, pair_track
from graphtrack.report.sensors import shown_sensors
from graphtrack.tracks.track import TrackSet
from graphtrack.tracks.validation import finite_rows
from graphtrack.viewer.interaction import arrange_groups, show_forecasts, show_ground, show_groups
from graphtrack.viewer.layout import Extent, circles_of, layout
from graphtrack.viewer.people import LoggedPeople
from graphtrack.viewer.pictures import FrameTimes, PersonBoxes, open_frames, show_boxes, show_frames
from graphtrack.viewer.recording import CLOCK_TIMES, Target, recording
from graphtrack.viewer.sensors import show_sensors

if TYPE_CHECKING:
    from graphtrack.forecasting.recorded import Forecasts
    from graphtrack.geometry.angles import FloatArray
    from graphtrack.interaction.groups import Groups
    from graphtrack.io.read_write import Given
    from graphtrack.io.sensors import SensorsLike


def view(
    tracks: Given,
    *,
    save: str | Path | None = None,
    connect: str | None = None,
    groups: Groups | str | Path | None = None,
    forecast: Forecasts | str | Path | None = None,
    video: str | Path | None = None,
    boxes: PersonBoxes | None = None,
    person: int | str | None = None,
    sensors: SensorsLike | None = None,
) -> None:
    """Show tracks in Rerun: the ground from above, the video, and series of one person, on one time line.

    Needs the extra ``view``.

    Parameters
    ----------
    tracks : estimates, or unmodified observations
    save : the file (.rrd) to write, atomically
    connect : the URL of a running viewer. Without either a window opens
    groups : result of `graphtrack.groups`, or the file that ``graphtrack groups`` wrote
    forecast : result of `graphtrack.forecast`, or the file that ``graphtrack forecast`` wrote
    video : video, or folder of images, with the frame numbers of the tracks
    boxes : boxes of people in its frames
    person : id or name of the person whose time series are drawn; by default the person with most rows
    sensors : descriptions of the sensors, or their file, with fields of view; others are learned

    Raises
    ------
    InputError
        Without the package or a display, for people and frames that are not in the tracks, for files that
        cannot be read, and a path that cannot be written.
    """
    target = Target(None if save is None else Path(save), connect)
    target.check()
    tracks = tracks_of(tracks)
    if target.save is not None:
        check_place(target.save)
    placed = [track for track in tracks if finite_rows(track.position).any()]
    if not placed:
        raise InputError("no position", "tracks with positions in metres")
    chosen = (max(placed, key=len) if person is None else tracks.by_id(person)).track_id
    given = behaviour_of(tracks, groups=groups, forecast=forecast)
    frames = None if video is None else open_frames(Path(video))
    where = Extent.of(np.concatenate([track.position for track in placed]))
    if given is not None and given.forecasts is not None:
        where = where.around(circles_of(given.forecasts), 0.0)
    end = max(float(track.t[-1]) for track in placed)
    clock = min(float(track.t[0]) for track in placed) >= CLOCK_TIMES
    arranged = layout(where, chosen, series=_series(tracks, chosen), video=bool(frames or boxes))
    with recording(target, arranged, clock=clock) as made:
        show_ground(made, where)
        shown = shown_sensors(map(pair_track, placed), None if sensors is None else SensorScene.of(sensors))
        show_sensors(made, shown, placed)
        people = LoggedPeople(made, where.size, _names(tracks))
        for track in placed:
            people.add(track)
        people.leave(end)
        place = _TrackPositions(tracks)
        if given is not None and given.groups is not None:
            arrange_groups(made)
            show_groups(made, given.groups, place)
        if given is not None and given.forecasts is not None:
            show_forecasts(made, given.forecasts, place)
        times = FrameTimes(tracks)
        if boxes is not None:
            show_boxes(made, boxes, times, [track.track_id for track in tracks])
        if frames is not None:
            show_frames(made, frames, times)


class _TrackPositions:
    """Return positions of people, from their tracks."""

    def __init__(self, tracks: TrackSet) -> None:
        self._tracks = {track.track_id: track for track in tracks}

    def __call__(self, person: int, t: float) -> FloatArray | None:
        """As `graphtrack.viewer.interaction.Place`."""
        track = self._tracks[person]
        row = min(int(np.searchsorted(track.t, t - 1e-6)), len(track) - 1)
        there = abs(track.t[row] - t) < 1e-3 and np.isfinite(track.position[row]).all()
        return track.position[row] if there else None


def _names(tracks: TrackSet) -> Mapping[int, str]:
    """Return names of people if the table identifies them by text."""
    return {} if tracks.as_read is None else tracks.as_read.names


def _series(tracks: TrackSet, person: int) -> list[str]:
    """Return the known series of a person."""
    track = tracks.by_id(person)
    angles = [name for name in ("body", "head") if observed_angle(track, name) is not None]
    return ["x", "y", *([] if track.velocity is None else ["speed"]), *angles]
