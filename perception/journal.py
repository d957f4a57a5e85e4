"""What is known of frames so far, in a file, so that a run that was broken off goes on where it was."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO


@dataclass
class Journal:
    """Records of frames: a line with the run's key, then a line for each frame.

    Attributes
    ----------
    path : the file
    key : says which run it belongs to; a journal of another run is begun anew
    frames : the records of every complete frame, as JSON knows them
    """

    path: Path
    key: str
    frames: dict[int, list[Any]] = field(default_factory=dict)
    _stream: TextIO | None = None

    def open(self) -> None:
        """Read what is there, if it belongs to the same run, and go on writing after it."""
        complete = [json.dumps({"key": self.key})]
        if self.path.is_file():
            lines = self.path.read_text(encoding="utf-8", errors="replace").splitlines()
            if lines[:1] == complete:
                self._take(lines[1:], complete)
        self._stream = self.path.open("w", encoding="utf-8")
        self._stream.write("\n".join(complete) + "\n")
        self._stream.flush()

    def _take(self, lines: list[str], complete: list[str]) -> None:
        for line in lines:
            try:
                values = json.loads(line)
                self.frames[int(values["frame"])] = list(values["records"])
            except (ValueError, KeyError, TypeError):  # the run ended in the middle of this line
                return
            complete.append(line)

    def add(self, frame: int, records: list[Any]) -> None:
        """Write a frame down."""
        assert self._stream is not None
        self._stream.write(json.dumps({"frame": frame, "records": records}) + "\n")
        self._stream.flush()
        self.frames[frame] = records

    def close(self, *, remove: bool) -> None:
        """End writing; ``remove`` when the run is complete."""
        if self._stream is not None:
            self._stream.close()
        if remove:
            self.path.unlink(missing_ok=True)
