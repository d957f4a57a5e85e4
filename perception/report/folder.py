"""The folder of a report: what is in it, and which of its stages are done."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path
from graphtrack.io.places import check_place

STAGES = "stages.json"
"""Which stages are done, and what they said."""
TRACKS = "tracks.csv"
"""The estimates; `graphtrack.read` of the folder reads them."""

FILES = {
    "boxes": "boxes.txt",
    "calibration": "calibration.ci",
    "models": "camera.npz",
    "observations": "observations.csv",
    "tracks": TRACKS,
    "video": "annotated.mp4",
    "above": "above.png",
    "page": "report.html",
    "assumptions": "assumptions.txt",
}


@dataclass
class ReportFolder:
    """A folder whose stages are done one after the other, each once.

    Attributes
    ----------
    path : the folder
    tell : is told of each stage that begins or was done before
    count : number of stages
    """

    path: Path
    count: int
    tell: Callable[[str], object]
    _done: dict[str, dict[str, Any]] = field(default_factory=dict)
    _key: str = ""
    _number: int = 0

    def file(self, name: str) -> Path:
        """Where one of `FILES` is."""
        return self.path / FILES[name]

    def open(self) -> None:
        """Make the folder, or see what is done in it.

        Raises
        ------
        InputError
            If it cannot be made, or holds something else.
        """
        check_folder(self.path)
        self.path.mkdir(exist_ok=True)
        stages = self.path / STAGES
        if not stages.is_file():
            self._save()  # from now on it is known for what it is
            return
        try:
            known = json.loads(stages.read_text("utf-8"))
            self._done = {
                str(name): {"key": str(s["key"]), "said": list(s["said"])} for name, s in known.items()
            }
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise InputError("something else", "what `perception report` wrote", path=stages) from error

    def stage(
        self, name: str, asked: object, outputs: Sequence[str], work: Callable[[str], Sequence[str]]
    ) -> list[str]:
        """Do a stage, unless it was done with the same before.

        Parameters
        ----------
        name : in words
        asked : all that its outputs depend on, besides the stages before it
        outputs : names of `FILES` that are there when it is done
        work : does it, given a key of what it depends on; says what is to be said of it

        Returns
        -------
        list of str
            What it said.
        """
        self._number += 1
        self._key = key_of(self._key, name, asked)
        known = self._done.get(name)
        label = f"[{self._number}/{self.count}] {name}"
        if known is not None and known["key"] == self._key and all(self.file(o).is_file() for o in outputs):
            self.tell(f"{label}: done before")
            return list(known["said"])
        self.tell(label)
        said = list(work(self._key))
        self._done[name] = {"key": self._key, "said": said}
        self._save()
        return said

    def _save(self) -> None:
        with atomic_path(self.path / STAGES) as temporary:
            temporary.write_text(json.dumps(self._done, indent=1) + "\n", encoding="utf-8")


def check_folder(path: Path) -> None:
    """Refuse a place that is neither free nor the folder of a report.

    Raises
    ------
    InputError
        As `check_place` does.
    """
    if not (path / STAGES).is_file():
        check_place(path, directory=True)


def key_of(*asked: object) -> str:
    """What tells one run from another."""
    return hashlib.sha256(repr(asked).encode()).hexdigest()
