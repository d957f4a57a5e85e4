"""A journal survives a run that ends while it resumes from it."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.learning.fit import EvaluationJournal
from perception.observe.journal import FrameJournal


@pytest.mark.parametrize("kind", ["learning", "perception"])
def test_a_journal_that_cannot_be_taken_up_stays_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    path = tmp_path / "journal"

    def take_up() -> EvaluationJournal | FrameJournal[str]:
        if kind == "learning":
            return EvaluationJournal(path, "key")
        found = FrameJournal(path, "key", str)
        found.open()
        return found

    first = take_up()
    if isinstance(first, EvaluationJournal):
        first.put("stage", np.zeros(1), np.ones(1))
    else:
        first.add(7, "seen")
        first.close()
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
        with suppress(InputError, OSError):
            take_up()
    assert path.read_bytes() == written
    again = take_up()
    assert again.get("stage", np.zeros(1)) == 1.0 if isinstance(again, EvaluationJournal) else 7 in again
