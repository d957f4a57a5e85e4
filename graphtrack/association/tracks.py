"""`associate`: whatever holds detections becomes tracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from graphtrack.association.rows import associated
from graphtrack.io.given import tracks_of
from graphtrack.io.options import ReadOptions
from graphtrack.io.reading import is_table, rows_of_file, rows_of_frame
from graphtrack.model import Model
from graphtrack.scene import GivenScene, known_values
from graphtrack.table.columns import rows_of_table
from graphtrack.tracks import Track, TrackSet, to_columns

if TYPE_CHECKING:
    import pandas as pd

    from graphtrack.table.rows import Rows

    Detected: TypeAlias = TrackSet | Track | str | Path | pd.DataFrame | Mapping[str, Any] | Sequence[Track]


def associate(
    detections: Detected,
    scene: GivenScene = None,
    *,
    model: Model | str | Path | None = None,
    fps: float | None = None,
    **options: Any,
) -> TrackSet:
    """Find out who is who in a recording: one track a person, with a row for each frame from first to last.

    Parameters
    ----------
    detections : a file, a table with or without ``track_id``, or tracks whose identities are forgotten
    scene : what is known of how people come, go and are detected: `SceneParameters`, or some of them by their
        names. The others are as the model has them, else learned from the detections
    model : a model, or a model file, whose scene it is
    fps : frames a second, where there are no times
    **options : for files, the other fields of `ReadOptions`

    Returns
    -------
    TrackSet
        Observations, to be smoothed. ``identity_p`` says how probable it is that a row is of whom the track
        had before; ``observed`` is 0 in frames in which nobody was seen. What was taken for false is left
        out, and counted in the summary.

    Raises
    ------
    InputError
        If the input cannot be read, or has no detection with a position.
    """
    of_model = {} if model is None else Model.named(model).scene
    return associated(rows_of(detections, fps=fps, **options), {**of_model, **known_values(scene)})


def rows_of(
    detections: Detected, *, format: str | None = None, fps: float | None = None, **options: Any
) -> Rows:
    """The rows of whatever holds detections, with the identities that they have.

    Raise InputError if the input cannot be read.

    Parameters
    ----------
    format : of a file; None: recognised by its content
    """
    if isinstance(detections, str | Path):
        return rows_of_file(detections, format, ReadOptions(fps=fps, **options))
    if is_table(detections):
        return rows_of_frame(detections, ReadOptions(fps=fps, **options))
    return rows_of_table(to_columns(tracks_of(detections)))
