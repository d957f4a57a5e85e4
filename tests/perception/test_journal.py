"""The journal: what is taken up again, and what is not."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from perception.observe.journal import FrameJournal
from perception.observe.pipeline import SeenFrame, SeenPerson
from perception.pose.head_detection import HeadCandidates


def seen(frame: int, left: float) -> SeenPerson:
    heads = HeadCandidates(np.array([[5.0, 2.0, 10.0, 14.0]]), np.array([0.4]))
    return SeenPerson(frame, 1, (left, 2.0, 30.0, 80.0), np.zeros(8), heads, np.zeros((1, 12)))


def of_frame(*people: SeenPerson, refused: str = "") -> SeenFrame:
    return SeenFrame(list(people), [refused] if refused else [])


def opened(path: Path, key: str = "a") -> FrameJournal[SeenFrame]:
    journal = FrameJournal(path, key, SeenFrame.to_record, SeenFrame.from_record)
    journal.open()
    return journal


def test_a_journal_goes_on_after_the_last_whole_frame(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    journal.add(0, of_frame(seen(0, 1.0)))
    journal.add(1, of_frame(refused="a box of nobody"))
    journal.close(remove=False)
    with path.open("a") as stream:
        stream.write('{"frame": 2, "known": {"people": [{"frame": 2, "tr')  # broken off
    again = opened(path)
    assert set(again.frames) == {0, 1} and [len(again.frames[k].people) for k in (0, 1)] == [1, 0]
    assert again.frames[1].refused == ["a box of nobody"]
    again.add(2, of_frame(seen(2, 3.0)))
    again.close(remove=False)
    third = opened(path)
    assert set(third.frames) == {0, 1, 2} and not third.frames[1].people
    assert third.frames[2].people[0].box == (3.0, 2.0, 30.0, 80.0)
    third.close(remove=False)
    other = opened(path, "another run")
    assert not other.frames
    other.close(remove=True)
    assert not path.exists()


@pytest.mark.parametrize(
    "record",
    [{}, [], 7, None, {"frame": 1}, {**seen(1, 0.0).to_record(), "pan": [[0.0], [0.0]]}],
    ids=repr,
)
def test_records_that_nothing_can_be_made_of_are_looked_at_again(tmp_path: Path, record: object) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    journal.add(0, of_frame(seen(0, 1.0)))
    journal.close(remove=False)
    with path.open("a") as stream:
        stream.write(json.dumps({"frame": 1, "known": {"people": [record], "refused": []}}) + "\n")
    again = opened(path)
    assert set(again.frames) == {0}
    again.add(1, of_frame())
    again.close(remove=False)
    assert set(opened(path).frames) == {0, 1}


def test_a_journal_that_cannot_be_taken_up_stays_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    journal.add(7, of_frame())
    journal.close(remove=False)
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
    assert path.read_bytes() == written and 7 in opened(path).frames
