"""Figures of a report as files for papers: SVG and PDF."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path
from graphtrack.report.content import Picture, Report
from graphtrack.report.lives import pair_tracks
from graphtrack.report.plots.comparison import plot_person
from graphtrack.tracks.track import TrackSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("svg", "pdf")

MOST_PEOPLE = 12
"""Most people of whom there is a figure each."""


def save_figure(figure: Figure, path: Path) -> list[Path]:
    """Write a figure as SVG and PDF, with text as text; return the files.

    Parameters
    ----------
    path : without a suffix
    """
    import matplotlib

    written = []
    for kind in FORMATS:
        place = path.with_name(f"{path.name}.{kind}")
        settings: dict[Any, Any] = {"svg.fonttype": "none", "svg.hashsalt": "graphtrack", "pdf.fonttype": 42}
        # Without a date, so that the same figure is the same file.
        undated = {"Date" if kind == "svg" else "CreationDate": None}
        with matplotlib.rc_context(settings), atomic_path(place) as temporary:
            figure.savefig(temporary, format=kind, metadata=undated)
        written.append(place)
    return written


def write_figures(folder: str | Path, report: Report, people: Mapping[str, Figure]) -> list[Path]:
    """Write the figures of a report, and of people, as SVG and PDF; return the files.

    Parameters
    ----------
    folder : made if it is missing; files of the same names are replaced
    report : its pictures that are no photos of a file
    people : name → figure

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    folder = Path(folder)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError("no folder that can be made", "a folder for figures", path=folder) from error
    pictures = [item for section in report.sections for item in section.items if isinstance(item, Picture)]
    named = [(one.title, one.content) for one in pictures if not isinstance(one.content, bytes)]
    written: dict[Path, None] = {}
    for title, figure in (*named, *((f"person {name}", figure) for name, figure in people.items())):
        path, again = folder / _file_name(title), 1
        while path.with_name(f"{path.name}.{FORMATS[0]}") in written:
            again += 1
            path = folder / f"{_file_name(title)}-{again}"
        written |= dict.fromkeys(save_figure(figure, path))
    return list(written)


def figures_of_people(tracks: TrackSet, observations: TrackSet | None = None) -> dict[str, Figure]:
    """Return a figure of speed, heading, body and head over time of each of the first `MOST_PEOPLE`."""
    pairs = pair_tracks(tracks, observations)[:MOST_PEOPLE]
    return {pair.name: figure for pair in pairs if (figure := plot_person(pair)) is not None}


def _file_name(title: str) -> str:
    """Return the first words of a title, up to a comma or colon, as the name of a file."""
    words = re.sub(r"\W+", "-", re.split(r"[,:.]", title, maxsplit=1)[0].lower()).strip("-")
    return words[:60] or "figure"
