"""Rows of observations as NDJSON, one estimate out for each, many people interleaved."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.inference.incremental import Engine, Estimate, OnlineSmoother
from graphtrack.io.atomic import atomic_path
from graphtrack.model import Model, Observation
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, STATE

_CLASSES = {"body": BODY_CLASSES, "head": HEAD_CLASSES}


class People:
    """An online smoother for each person, made when the person first appears."""

    def __init__(self, make: Callable[[], OnlineSmoother], fps: float | None) -> None:
        self._make, self._fps = make, fps
        self._smoothers: dict[int, OnlineSmoother] = {}
        self.rows = 0

    def answer(self, line: str) -> dict[str, Any]:
        """The estimate after one line of input, or what is wrong with the line under ``error``."""
        self.rows += 1
        try:
            track_id, observation = parse_row(line, self._fps)
            smoother = self._smoothers.get(track_id)
            if smoother is None:
                smoother = self._make()
            estimate = smoother.update(observation)
            self._smoothers[track_id] = smoother
        except InputError as error:
            where = InputError(
                error.found, error.expected, path=error.path, line=self.rows, column=error.column
            )
            return {"error": str(where)}
        return estimate_row(track_id, estimate)

    def save(self, path: Path, settings: dict[str, Any]) -> None:
        """Write the state of all people, whole or not at all."""
        people = {str(track_id): smoother.state() for track_id, smoother in self._smoothers.items()}
        with atomic_path(path) as temporary:
            content = {"settings": settings, "rows": self.rows, "people": people}
            temporary.write_text(json.dumps(content), encoding="utf-8")

    def load(self, path: Path, settings: dict[str, Any], restore: Callable[[Any], OnlineSmoother]) -> None:
        """Go on from a saved state.

        Raises
        ------
        InputError
            If the file is no state, or one of other settings.
        """
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            saved, rows, people = content["settings"], int(content["rows"]), dict(content["people"])
        except OSError as error:
            raise InputError(error.strerror or str(error), "a readable state file", path=path) from error
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                "no saved state", "a file that 'graphtrack track --state' wrote", path=path
            ) from error
        if saved != settings:
            differing = sorted(k for k in settings if saved.get(k) != settings[k])
            raise InputError(f"a state with other {', '.join(differing)}", "the same options", path=path)
        self.rows = rows
        self._smoothers = {int(track_id): restore(state) for track_id, state in people.items()}


def settings_of(model: Model, engine: Engine, lag: float) -> dict[str, Any]:
    """What a saved state depends on."""
    return {"model": json.loads(json.dumps(model.to_dict())), "engine": engine, "lag": lag}


def parse_row(line: str, fps: float | None = None) -> tuple[int, Observation]:
    """A line of NDJSON with the columns of the native table → track id and observation.

    Raises
    ------
    InputError
        Naming the column.
    """
    try:
        row = json.loads(line, parse_constant=lambda name: math.nan)
    except (ValueError, RecursionError) as error:
        raise InputError(f"no JSON ({line.strip()[:40]!r})", "one JSON object a line") from error
    if not isinstance(row, dict):
        raise InputError(f"{line.strip()[:40]!r}", "one JSON object a line")
    track_id, frame = _integer(row, "track_id"), _integer(row, "frame")
    t = _number(row, "t")
    if t is None:
        if fps is None:
            raise InputError("no t", "seconds, or a frame rate (--fps)", column="t")
        t = frame / fps
    channels: dict[str, Any] = {
        "position": _pair(row, "x", "y"),
        "position_std": _number(row, "pos_std"),
        "pixel": _pair(row, "u", "v"),
    }
    for name, n_classes in _CLASSES.items():
        degrees = _number(row, f"{name}_deg")
        channels[name] = None if degrees is None else math.radians(degrees)
        channels[f"{name}_kappa"] = _number(row, f"{name}_kappa")
        scores = [_number(row, f"{name}_p{k}") for k in range(n_classes)]
        known = [score for score in scores if score is not None]
        if known and len(known) != n_classes:
            raise InputError(f"{len(known)} of {n_classes} likelihoods", "all or none", column=f"{name}_p*")
        channels[f"{name}_likelihood"] = tuple(known) if known else None
    return track_id, Observation(t=t, frame=frame, **channels)


def _number(row: dict[str, Any], column: str) -> float | None:
    value = row.get(column)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e15:
        raise InputError(repr(value)[:40], "a finite number", column=column)
    return float(value)


def _integer(row: dict[str, Any], column: str) -> int:
    value = _number(row, column)
    if value is None or value != int(value):
        raise InputError("nothing" if value is None else f"{value:g}", "an integer", column=column)
    return int(value)


def _pair(row: dict[str, Any], first: str, second: str) -> tuple[float, float] | None:
    a, b = _number(row, first), _number(row, second)
    if a is None and b is None:
        return None
    if a is None or b is None:
        raise InputError(
            "one coordinate", f"both {first} and {second}", column=first if a is None else second
        )
    return a, b


def estimate_row(track_id: int, estimate: Estimate) -> dict[str, Any]:
    """An estimate with the columns of the native table; null where nothing is known."""
    std = np.sqrt(np.diagonal(estimate.covariance))
    row: dict[str, Any] = {"track_id": track_id, "frame": estimate.frame, "t": estimate.t}
    values = [
        *estimate.position,
        *estimate.velocity,
        math.degrees(estimate.body),
        math.degrees(estimate.head),
    ]
    names = ["body_deg" if n == "body" else "head_deg" if n == "head" else n for n in STATE]
    row |= {name: _null(value) for name, value in zip(names, values, strict=True)}
    for name, value in zip(STATE, std, strict=True):
        angle = name in _CLASSES
        row[f"{name}_std_deg" if angle else f"{name}_std"] = _null(math.degrees(value) if angle else value)
    if math.isfinite(estimate.aligned_p):
        row["aligned_p"] = estimate.aligned_p
        row["gait_offset_deg"] = math.degrees(estimate.gait_offset)
    row["status"] = estimate.status
    if estimate.reason:
        row["reason"] = estimate.reason
    return row


def _null(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
