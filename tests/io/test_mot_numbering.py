"""MOT text counts frames from 1, as TrackEval reads it; folders of MOTChallenge, and URLs."""

import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import command
import numpy as np
import pandas as pd
import pytest
from format_samples import sample_of
from refusals import refused
from same_tracks import assert_same

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputError, InputWarning
from graphtrack.io.formats.mot import SHIFTED
from graphtrack.tracks.track import Track, TrackSet
from perception.detection.boxes import PersonBox, read_boxes, write_boxes

RATE = 25.0


def people(first: int) -> TrackSet:
    """Two people, one starting two frames after the other."""
    walks = []
    for k in (0, 2):
        frame = np.arange(first + k, first + 6)
        x = 0.05 * frame
        walks.append(Track(k + 1, frame, frame / RATE, np.column_stack([x, x + 3.0 + k])))
    return TrackSet(tuple(walks))


def frames_in(path: Path) -> list[int]:
    return [int(line.split(",")[0]) for line in path.read_text().splitlines()]


def test_frames_from_0_are_written_from_1_and_come_back(tmp_path: Path) -> None:
    path = tmp_path / "tracks.txt"
    with pytest.warns(InputWarning, match="frames begin at 0, and at 1 in MOT text"):
        gt.write(people(0), path)
    assert (min(frames_in(path)), max(frames_in(path))) == (1, 6)
    again = gt.read(path, fps=RATE)
    assert_same(people(0), again)
    assert SHIFTED in again.summary.notes
    # The mark is a zero for readers of the numbers.
    assert (np.loadtxt(path, delimiter=",")[:, 9] == 0.0).all()


@pytest.mark.parametrize("first", [1, 7])
def test_frames_from_1_on_stay_as_they_are(first: int, tmp_path: Path) -> None:
    path = tmp_path / "tracks.txt"
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        gt.write(people(first), path)
    assert min(frames_in(path)) == first
    assert_same(people(first), gt.read(path, fps=RATE))


def test_frames_below_0_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="frame -2, expected frames from 0 in MOT text"):
        gt.write(people(-2), tmp_path / "tracks.txt")


def test_the_command_says_that_frames_are_shifted(tmp_path: Path) -> None:
    gt.write(people(0), tmp_path / "tracks.csv")
    done = command.run("convert", tmp_path / "tracks.csv", "-o", tmp_path / "x.txt", program="graphtrack")
    assert done.returncode == 0 and "note: frames begin at 0" in done.stderr, done.stderr
    assert min(frames_in(tmp_path / "x.txt")) == 1


@pytest.mark.parametrize("first", [0, 1, 60])
def test_boxes_of_a_recording_come_back(first: int, tmp_path: Path) -> None:
    boxes = [PersonBox(first + k, 4, (10.0 + k, 20.0, 30.0, 80.0)) for k in range(2, 5)]
    write_boxes(boxes, tmp_path / "boxes.txt", first=first)
    assert min(frames_in(tmp_path / "boxes.txt")) == first + 2 + (first == 0)
    assert read_boxes(tmp_path / "boxes.txt") == boxes
    assert read_boxes(tmp_path / "boxes.txt", first=first) == boxes


def trackeval_scores(truth: Path, found: Path, n_frames: int, folder: Path) -> tuple[float, float]:
    """HOTA and MOTA by TrackEval itself."""
    trackeval = pytest.importorskip("trackeval", reason="pip install --no-deps trackeval==1.3.0")
    (folder / "gt/S/gt").mkdir(parents=True)
    (folder / "found/T/data").mkdir(parents=True)
    (folder / "gt/S/gt/gt.txt").write_bytes(truth.read_bytes())
    (folder / "found/T/data/S.txt").write_bytes(found.read_bytes())
    quiet: dict[str, Any] = {"PRINT_CONFIG": False}
    places = {"GT_FOLDER": str(folder / "gt"), "TRACKERS_FOLDER": str(folder / "found")}
    given = {"SEQ_INFO": {"S": n_frames}, "SKIP_SPLIT_FOL": True, "BENCHMARK": "MOT15"}
    dataset = trackeval.datasets.MotChallenge2DBox(quiet | places | given | {"TRACKERS_TO_EVAL": ["T"]})
    data = dataset.get_preprocessed_seq_data(dataset.get_raw_seq_data("T", "S"), "pedestrian")
    hota = trackeval.metrics.HOTA().eval_sequence(data)["HOTA"].mean()
    return float(hota), float(trackeval.metrics.CLEAR(quiet).eval_sequence(data)["MOTA"])


def seen(tracks: TrackSet) -> TrackSet:
    """The same tracks before a camera, which makes boxes of them."""
    camera = gt.from_supervision([SimpleNamespace(xyxy=np.array([[0, 0, 9, 90.0]]))] * 2, fps=9.0).camera
    assert camera is not None
    return TrackSet(tracks.tracks, camera)


def test_trackeval_takes_what_is_written(tmp_path: Path) -> None:
    with pytest.warns(InputWarning):
        gt.write(seen(people(0)), tmp_path / "truth.txt")
    assert trackeval_scores(tmp_path / "truth.txt", tmp_path / "truth.txt", 6, tmp_path) == (1.0, 1.0)


def far_people() -> TrackSet:
    """People beyond x = 2 m, which column 8 would make a class of objects."""
    tracks = seen(people(0))
    return tracks.map(lambda one: replace(one, position=one.position + np.array([5.0, 0.0])))


def test_boxes_alone_are_written_for_evaluation_in_the_image(tmp_path: Path) -> None:
    with pytest.warns(InputWarning):
        gt.write(far_people(), tmp_path / "boxes.2d.txt")
    with pytest.warns(InputWarning):
        gt.write(far_people(), tmp_path / "metres.txt")
    rows, others = (
        [line.split(",") for line in (tmp_path / name).read_text().splitlines()]
        for name in ("boxes.2d.txt", "metres.txt")
    )
    assert [row[:7] for row in rows] == [row[:7] for row in others]
    assert {tuple(row[7:]) for row in rows} == {("-1", "-1", "-0")}
    again = gt.read(tmp_path / "boxes.2d.txt", fps=RATE, camera=far_people().camera)
    for one, other in zip(again, far_people(), strict=True):
        np.testing.assert_array_equal(one.frame, other.frame)
        np.testing.assert_allclose(one.position, other.position, atol=1e-3)
    with pytest.raises(InputError, match="without a camera"):
        gt.write(people(1), tmp_path / "none.2d.txt")
    assert not (tmp_path / "none.2d.txt").exists()
    files = [tmp_path / "boxes.2d.txt"] * 2
    assert trackeval_scores(*files, 6, tmp_path) == (1.0, 1.0)


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
def test_a_file_by_its_url(name: str, cwd: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
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
    assert len(io.read_identified(f"file://{cwd}/walks.csv", columns=columns)) == 3
    for wrong in ("memory://bucket/none.csv", "nosuch://bucket/walks.csv", f"file://{cwd}/none.csv"):
        assert wrong in str(refused(wrong))
        done = command.run("info", wrong, program="graphtrack")
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
