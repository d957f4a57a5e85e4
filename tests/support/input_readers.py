"""Every function that reads a file or a line from outside, each with a small valid input."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from format_samples import SAMPLES, Sample, name_of

from graphtrack import io
from graphtrack.errors import InputError
from graphtrack.forecasting.motion import ForecastParameters
from graphtrack.forecasting.recorded import is_forecast, read_forecasts
from graphtrack.geometry.walkable import WalkableArea
from graphtrack.interaction.attention import AttentionParameters
from graphtrack.interaction.group_files import read_groups
from graphtrack.interaction.parameters import GroupParameters
from graphtrack.interaction.people import read_places
from graphtrack.interaction.tables import read_attention, read_gaze, read_group_table
from graphtrack.io.cameras import read_calibration, read_homography
from graphtrack.io.formats.ndjson import parse_line, plain_cells, read_cells
from graphtrack.io.suggestion import suggest
from graphtrack.model import Model
from graphtrack.streaming.protocol import StreamNames, UnknownKeys, error_row, text_of
from graphtrack.tracks.track import Track, TrackSet
from perception.detection.boxes import read_boxes
from perception.detection.keypoint_files import read_keypoints

Read = Callable[[Path], object]


@dataclass(frozen=True)
class InputReader:
    """A function that reads the file ``name``, and a valid content, which lies next to other files."""

    label: str
    name: str
    content: bytes
    read: Read
    beside: Mapping[str, bytes] = field(default_factory=dict)

    def write(self, folder: Path, content: bytes) -> Path:
        """Write a content, and the accompanying files; return its path."""
        for name, data in {**self.beside, self.name: content}.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        return folder / self.name


def answer_line(path: Path) -> None:
    """Read a line as a stream does; an invalid line is answered and not raised."""
    line, notes = path.read_bytes().split(b"\n")[0], list[str]()
    for options in (StreamNames(), StreamNames({"x": "easting"}, 10**6)):
        lines, names = options.beginning(iter([(1, line)]), lambda number, text: None, notes.append)
        for number, text in names.native_lines(lines):
            plain_cells(text)
            pairs: Any = ()
            try:
                pairs = parse_line(text_of(text))
                UnknownKeys(notes.append)(pairs)
                read_cells(pairs)
            except InputError as error:
                json.dumps(error_row(pairs, number, error))


def _keypoints() -> bytes:
    people = [{"image_id": 1, "keypoints": [1.0, 2.0, 0.5] * 17, "score": 0.5, "bbox": [0, 0, 10, 20]}]
    names = [{"id": 1, "file_name": "a_0001.jpg"}]
    return json.dumps({"annotations": people, "images": names, "categories": [{"id": 1}]}).encode()


def as_checked(tracks: TrackSet) -> None:
    """Assert that all rows are counted, and that a reader's arrays pass the checks of a user's own."""
    assert isinstance(tracks, TrackSet) and tracks.summary.rows_used == tracks.n_frames
    for track in tracks:
        checked = Track(**vars(track))
        for name, value in vars(track).items():
            if isinstance(value, np.ndarray):
                assert value.dtype == getattr(checked, name).dtype and not value.flags.writeable
                np.testing.assert_array_equal(value, getattr(checked, name))


def _of_format(sample: Sample, *, named: bool) -> Read:
    options = {**sample.options, **({"format": sample.format} if named else {})}
    return lambda path: as_checked(io.read_identified(path, **options))


_BOX = b"0,1,10,20,30,40,1,-1,-1,-1\n1,1,10,20,30,40,1,-1,-1,-1\n"
_CALIBRATION = b"""FocalLengthX = 900\nFocalLengthY = 900\nPrincipalPointX = 480\nPrincipalPointY = 270
TranslationX = 0\nTranslationY = 1\nTranslationZ = 9
RotationX = 0.9\nRotationY = 0.1\nRotationZ = 0.1\nRotationW = 0.4
"""
_ROW = (
    b'{"track_id": 1, "frame": 0, "t": 0.5, "x": 1.5, "y": 2, "head_p0": 0.5, "label": "a", "input_a": 1}\n'
)
_PAIRS = b"# u v X Y\n0 0 0 0\n100 0 1 0\n100 100 1 -1\n0 100 0 -1.1\n"

OPTION_FILES = (
    InputReader("stream", "row.txt", _ROW, answer_line),
    InputReader("homography", "h.txt", b"0.01 0 0\n0 -0.01 0\n0 0.0001 1\n", read_homography),
    InputReader("calibration", "c.ci", _CALIBRATION, read_calibration),
    InputReader(
        "point pairs",
        "pairs.txt",
        _PAIRS,
        lambda path: io.read_identified(path.parent / "boxes.txt", point_pairs=path),
        {"boxes.txt": _BOX},
    ),
    InputReader(
        "seqinfo",
        "seqinfo.ini",
        b"[Sequence]\nframeRate=25\nimWidth=9\nimHeight=8\n",
        lambda path: io.read_identified(path.parent / "gt" / "gt.txt", metres_per_pixel=0.01),
        {"gt/gt.txt": _BOX},
    ),
    InputReader("groups of SALSA", "g.txt", b"0.5 < 1 2 > < 3 >\n1.5 < 1 3 >\n", read_groups),
    InputReader("groups of ETH", "g.txt", b"1 2\n3 4\n", read_groups),
    InputReader("table of groups", "g.csv", b"frame,track_id,group\n0,1,1\n0,2,1\n", read_groups),
    InputReader(
        "groups",
        "g.csv",
        b"frame,track_id,group,kind,probability,centre_x,centre_y,t\n0,1,0,conversing,.5,0,0,0\n",
        read_group_table,
    ),
    InputReader("gaze", "gaze.csv", b"frame,track_id,target\n0,1,2\n1,1,-1\n2,1,\n", read_gaze),
    InputReader(
        "attention",
        "a.csv",
        b"frame,t,track_id,kind,target,probability\n0,0,1,person,2,.5\n0,0,1,place,door,.25\n0,0,1,nothing,,.25\n",
        read_attention,
    ),
    InputReader(
        "places", "places.csv", b"name,x,y,radius,polygon\ndoor,1,2,.5,\nwall,,,,0 0 1 0 1 1\n", read_places
    ),
    InputReader(
        "forecasts",
        "f.csv",
        b"track_id,frame,t,ahead,x,y,x_std,y_std,xy_cov,radius_50,radius_90\n1,0,0,1,0,0,1,1,0,1,2\n",
        lambda path: (is_forecast(path), read_forecasts(path)),
    ),
    InputReader("walkable WKT", "w.wkt", b"POLYGON ((0 0, 9 0, 9 9, 0 9, 0 0))\n", WalkableArea.of),
    InputReader(
        "walkable GeoJSON",
        "w.json",
        b'{"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [9, 9], [0, 9], [0, 0]]]}',
        WalkableArea.of,
    ),
    InputReader("model", "m.toml", b'preset = "joint"\n[motion]\n[scene]\ndeath_rate = 0.05\n', Model.load),
    InputReader("group parameters", "p.toml", b"[groups]\nstride = 0.7\n", GroupParameters.load),
    InputReader("attention parameters", "p.toml", b"[attention]\n", AttentionParameters.load),
    InputReader("forecast parameters", "p.toml", b"[forecast]\n", ForecastParameters.load),
    InputReader("keypoints", "k.json", _keypoints(), read_keypoints),
    InputReader("boxes", "b.txt", _BOX, lambda path: read_boxes(path, lambda reason: None)),
    InputReader("suggestion", "s.csv", b"who;time;posX;posY\na;0,5;1,5;2\na;0,6;1,6;2\n", suggest),
)
"""Files of options, lines of streams, and files of the perception package."""


def format_readers(folder: Path) -> tuple[InputReader, ...]:
    """Return a reader for each sample of a format, by its content and by its name."""
    found = []
    for sample in SAMPLES:
        own = folder / name_of(sample)
        own.mkdir(exist_ok=True)
        content = sample.write(own).read_bytes()
        beside = {name: (own / name).read_bytes() for name in sample.beside}
        for named in (False, True):
            label = f"{name_of(sample)}{', format given' * named}"
            found.append(InputReader(label, sample.name, content, _of_format(sample, named=named), beside))
    return tuple(found)
