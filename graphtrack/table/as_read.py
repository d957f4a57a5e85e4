"""Names and units of a table that was read, so that output has them again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.table.moments import TimeScale
from graphtrack.table.plane import Plane

LENGTHS = (
    *("x", "y", "pos_std", "vx", "vy", "x_std", "y_std", "vx_std", "vy_std"),
    *("true_x", "true_y"),
)
"""Columns of the native table that are metres, or metres a second."""

DEGREES = ("lat", "lon")
"""Columns of places on the earth, which stand for ``x`` and ``y``."""

TRUE_DEGREES = ("true_lat", "true_lon")

ANGLES = {"body_rad": "body_deg", "head_rad": "head_deg"}
"""Columns in radians, and those of the native table that they stand for."""


@dataclass(frozen=True)
class AsRead:
    """Names and units of a table.

    Attributes
    ----------
    columns : name in the native table (or one of `DEGREES` and `ANGLES`) → name in the file
    time : what its times were; None: seconds, as in the native table
    metre : metres of its unit of length
    names : track id → identity, where identities are text
    plane : where its places lie, if they are none of a local ground
    frame : the name of the frame of reference, of a ROS 2 recording
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    time: TimeScale | None = None
    metre: float = 1.0
    names: Mapping[int, str] = field(default_factory=dict)
    plane: Plane | None = None
    frame: str = ""

    def without_identities(self) -> AsRead:
        """The same, where people have other identities than in the file."""
        columns = {key: name for key, name in self.columns.items() if key != "track_id"}
        return replace(self, columns=columns, names={})


def restored(columns: Mapping[str, NDArray[Any]], as_read: AsRead | None) -> dict[str, Any]:
    """Columns of the native table under the names and in the units of the table that was read.

    What the native table has besides keeps its name, unless the other table has a use for it.

    Parameters
    ----------
    columns : of the native table
    as_read : None: they stay as they are
    """
    if as_read is None:
        return dict(columns)
    found = _identities(columns, as_read)
    if as_read.time is not None and "t" in found:
        found["t"] = as_read.time.restored(columns["t"])
    _places(found, as_read)
    if as_read.metre != 1.0:
        for name in LENGTHS:
            if name in found:
                found[name] = found[name] / as_read.metre
    for key, native in ANGLES.items():
        if key in as_read.columns and native in found:
            found = {key if n == native else n: np.deg2rad(v) if n == native else v for n, v in found.items()}
    taken = {as_read.columns[key] for key in found if key in as_read.columns}
    return {
        as_read.columns.get(key, key): values
        for key, values in found.items()
        if key in as_read.columns or key not in taken
    }


def with_names(columns: Mapping[str, NDArray[Any]], as_read: AsRead | None) -> dict[str, NDArray[Any]]:
    """Columns about people, and beside their ids as ``label`` the identities that were text in what was read.

    Of targets, where there are any, those that are people have theirs as ``target_label``.
    """
    if as_read is None or not as_read.names:
        return dict(columns)
    names = as_read.names
    found = {**columns, "label": np.array([names.get(k, "") for k in columns["track_id"].tolist()], object)}
    if "target" in columns:
        told = {str(k): name for k, name in names.items()}
        pairs = zip(columns["kind"].tolist(), columns["target"].tolist(), strict=True)
        of_target = [told.get(target, "") if kind == "person" else "" for kind, target in pairs]
        found["target_label"] = np.array(of_target, object)
    return found


def _identities(columns: Mapping[str, NDArray[Any]], as_read: AsRead) -> dict[str, Any]:
    """The columns with the identities as text, where they were; labels that say no more are left out."""
    found: dict[str, Any] = dict(columns)
    if not as_read.names or "track_id" not in found or "track_id" not in as_read.columns:
        return found
    ids = found["track_id"].tolist()
    others = {k: f"track {k}" if str(k) in as_read.names.values() else str(k) for k in {*ids}}
    names = [as_read.names.get(k, others[k]) for k in ids]
    if "label" in found and "label" not in as_read.columns and found["label"].tolist() == names:
        del found["label"]
    found["track_id"] = np.array(names, dtype=object)
    return found


def _places(found: dict[str, Any], as_read: AsRead) -> None:
    """Put coordinates of the earth in the place of metres, or beside them where they are degrees."""
    plane = as_read.plane
    if plane is None:
        return
    degrees = DEGREES[0] in as_read.columns
    for pair, angles in ((("x", "y"), DEGREES), (("true_x", "true_y"), TRUE_DEGREES)):
        if pair[0] not in found:
            continue
        first, second = plane.back(found[pair[0]], found[pair[1]])
        if degrees:
            found[angles[0]], found[angles[1]] = second, first
        else:
            found[pair[0]], found[pair[1]] = first, second


def merged(parts: list[tuple[AsRead | None, Mapping[int, int]]]) -> AsRead | None:
    """Names and units of several tables together; the first counts for what all have in common.

    Parameters
    ----------
    parts : of each file, and its track ids → those of the tracks together
    """
    first = parts[0][0]
    if first is None or not any(one is not None and one.names for one, _ in parts):
        return first
    names: dict[int, str] = {}
    taken: set[str] = set()
    for one, ids in parts:
        for old, new in ids.items():
            said = name = one.names.get(old, str(old)) if one is not None else str(old)
            again = 1
            while name in taken:
                again += 1
                name = f"{said} ({again})"
            taken.add(name)
            names[new] = name
    return replace(first, names=names)
