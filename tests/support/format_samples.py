"""A small synthetic file of every format, with its accompanying files."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from graphtrack import io
from graphtrack.tracks.track import Track, TrackSet

FRAMES = 6
FOLDER = Path(__file__).parent / "samples"


@dataclass(frozen=True)
class Sample:
    """A file of one format, ``samples/FORMAT/NAME``, or written from `made_tracks`.

    ``number`` is a cell that must be a number, ``rows`` what a reader counts, ``options`` what it needs.
    """

    format: str
    name: str
    rows: int = 2 * FRAMES
    number: bytes = b""
    beside: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """Write the sample and its accompanying files into a folder; return its path."""
        for name in (*self.beside, self.name):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            if (FOLDER / self.format / name).exists():
                shutil.copyfile(FOLDER / self.format / name, folder / name)
            else:
                io.write(made_tracks(), folder / name)
        return folder / self.name

    def content(self) -> bytes:
        with TemporaryDirectory() as folder:
            return self.write(Path(folder)).read_bytes()


def made_tracks() -> TrackSet:
    """Two people with every channel of the native table, some of it missing."""
    tracks = []
    for identity in (3, 8):
        n, s, rng = FRAMES, np.arange(float(FRAMES)), np.random.default_rng(identity)
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


SAMPLES = (
    Sample("csv", "made.csv", number=b",0.25,"),
    Sample("csv", "made.csv.gz"),
    Sample("parquet", "made.parquet"),
    Sample("ndjson", "made.ndjson", number=b": 0.25,"),
    Sample("ndjson", "made.jsonl.gz"),
    Sample("trajnet", "made.trajnet.ndjson", 2 * FRAMES - 2, b'"x": 3.1'),
    Sample("mocap", "clips.csv", number=b",0.1,0.2"),
    Sample("mot", "made.txt", number=b",40,100"),
    Sample("mot", "metres.txt", number=b",40,100"),
    Sample("coco", "detections.json", options={"fps": 10.0}),
    Sample("eth", "obsmat.txt", number=b" 0.1 0.0"),
    Sample("ucy", "annotation.vsp", number=b" 90.0", beside=("H.txt",)),
    Sample("towncentre", "boxes.csv", number=b",30,90", beside=("calibration.ci",)),
    Sample("caviar", "made.xml", number=b'"18" h="40"'),
    Sample("kitti", "label_02/0001.txt", 4 * FRAMES, b" 10.0 20.0", ("oxts/0001.txt", "calib/0001.txt")),
    Sample("pedpy", "walk.txt", number=b" 0.5"),
    Sample("salsa", "features.txt", number=b" 2.500"),
)
TEXT_SAMPLES = tuple(sample for sample in SAMPLES if sample.number)


def name_of(sample: Sample) -> str:
    return f"{sample.format}-{Path(sample.name).stem}"


def sample_of(format: str, name: str = "") -> Sample:
    """Return the first sample of a format with some text in its name."""
    return next(s for s in SAMPLES if s.format == format and name in s.name)
