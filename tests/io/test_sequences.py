"""Folders that are sequences of MOTChallenge, and files by their URLs."""

from __future__ import annotations

from pathlib import Path

import command
import numpy as np
import pandas as pd
import pytest
from format_samples import sample_of
from refusals import refused

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputError


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """Two people, at 14 frames a second, and a detector's output for one of them."""
    folder = tmp_path / "MOT-02"
    for name in ("gt", "det", "img1"):
        (folder / name).mkdir(parents=True)
    (folder / "gt" / "gt.txt").write_bytes(sample_of("mot", "metres").content())
    rows = [line.split(",") for line in sample_of("mot", "metres").content().decode().splitlines()]
    boxes = [",".join([row[0], "-1", *row[2:6], "0.5,-1,-1,-1"]) for row in rows if row[1] == "1"]
    (folder / "det" / "det.txt").write_text("\n".join(boxes) + "\n")
    info = "[Sequence]\nname=MOT-02\nimDir=img1\nframeRate=14\nseqLength=6\nimWidth=640\nimHeight=480\n"
    (folder / "seqinfo.ini").write_text(info)
    return folder


def test_a_sequence_is_its_tracks_at_its_own_rate(sequence: Path) -> None:
    tracks = gt.read(sequence)
    assert [track.track_id for track in tracks] == [1, 2]
    np.testing.assert_allclose(tracks.by_id(1).t * 14.0, tracks.by_id(1).frame)
    assert "frame rate 14 Hz and images of 640 × 480 from seqinfo.ini" in tracks.summary.notes
    assert "read gt/gt.txt of the sequence" in tracks.summary.notes


def test_without_tracks_a_sequence_is_its_detections(sequence: Path) -> None:
    (sequence / "gt" / "gt.txt").unlink()
    with pytest.raises(InputError, match="without identities"):
        gt.read(sequence, associate="never")
    assert len(gt.read(sequence)) == 1


def test_folders_of_sequences_are_compared_one_by_one(sequence: Path, tmp_path: Path) -> None:
    other = tmp_path / "again" / sequence.name
    (other / "gt").mkdir(parents=True)
    (other / "gt" / "gt.txt").write_bytes(sample_of("mot", "metres").content())
    sequences = tmp_path / "train"
    sequences.mkdir()
    sequence.rename(sequences / sequence.name)
    options = ("--truth", sequences, "--iou", "0.5")
    done = command.run("score", tmp_path / "again", *options, program="graphtrack")
    assert done.returncode == 0 and "MOT-02" in done.stdout, done.stderr


@pytest.mark.parametrize("name", ["walks.parquet", "walks.csv"])
def test_a_file_by_its_url(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsspec = pytest.importorskip("fsspec")
    monkeypatch.chdir(tmp_path)
    url, n = f"memory://bucket/{name}", np.arange(12)
    who = np.repeat(["anna", "bob", "eve"], 4)
    walks = pd.DataFrame({"who": who, "seconds": n % 4, "east": n % 4 + n // 4.0, "north": 0.5})
    with fsspec.open(url, "wb") as stream:
        walks.to_csv(stream, index=False) if name.endswith("csv") else walks.to_parquet(stream)
    columns = "id=who,t=seconds,x=east,y=north"
    tracks = io.read_identified(url, columns=columns)
    assert [track.label for track in tracks] == ["anna", "bob", "eve"]
    assert "each file once" in str(refused([url, url], columns=columns))
    done = command.run("info", url, "--columns", columns, program="graphtrack")
    assert done.returncode == 0 and url in done.stderr and "anna" in done.stdout
    walks.to_csv("walks.csv", index=False)
    assert len(io.read_identified(f"file://{tmp_path}/walks.csv", columns=columns)) == 3
    for wrong in ("memory://bucket/none.csv", "nosuch://bucket/walks.csv", f"file://{tmp_path}/none.csv"):
        assert wrong in str(refused(wrong))
        done = command.run("info", wrong, program="graphtrack")
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
