"""The page of a set of tracks, with what people do: `graphtrack report`, and `write_report` in Python."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from graphtrack.association.reading import tracks_of
from graphtrack.report.behaviour.given import behaviour_of
from graphtrack.report.build import tracking_report
from graphtrack.report.html import write_html

if TYPE_CHECKING:
    from graphtrack.behaviour.attention import Attention
    from graphtrack.behaviour.forecast.recorded import Forecasts
    from graphtrack.behaviour.groups import Groups
    from graphtrack.behaviour.places import Place
    from graphtrack.io.given import Given


def write_report(
    path: str | Path,
    tracks: Given,
    observations: Given | None = None,
    *,
    groups: Groups | str | Path | None = None,
    attention: Sequence[Attention] | str | Path | None = None,
    forecast: Forecasts | str | Path | None = None,
    places: Sequence[Place] | str | Path | None = None,
    title: str = "Tracks",
    subtitle: str = "",
) -> None:
    """Write the HTML report of tracks, with groups, looks and forecasts.

    Parameters
    ----------
    path : where it goes; an existing file is replaced
    tracks : estimates, or observations as they are
    observations : what was estimated from, matched by ``track_id``
    groups : of `graphtrack.groups`, or the file that ``graphtrack groups`` wrote
    attention : of `graphtrack.behaviour.attention.attention`, or the file that ``graphtrack attention`` wrote
    forecast : of `graphtrack.forecast`, or the file that ``graphtrack forecast`` wrote
    places : what else is looked at, or the file that says where it is
    title, subtitle : at the top

    Raises
    ------
    InputError
        For groups, looks and forecasts of people or frames that the tracks have not, files that cannot be
        read, and a place that cannot be written to.
    """
    tracks = tracks_of(tracks)
    observations = None if observations is None else tracks_of(observations)
    behaviour = behaviour_of(tracks, groups=groups, attention=attention, forecast=forecast, places=places)
    report = tracking_report(tracks, observations, title=title, subtitle=subtitle, behaviour=behaviour)
    write_html(path, report)
