"""Journal of evaluations: learning that was interrupted replays it and goes on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.io.atomic import atomic_path


class EvaluationJournal:
    """Evaluations by their stage and place, appended to a file of JSON lines.

    An evaluation depends on nothing but its place, so that replaying ends where an uninterrupted run does.
    A file of other data or settings, told by its ``fingerprint``, is begun anew; a last line that was cut
    off is left aside.

    Parameters
    ----------
    path : the file; None: nothing is kept
    """

    def __init__(self, path: Path | None, fingerprint: str) -> None:
        self._path = path
        self._known: dict[tuple[str, tuple[float, ...]], list[float]] = {}
        if path is None:
            return
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.is_file() else []
        whole = []
        for line in lines:
            try:
                whole.append(json.loads(line))
            except ValueError:
                break
        if not whole or whole[0] != fingerprint:
            whole = [fingerprint]
        for entry in whole[1:]:
            self._known[entry[0], tuple(entry[1])] = entry[2]
        with atomic_path(path) as temporary:
            temporary.write_text("".join(json.dumps(entry) + "\n" for entry in whole), encoding="utf-8")

    def __len__(self) -> int:
        return len(self._known)

    def get(self, stage: str, x: FloatArray) -> FloatArray | None:
        """Return the values at a place (p,); None if it was not evaluated."""
        found = self._known.get((stage, tuple(x.tolist())))
        return None if found is None else np.array(found)

    def put(self, stage: str, x: FloatArray, values: FloatArray) -> None:
        """Keep what was found."""
        self._known[stage, tuple(x.tolist())] = values.tolist()
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([stage, x.tolist(), values.tolist()]) + "\n")

    def remove(self) -> None:
        """Delete the file, when all is done."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
