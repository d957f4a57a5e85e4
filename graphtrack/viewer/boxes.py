"""People's boxes, from files that have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from graphtrack.io.options import ReadOptions
from graphtrack.io.reading import boxes_of_file, read
from graphtrack.viewer.pictures import PersonBoxes

_BOXES, _OBSERVATIONS, _NUMBER = "boxes.txt", "observations.csv", "box"
"""In the folder of a report: boxes of people who were detected, and rows that name theirs by its place."""


def boxes_of(path: Path, format: str | None, options: ReadOptions) -> PersonBoxes | None:
    """The boxes of a file, or of the folder of a report; None where there are none, or nobody says whose.

    Raises
    ------
    InputError
        For files that cannot be read.
    """
    if path.is_dir():
        return _of_report(path)
    if options.layout() is not None:
        return None
    rows = boxes_of_file(path, format, options)
    if rows is None or not rows.has_identity:
        return None
    return PersonBoxes(rows.frame, rows.track_id, rows.channels["box"])


def _of_report(folder: Path) -> PersonBoxes | None:
    boxes, observations = folder / _BOXES, folder / _OBSERVATIONS
    if not boxes.is_file() or not observations.is_file():
        return None
    rows = boxes_of_file(boxes, None, ReadOptions())
    if rows is None:
        return None
    frame, who, box = [], [], []
    for track in read(observations):
        number = track.inputs.get(_NUMBER)
        if number is None:
            continue
        there = np.isfinite(number)
        frame.append(track.frame[there])
        who.append(np.full(int(there.sum()), track.track_id))
        box.append(rows.channels["box"][number[there].astype(int)])
    if not frame:
        return None
    return PersonBoxes(np.concatenate(frame), np.concatenate(who), np.concatenate(box))
