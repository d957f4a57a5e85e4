"""TrajNet++ text: a JSON object a line, a ``scene`` or a position of a ``track`` (Kothari et al. 2021)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.io.format import Format, rate_to_write
from graphtrack.io.formats.ndjson import parse_line
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.tracks.detections import frames_between
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import TrackSet
from graphtrack.tracks.validation import LARGEST_FRAME, LARGEST_ID, LARGEST_METRES, is_number

_KINDS = ("scene", "track")
_PREDICTED = "prediction_number"
_LARGEST = {"f": LARGEST_FRAME, "p": LARGEST_ID, "x": LARGEST_METRES, "y": LARGEST_METRES}
_PREDICTIONS = "predictions of a scene"
_EXPECTED = 'a line {"scene": {…}} or {"track": {"f": frame, "p": person, "x": metres, "y": metres}}'


def read(source: Source, options: ReadOptions) -> Rows:
    """Read positions in metres. Scenes state the frame rate; predictions are refused."""
    cells: list[list[float]] = []
    lines: list[int] = []
    rates: set[float] = set()
    for number, line in enumerate(source.lines, 1):
        if not line.strip():
            continue
        kind, values = _parsed(source.path, number, line)
        if kind == "scene":
            if is_number(values.get("fps")) and values["fps"] > 0.0:
                rates.add(float(values["fps"]))
            continue
        cells.append([_number(source.path, number, values, key) for key in _LARGEST])
        cells[-1].append(float(values.get(_PREDICTED) is not None))
        lines.append(number)
    if not cells:
        raise InputError("no track", _EXPECTED, path=source.path)
    table = np.array(cells)
    frame = table[:, 0].astype(np.int64)
    rows = Rows(
        source.path,
        "trajnet",
        table[:, 1].astype(np.int64),
        frame,
        {"position": table[:, 2:4]},
        lambda row: lines[row],
    )
    rows = rows.keep(table[:, 4] == 0.0, _PREDICTIONS)
    if options.fps is not None:
        return rows.with_times(options.fps)
    if len(rates) != 1:
        found = "no frame rate in a scene" if not rates else f"scenes of {len(rates)} frame rates"
        raise InputError(found, "one rate in all scenes, or --fps", path=source.path)
    step, rate = frames_between(rows.frame), rates.pop()
    note = f"frame rate {rate * step:g} Hz: the scenes have {rate:g} Hz and the frames step by {step}"
    return rows.with_notes(note).with_times(rate * step)


def _parsed(path: Path, number: int, line: str) -> tuple[str, dict[str, Any]]:
    """Kind and values of a line."""
    try:
        pairs = parse_line(line)
    except InputError as error:
        raise InputError(error.found, _EXPECTED, path=path, line=number, column=error.column) from error
    if len(pairs) == 1 and pairs[0][0] in _KINDS and isinstance(pairs[0][1], tuple):
        return pairs[0][0], dict(pairs[0][1])
    raise InputError(repr(line.strip()[:60]), _EXPECTED, path=path, line=number)


def _number(path: Path, line: int, values: dict[str, Any], key: str) -> float:
    value: Any = values.get(key)
    is_integer = key in ("f", "p")
    if is_number(value) and abs(value) <= _LARGEST[key] and not (is_integer and value != int(value)):
        return float(value)
    kind = "an integer" if is_integer else "metres"
    expected = f"{kind} within ±{_LARGEST[key]:g}"
    raise InputError(repr(value)[:60], expected, path=path, line=line, column=key)


def write(tracks: TrackSet, path: Path) -> None:
    """Write positions, and a scene for each track, from its first frame with a position to its last."""
    rate = rate_to_write(tracks, path)
    known = [np.isfinite(track.position).all(axis=1) for track in tracks]
    frames = [track.frame[some] for track, some in zip(tracks, known, strict=True)]
    fps = rate / frames_between(np.concatenate(frames)) if any(map(len, frames)) else rate
    positions = sorted(
        (frame, track.track_id, *place)
        for track, some in zip(tracks, known, strict=True)
        for frame, place in zip(track.frame[some].tolist(), track.position[some].tolist(), strict=True)
    )
    with path.open("w", encoding="ascii", newline="\n") as stream:
        for k, (track, own) in enumerate(zip(tracks, frames, strict=True)):
            if len(own):
                scene = {"id": k, "p": track.track_id, "s": int(own[0]), "e": int(own[-1]), "fps": fps}
                stream.write(json.dumps({"scene": scene}) + "\n")
        for values in positions:
            stream.write(json.dumps({"track": dict(zip(_LARGEST, values, strict=True))}) + "\n")


TRAJNET = Format(
    name="trajnet",
    description="TrajNet++: scenes and positions, a JSON object a line",
    suffixes=(".trajnet.ndjson",),
    read=read,
    write=write,
)
