"""Rows of detections that are made some frames at a time are those of tracks; journals of frames."""

import gc
import json
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest
from selection import others_slow

from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.tracks.track import to_columns
from perception.detection.boxes import FrameDetections
from perception.detection.ground_search import FEATURES
from perception.detection.rescoring import Certainty, PersonProbability
from perception.ground.upright import LeaningPose
from perception.observation.journal import FrameJournal
from perception.observation.pipeline import FrameObservation, PersonObservation
from perception.observation.tables import ObservedTracks, to_detections, to_tracks
from perception.pose.classes import PoseClasses
from perception.pose.features import LENGTH
from perception.pose.head_detection import HeadCandidates
from perception.storage import decoded, encoded

PANS = PoseClasses.circle(8)
CAMERA = GroundCamera.from_homography(np.array([[0.02, 0.0, -1.0], [0.0, -0.02, 9.0], [0.0, 0.001, 0.2]]))


def seen_frames(count: int, rng: np.random.Generator, *, known: bool = True) -> dict[int, FrameObservation]:
    """Three people a frame, numbered in any order; without scores and appearance if not ``known``."""
    frames = {}
    for k in range(count):
        people = []
        for number in rng.permutation(3 * k + np.arange(3)).tolist():
            left, top, height = rng.uniform(50, 250), rng.uniform(40, 120), rng.uniform(40, 90)
            heads = HeadCandidates(rng.uniform(2, 30, (2, 4)), rng.normal(size=2))
            body, pan = np.log(rng.dirichlet(np.ones(8))), np.log(rng.dirichlet(np.ones(8), 2))
            box = (left, top, 0.4 * height, height)
            looks = rng.integers(0, 256, LENGTH).astype(np.uint8)
            person = PersonObservation(k, number, box, body, heads, pan)
            people.append(replace(person, score=float(rng.uniform()), appearance=looks) if known else person)
        frames[k] = FrameObservation(people, [])
    return frames


KINDS = pytest.mark.parametrize(
    ("camera", "causal", "known"), [(CAMERA, False, True), (None, True, True), (CAMERA, True, False)]
)


