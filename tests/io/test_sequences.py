"""Folders that are sequences of MOTChallenge, wherever a file is taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command import Done
from command import run as run_program
from format_samples import mot_metres

import graphtrack as gt
from graphtrack.errors import InputError


def run_graphtrack(*arguments: object) -> Done:
    return run_program(*arguments, program="graphtrack")


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """Two people, at 14 frames a second, and what a detector says of one of them."""
    folder = tmp_path / "MOT-02"
    for name in ("gt", "det", "img1"):
        (folder / name).mkdir(parents=True)
    (folder / "gt" / "gt.txt").write_bytes(mot_metres())
    rows = [line.split(",") for line in mot_metres().decode().splitlines()]
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
    (other / "gt" / "gt.txt").write_bytes(mot_metres())
    sequences = tmp_path / "train"
    sequences.mkdir()
    sequence.rename(sequences / sequence.name)
    done = run_graphtrack("score", tmp_path / "again", "--truth", sequences, "--iou", "0.5")
    assert done.returncode == 0 and "MOT-02" in done.stdout, done.stderr
