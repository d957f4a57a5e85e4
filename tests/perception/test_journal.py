"""The journal: resumed work, and work that is not resumed."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from graphtrack.errors import InputError
from perception.detection.boxes import Detections
from perception.detection.ground_search import FEATURES
from perception.detection.rescoring import Certainty, PersonProbability
from perception.ground.upright import LeaningPose
from perception.observe.journal import FrameJournal
from perception.observe.pipeline import FrameObservation, PersonObservation
from perception.pose.features import LENGTH
from perception.pose.head_detection import HeadCandidates
from perception.storage import decoded, encoded


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
        Detections(np.empty((0, 4)), np.empty(0)),
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
