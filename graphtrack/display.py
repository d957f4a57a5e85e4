"""What objects say of themselves: one short line, and a small table for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from graphtrack.tracks import Track, TrackSet

MOST = 10
"""Rows of a table, and names in a list, beyond which the rest is only counted."""

LONGEST = 40
"""Characters of a label that are shown."""


def html_table(caption: str, header: Sequence[str], rows: Iterable[Sequence[object]], more: int = 0) -> str:
    """A table as HTML, with the number of rows that are not shown; whatever stands in it is text."""
    lines = [f"<table><caption>{escape(caption)}</caption>"]
    if header:
        lines.append("<tr>" + "".join(f"<th>{escape(name)}</th>" for name in header) + "</tr>")
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>")
    if more:
        lines.append(f'<tr><td colspan="{len(header)}">… and {more} more</td></tr>')
    return "".join([*lines, "</table>"])


def html_pairs(caption: str, pairs: Mapping[str, object]) -> str:
    """Names and what they stand for, as an HTML table."""
    return html_table(caption, (), pairs.items())


def listed(names: Iterable[object], most: int = MOST) -> str:
    """Names with commas; of many the first and how many more."""
    known = [one if len(one := str(name)) <= 2 * LONGEST else f"{one[: LONGEST - 1]}…" for name in names]
    more = f" and {len(known) - most} more" if len(known) > most else ""
    return ", ".join(known[:most]) + more


def counted(count: int, noun: str) -> str:
    """A number and its noun, with an s where there are several."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def duration(seconds: float) -> str:
    """Seconds with the digits that count: thousandths below one, tenths above."""
    return f"{seconds:.3f} s" if seconds < 1.0 else f"{seconds:.1f} s"


def shortened(text: str) -> str:
    """A text of any length and its quotes; no more than `LONGEST` characters of it."""
    return repr(text if len(text) <= LONGEST else text[: LONGEST - 1] + "…")


def line_of_track(track: Track) -> str:
    """Such as ``Track(7, 'crosses', 200 frames, 0.0–19.9 s, body, head; truth)``."""
    label = [shortened(track.label)] if track.label else []
    parts = [str(track.track_id), *label, counted(len(track), "frame"), _contents([track])]
    return f"Track({', '.join(parts)})"


def line_of_tracks(tracks: TrackSet) -> str:
    """Such as ``TrackSet(3 tracks, 600 person-frames, 0.0–19.9 s, body, head; truth)``."""
    parts = [counted(len(tracks), "track")]
    if len(tracks):
        parts += [counted(tracks.n_frames, "person-frame"), _contents(tracks.tracks)]
    return f"TrackSet({', '.join(parts)}{'; camera' if tracks.camera is not None else ''})"


def _contents(tracks: Sequence[Track]) -> str:
    begin, end = min(track.t[0] for track in tracks), max(track.t[-1] for track in tracks)
    words = [f"{begin:.1f}–{end:.1f} s"]
    for name, fields in (
        ("pixels", ("pixel",)),
        ("body", ("body", "body_likelihood")),
        ("head", ("head", "head_likelihood")),
    ):
        if any(getattr(track, field) is not None for track in tracks for field in fields):
            words.append(name)
    text = ", ".join(words)
    if any(track.covariance is not None for track in tracks):
        text += "; estimates"
    return text + ("; truth" if any(track.has_truth for track in tracks) else "")


def html_of_track(track: Track) -> str:
    """The channels of a track, and in how many of its frames each is known."""
    rows = []
    for name in ("position", "pixel", "body", "body_likelihood", "head", "head_likelihood", "velocity"):
        values = getattr(track, name)
        if values is not None:
            rows.append((name, _known(values)))
    return html_table(line_of_track(track), ("channel", f"of {counted(len(track), 'frame')}"), rows)


def html_of_tracks(tracks: TrackSet) -> str:
    """The first tracks of a set: how long each is, and in how many frames what is known."""
    header = ("id", "label", "frames", "from (s)", "to (s)", "position", "body", "head")
    rows = (
        (
            track.track_id,
            track.label[:LONGEST],
            len(track),
            f"{track.t[0]:.1f}",
            f"{track.t[-1]:.1f}",
            _known(track.position),
            _known(track.body, track.body_likelihood),
            _known(track.head, track.head_likelihood),
        )
        for track in tracks.tracks[:MOST]
    )
    return html_table(line_of_tracks(tracks), header, rows, max(0, len(tracks) - MOST))


def _known(*channels: np.ndarray | None) -> int:
    """In how many frames any of the channels is known."""
    given = [np.isfinite(c.reshape(len(c), -1)).all(axis=1) for c in channels if c is not None]
    return int(np.logical_or.reduce(given).sum()) if given else 0
