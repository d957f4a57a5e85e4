"""Motion-capture tables: one clip a track, with exact positions and the yaw of shoulders and head."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import wrap
from graphtrack.io.format import MOCAP_COLUMNS, Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import read_numbers
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import LARGEST_SECONDS

_LARGEST_YAW = 1e4


def read(source: Source, options: ReadOptions) -> Rows:
    """Read a table ``clip,frame,t_s,x_m,y_m,…,shoulder_yaw_rad,head_yaw_rad,…``.

    Body is the yaw of the shoulders, head that of the head, both in the world; tracks are numbered from 0 in
    the order of the clips and have the clip as their label. Times are those of the file.
    """
    header = source.lines[0].split(",")
    for name in MOCAP_COLUMNS:
        if name not in header:
            raise source.fail("no such column", f"a column {name}", line=1, column=name)
    column = header.index("clip")
    table = read_numbers(
        source, delimiter=",", widths=(len(header),), names=tuple(header), text=(column,), skip=1
    )
    clips = [clip.strip() for clip in table.text[column]]
    if "" in clips:
        line = table.line_of(clips.index(""))
        raise source.fail("an empty cell", "a clip", line=line, column="clip")
    number_of = {clip: k for k, clip in enumerate(dict.fromkeys(clips))}

    def yaw(name: str) -> np.ndarray:
        return wrap(table.bounded(header.index(name), -_LARGEST_YAW, _LARGEST_YAW))

    notes = ["body is the yaw of the shoulders"]
    if options.fps is not None:
        notes.append("the frame rate was not used: the file has times")
    return Rows(
        source.path,
        "mocap",
        np.array([number_of[clip] for clip in clips], dtype=np.int64),
        table.integers(header.index("frame")),
        {
            "t": table.bounded(header.index("t_s"), -LARGEST_SECONDS, LARGEST_SECONDS),
            "position": np.column_stack([table.metres(header.index(name)) for name in ("x_m", "y_m")]),
            "body": yaw("shoulder_yaw_rad"),
            "head": yaw("head_yaw_rad"),
        },
        table.line_of,
        labels={number: clip for clip, number in number_of.items()},
        notes=tuple(notes),
    )


MOCAP = Format(
    name="mocap",
    description="motion-capture table, a clip a track",
    suffixes=(),
    read=read,
)
