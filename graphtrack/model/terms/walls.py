"""Walls: people stay within the walkable area."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.walkable import MARGIN, WALLS, WalkableArea
from graphtrack.kernels.layout import Field
from graphtrack.model.costs import Cost
from graphtrack.model.kernel import Kernel
from graphtrack.model.observation import Observation
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term
from graphtrack.packages import sympy

WALL_INPUT = "walls"
"""Name of the input: `WalkableArea.walls` of each frame."""

STD = 0.01
"""Metres from a wall at which the barrier begins, and the 1-σ of its penalty within them."""


def with_walls_at(
    observed: Sequence[Observation], position: FloatArray, area: WalkableArea
) -> list[Observation]:
    """Return observations with the input `WALL_INPUT` of walls near positions (n, 2), NaN: nowhere."""
    walls = map(tuple, area.walls(position).tolist())
    return [
        replace(one, inputs={**one.inputs, WALL_INPUT: near})
        for one, near in zip(observed, walls, strict=True)
    ]


def wall(now: Any, x: Any, y: Any, offset: Any, weight: Any) -> Cost:
    """Return ½·w·max(0, c − normal·position)², the squared depth beyond the barrier of a half plane."""
    depth = offset - (x * now.x + y * now.y)
    return Cost([sympy.sqrt(weight) * depth], where=depth > 0)


def _names(k: int) -> dict[str, str]:
    return {part: f"wall{k}_{part}" for part in ("x", "y", "offset", "weight")}


class StaysInside(Term):
    """½·(max(0, `MARGIN` − d)/`STD`)² of the distance d from each wall of the input `WALL_INPUT`."""

    reads = ()
    fields = tuple(
        Field(name, text)
        for k in range(WALLS)
        for name, text in (
            (f"wall{k}_x", "inward unit normal of a wall"),
            (f"wall{k}_y", ""),
            (f"wall{k}_offset", "metres along the normal at which the barrier begins"),
            (f"wall{k}_weight", "1/m²; 0 where there is no wall"),
        )
    )
    kernels: ClassVar[tuple[Kernel, ...]] = tuple(
        Kernel(wall, gate=f"wall{k}_weight", variables=("position",), names=_names(k)) for k in range(WALLS)
    )

    def pack(self, packed: PackedTracks) -> None:
        """Normals and offsets of the frames; no weight where there is no wall."""
        normal, offset, known = _walls_of(packed.input(WALL_INPUT, 3 * WALLS))
        for k in range(WALLS):
            packed.records[f"wall{k}_x"], packed.records[f"wall{k}_y"] = normal[:, k].T
            packed.records[f"wall{k}_offset"] = offset[:, k] + MARGIN
            packed.records[f"wall{k}_weight"] = np.where(known[:, k], STD**-2.0, 0.0)


def barrier_depth(walls: FloatArray, position: FloatArray) -> FloatArray:
    """Return metres (n, `WALLS`) of positions (n, 2) beyond the barriers of their walls, 0 within them."""
    normal, offset, known = _walls_of(walls)
    inside = np.sum(normal * position[:, None], axis=2) - offset
    return np.where(known, np.maximum(MARGIN - inside, 0.0), 0.0)


def _walls_of(walls: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Normals (n, `WALLS`, 2), offsets and presence of walls (n, `WALLS`)."""
    walls = np.nan_to_num(walls).reshape(-1, WALLS, 3)
    return walls[..., :2], walls[..., 2], np.any(walls[..., :2] != 0.0, axis=2)