@KINDS
def test_rows_made_some_at_a_time_are_those_of_tracks(
    camera: GroundCamera | None, causal: bool, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("perception.observation.tables._AT_ONCE", 10)
    frames = seen_frames(30, np.random.default_rng(1), known=known)
    tracks = to_tracks(frames, PANS, camera, 5.0, causal=causal).tracks
    expected = to_columns(tracks)
    order = np.argsort(expected["frame"], kind="stable")
    found = to_detections(frames, PANS, camera, 5.0, causal=causal)
    assert list(found.columns) == list(expected)
    assert (found.columns["track_id"] == -1).all()
    np.testing.assert_array_equal(found.number, expected["track_id"][order])
    for name in set(expected) - {"track_id"}:
        np.testing.assert_allclose(found.columns[name], expected[name][order], atol=1.01e-4, err_msg=name)


def test_people_beyond_the_horizon_are_counted_and_nobody_is_refused() -> None:
    frames = seen_frames(4, np.random.default_rng(2))
    far = frames[1].people[0]
    frames[1].people[0] = replace(far, box=(100.0, -900.0, 20.0, 50.0))
    found = to_detections(frames, PANS, CAMERA, 5.0)
    assert len(found.number) == 11 and sum(found.refused.values()) == 1
    with pytest.raises(InputError, match="without people"):
        to_detections({0: FrameObservation([], [])}, PANS, CAMERA, 5.0)


def test_a_journal_reads_between_writing(tmp_path: Path) -> None:
    frames = seen_frames(40, np.random.default_rng(3))
    with FrameJournal(tmp_path / "j", "key", FrameObservation) as journal:
        for k, frame in frames.items():
            journal.add(k, frame)
            again = journal[k // 2]
            assert [p.track_id for p in again.people] == [p.track_id for p in frames[k // 2].people]
        looks = [frames[39].people[0].appearance, journal[39].people[0].appearance]
        np.testing.assert_array_equal(*looks)


@pytest.mark.slow
@pytest.mark.parametrize("has_identities", others_slow([False, True], [True]))
def test_a_row_of_a_long_recording_takes_less_than_a_kilobyte(tmp_path: Path, has_identities: bool) -> None:
    """With appearance, from the journal to the table; the difference of two lengths."""
    rng = np.random.default_rng(4)
    kept = []
    for count in (20, 70):
        journal = FrameJournal(tmp_path / f"{count}", "key", FrameObservation)
        journal.open()
        tracemalloc.start()
        try:
            for k, frame in seen_frames(count, rng).items():
                if has_identities:
                    frame.people[:] = [replace(item, track_id=item.track_id % 3) for item in frame.people]
                journal.add(k, frame)
            gc.collect()
            tracemalloc.clear_traces()  # only new rows are counted
            make = to_tracks if has_identities else to_detections
            found = make(journal, PANS, CAMERA, 5.0)
            gc.collect()
            kept.append(tracemalloc.get_traced_memory()[0])
        finally:
            tracemalloc.stop()
        rows = found.tracks.n_frames if isinstance(found, ObservedTracks) else len(found.number)
        assert rows == 3 * count
        journal.close()
        del found
    assert (kept[1] - kept[0]) / (3 * 50) < 1000.0


def seen(frame: int, left: float) -> PersonObservation:
    heads = HeadCandidates(np.array([[5.0, 2.0, 10.0, 14.0]]), np.array([0.4]))
    return PersonObservation(frame, 1, (left, 2.0, 30.0, 80.0), np.zeros(8), heads, np.zeros((1, 12)))


def of_frame(*people: PersonObservation, refused: str = "") -> FrameObservation:
    return FrameObservation(list(people), [refused] if refused else [])


def opened(path: Path, key: str = "a") -> FrameJournal[FrameObservation]:
    journal = FrameJournal(path, key, FrameObservation)
    journal.open()
    return journal


def test_a_journal_goes_on_after_the_last_whole_frame(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    with pytest.raises(KeyboardInterrupt), FrameJournal(path, "a", FrameObservation) as journal:
        journal.add(0, of_frame(seen(0, 1.0)))
        journal.add(1, of_frame(refused="a box of nobody"))
        raise KeyboardInterrupt
    with path.open("a") as stream:
        stream.write('{"frame": 2, "known": {"people": [{"frame": 2, "tr')  # broken off
    again = opened(path)
    assert set(again) == {0, 1} and [len(again[k].people) for k in (0, 1)] == [1, 0]
    assert again[1].refused == ["a box of nobody"]
    again.add(2, of_frame(seen(2, 3.0)))
    again.close()
    third = opened(path)
    assert set(third) == {0, 1, 2} and not third[1].people
    assert third[2].people[0].box == (3.0, 2.0, 30.0, 80.0)
    third.close()
    with FrameJournal(path, "another run", FrameObservation) as other:
        assert not other and path.exists()
    assert not path.exists()
    with pytest.raises(InputError), FrameJournal(path, "a", FrameObservation):
        raise InputError("a run", "another one")
    assert not path.exists()


@pytest.mark.parametrize("record", [{}, [], 7, None, {"frame": 1}, {"pan": [[0.0], [0.0]]}], ids=repr)
def test_records_that_nothing_can_be_made_of_are_looked_at_again(tmp_path: Path, record: object) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    journal.add(0, of_frame(seen(0, 1.0)))
    journal.close()
    with path.open("a") as stream:
        stream.write(json.dumps({"frame": 1, "known": {"people": [record], "refused": []}}) + "\n")
    again = opened(path)
    assert set(again) == {0}
    again.add(1, of_frame())
    again.close()
    assert set(opened(path)) == {0, 1}


def test_a_record_comes_back_as_it_was() -> None:
    certain = Certainty(np.array([-1.0, 2.0]), np.array([-0.5, 3.0]))
    person = replace(seen(3, 1.5), score=0.25, appearance=np.arange(LENGTH, dtype=np.uint16).astype(np.uint8))
    known = FrameObservation([replace(person, standing=LeaningPose((4.0, 5.0), 0.1, 30.0))], ["why"])
    records: list[Any] = [
        known,
        FrameDetections(np.empty((0, 4)), np.empty(0)),
        PersonProbability(np.ones(FEATURES, np.float32), 1.0, 2.0, 3.0, 4.0, 5, 6, certain),
    ]
    for record in records:
        again = decoded(type(record), orjson.loads(encoded(record)))
        assert encoded(again) == encoded(record) and type(again) is type(record)
    assert again.certainty.of(np.zeros(1)) == certain.of(np.zeros(1)) and again.weight.dtype == np.float32


def test_a_journal_that_cannot_be_taken_up_stays_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    journal.add(7, of_frame())
    journal.close()
    written = path.read_bytes()
    really = Path.open

    def full(self: Path, mode: str = "r", *rest: object, **more: object) -> object:
        stream = really(self, mode, *rest, **more)  # type: ignore[arg-type]
        if "w" in mode:
            stream.close()
            raise OSError(28, "No space left on device")
        return stream

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", full)
        with suppress(OSError):
            opened(path)
    assert path.read_bytes() == written and 7 in opened(path)
