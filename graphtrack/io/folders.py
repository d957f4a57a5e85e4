"""Folders that stand for a table within them."""

from __future__ import annotations

from pathlib import Path

_STAGES, _REPORTED = "stages.json", "tracks.csv"
"""The file by which the folder of a report is recognised, and its table of estimates."""

_OF_SEQUENCE = ("gt/gt.txt", "det/det.txt")
"""Tracks of a MOTChallenge sequence, and its detections, which are read where there are no tracks."""


def sequence_file(folder: Path) -> Path | None:
    """The tracks, or else the detections, of a folder that is a sequence of MOTChallenge."""
    if not folder.is_dir():
        return None
    return next((folder / name for name in _OF_SEQUENCE if (folder / name).is_file()), None)


def table_in(path: Path) -> Path:
    """The table that a folder of MOTChallenge or of `perception report` stands for; else the path itself."""
    if (path / _STAGES).is_file():
        return path / _REPORTED
    return sequence_file(path) or path
