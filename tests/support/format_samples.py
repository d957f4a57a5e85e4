"""A small made-up file of every format, with the files that lie beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from graphtrack import io
from graphtrack.tracks.track import Track, TrackSet

FRAMES = 6


@dataclass(frozen=True)
class Sample:
    """A file of one format.

    ``number`` is a cell that must be a number, ``rows`` what a reader counts, ``options`` what it needs.
    """

    format: str
    name: str
    make: Callable[[], bytes]
    rows: int
    number: bytes = b""
    beside: dict[str, Callable[[], str]] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        for name, make in self.beside.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(make())
        path = folder / self.name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.make())
        return path


def made_tracks() -> TrackSet:
    """Two people with every channel of the native table, some of it missing."""
    tracks = []
    for identity in (3, 8):
        n = FRAMES
        s = np.arange(n, dtype=float)
        rng = np.random.default_rng(identity)
        body = rng.uniform(-np.pi, np.pi, n)
        body[1] = np.nan
        position = np.column_stack([0.1 * s + identity, 0.3 * s])
        position[2] = np.nan
        tracks.append(
            Track(
                identity,
                np.arange(10, 10 + n),
                s / 10.0,
                position,
                position_std=np.full(n, 0.25),
                body=body,
                body_kappa=np.full(n, 4.0),
                head=rng.uniform(-np.pi, np.pi, n),
                head_likelihood=rng.uniform(0.1, 1.0, (n, 12)),
                score=rng.uniform(0.0, 9.0, n),
                true_position=position + 0.01,
                label=f"person {identity}, made",
                inputs={"appearance": rng.normal(size=(n, 3))},
            )
        )
    return TrackSet(tuple(tracks))


def _native(suffix: str) -> Callable[[], bytes]:
    def make() -> bytes:
        import tempfile

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"made{suffix}"
            io.write(made_tracks(), path)
            return path.read_bytes()

    return make


def _walk(people: int = 2) -> list[tuple[int, int, float, float]]:
    """Rows frame, id, x, y (metres) of people who walk along x."""
    return [(f, i, 0.05 * f + i, 2.0 * i + 0.01 * f) for f in range(FRAMES) for i in range(1, people + 1)]


def _lines(*rows: str) -> bytes:
    return ("\n".join(rows) + "\n").encode()


def mocap() -> bytes:
    header = "clip,frame,t_s,x_m,y_m,pelvis_yaw_rad,shoulder_yaw_rad,head_yaw_rad"
    rows = [f"clip-{i},{f},{f / 30:.4f},{x:.3f},{y:.3f},0.1,0.2,{0.1 * f}" for f, i, x, y in _walk()]
    return _lines(header, *rows)


def mot() -> bytes:
    return _lines(
        *(f"{f + 1},{i},{100 * x:.1f},{50 + 10 * y:.1f},40,100,1,-1,-1,-1" for f, i, x, y in _walk())
    )


def mot_metres() -> bytes:
    return _lines(
        *(f"{f + 1},{i},{100 * x:.1f},{50 + 10 * y:.1f},40,100,1,{x:.3f},{y:.3f},0" for f, i, x, y in _walk())
    )


def eth() -> bytes:
    return _lines(*(f"{10.0 * f + 1:.7e} {i:.7e} {x:.7e} 0.0 {y:.7e} 0.1 0.0 0.2" for f, i, x, y in _walk()))


def ucy() -> bytes:
    rows = ["2 - the number of splines"]
    for i in (1, 2):
        rows.append(f"{FRAMES} - Num of control points")
        rows += [f"{20 * f - 50}.0 {30 * i}.0 {25 * f} 90.0 - (2D point, m_id)" for f in range(FRAMES)]
    return _lines(*rows)


def ucy_homography() -> str:
    return "0.0 0.02 1.0\n0.02 0.0 0.5\n0.0 0.0 1.0\n"


def towncentre() -> bytes:
    return _lines(*(f"{f},{i},{100 + 30 * x:.0f},{200 + 10 * y:.0f},30,90" for f, i, x, y in _walk()))


def calibration() -> str:
    values = {
        **{
            "FocalLengthX": 2700.0,
            "FocalLengthY": 2700.0,
            "PrincipalPointX": 959.5,
            "PrincipalPointY": 539.5,
        },
        **{"Skew": 0.0, "TranslationX": 0.0, "TranslationY": 2.0, "TranslationZ": 15.0},
        **{"RotationX": 0.8660254037844386, "RotationY": 0.0, "RotationZ": 0.0, "RotationW": 0.5},
        **{"DistortionK1": -0.1, "DistortionK2": 0.01, "DistortionP1": 0.0, "DistortionP2": 0.0},
    }
    return "".join(f"{name} = {value!r}\n" for name, value in values.items())


def caviar() -> bytes:
    rows = ['<?xml version="1.0" encoding="UTF-8"?>', '<dataset name="Made">']
    for f in range(FRAMES):
        rows.append(f'<frame number="{f}"><objectlist>')
        for i in (0, 1):
            u, v = 100 + 5 * f + 60 * i, 120 + 20 * i
            rows.append(
                f'<object id="{i}"><orientation>90</orientation><box xc="{u}" yc="{v}" w="18" h="40"/>'
                f'<body><head gaze="{-1 if f == 2 else 30 * f}" xc="{u}" yc="{v - 18}"/>'
                f'<shoulders><right xc="{u + 6}" yc="{v - 10}"/>'
                f'<left xc="{u - 6}" yc="{v - 12}"/></shoulders>'
                f'<feet><right xc="{u + 3}" yc="{v + 20}"/><left xc="{u - 3}" yc="{v + 19}"/></feet></body>'
                "</object>"
            )
        rows.append("</objectlist></frame>")
    return _lines(*rows, "</dataset>")


def kitti() -> bytes:
    rows = []
    for f, i, x, y in _walk():
        rows.append(
            f"{f} {i} Pedestrian 0 0 0.1 10.0 20.0 30.0 90.0 1.7 0.6 0.8 {x:.3f} 1.6 {10 + y:.3f} {0.1 * i}"
        )
        rows.append(f"{f} -1 DontCare -1 -1 -10 1 2 3 4 -1000 -1000 -1000 -10 -1 -1 -1")
    return _lines(*rows)


def oxts() -> str:
    return "".join(
        f"48.9 {8.4 + 1e-6 * f} 110.0 0.01 0.02 {0.5 + 0.01 * f} " + "0 " * 24 + "\n" for f in range(FRAMES)
    )


def ego_calibration() -> str:
    return (
        "P0: 7 0 6 0 0 7 1 0 0 0 1 0\n"
        "R_rect 1 0 0 0 1 0 0 0 1\n"
        "Tr_velo_cam 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27\n"
        "Tr_imu_velo 1 0 0 -0.81 0 1 0 0.32 0 0 1 -0.8\n"
    )


def salsa() -> bytes:
    rows = []
    for f in range(FRAMES):
        people = " ".join(
            f"ID_00{i} {i + 0.1 * f:.3f} {2.5 * i:.3f} {0.4 * f - 5:.2f} {3 * i}" for i in (1, 2)
        )
        rows.append(f"{3 * f + 0.2:.1f} {people}")
    return _lines(*rows)


def pedpy() -> bytes:
    rows = [f"{i} {f} {100 * x:.1f} {100 * y:.1f} 0.5" for f, i, x, y in _walk()]
    return _lines("# framerate: 25 fps", "# id frame x/cm y/cm z/m", *rows)


SAMPLES = (
    Sample("csv", "made.csv", _native(".csv"), 2 * FRAMES, b",0.25,"),
    Sample("csv", "made.csv.gz", _native(".csv.gz"), 2 * FRAMES),
    Sample("parquet", "made.parquet", _native(".parquet"), 2 * FRAMES),
    Sample("ndjson", "made.ndjson", _native(".ndjson"), 2 * FRAMES, b": 0.25,"),
    Sample("ndjson", "made.jsonl.gz", _native(".jsonl.gz"), 2 * FRAMES),
    Sample("mocap", "clips.csv", mocap, 2 * FRAMES, b",0.1,0.2"),
    Sample("mot", "made.txt", mot, 2 * FRAMES, b",40,100"),
    Sample("mot", "metres.txt", mot_metres, 2 * FRAMES, b",40,100"),
    Sample("eth", "obsmat.txt", eth, 2 * FRAMES, b" 0.1 0.0"),
    Sample("ucy", "annotation.vsp", ucy, 2 * FRAMES, b" 90.0", {"H.txt": ucy_homography}),
    Sample("towncentre", "boxes.csv", towncentre, 2 * FRAMES, b",30,90", {"calibration.ci": calibration}),
    Sample("caviar", "made.xml", caviar, 2 * FRAMES, b'"18" h="40"'),
    Sample(
        "kitti",
        "label_02/0001.txt",
        kitti,
        4 * FRAMES,
        b" 10.0 20.0",
        {"oxts/0001.txt": oxts, "calib/0001.txt": ego_calibration},
    ),
    Sample("pedpy", "walk.txt", pedpy, 2 * FRAMES, b" 0.5"),
    Sample("salsa", "features.txt", salsa, 2 * FRAMES, b" 2.500"),
)
TEXT_SAMPLES = tuple(sample for sample in SAMPLES if sample.number)


def name_of(sample: Sample) -> str:
    return f"{sample.format}-{Path(sample.name).stem}"


def sample_of(format: str, name: str = "") -> Sample:
    """Return the first sample of a format with some text in its name."""
    return next(s for s in SAMPLES if s.format == format and name in s.name)
