"""Ellipsoids, tubes and boxes, the primitives of heads, people and furniture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.geometry.angles import FloatArray

ELLIPSOID, TUBE, BOX = 0, 1, 2
"""Unit sphere, open unit cylinder along local z (|z| ≤ 1) and cube (|x|, |y|, |z| ≤ 1), mapped by axes."""

PLAIN, SPECKLED, STRIPED, CHECKED = 0, 1, 2, 3
"""Textures: none, noise, bands along local z, bands along local z and x."""

SKIN, OTHER = 1, 0
"""Materials: skin or other, as needed by labels."""

TEXTURE = np.dtype([("kind", np.int64), ("contrast", float), ("periods", float)])
"""Kind of texture, contrast in 0…1, and periods over the solid."""

_NO_CLIP = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Solids:
    """Set of m solids in one frame (metres, right-handed, z up).

    Attributes
    ----------
    kind : (m,) ELLIPSOID, TUBE or BOX
    centre : (m, 3) metres
    axes : (m, 3, 3) the columns are the semi-axes (metres): a point of the solid is centre + axes · local
    clip : (m, 4) only the surface with n·local ≤ d exists, for rows (n, d)
    colour : (m, 3) albedo in 0…1, blue green red
    texture : (m,) of `TEXTURE`
    material : (m,) SKIN or OTHER
    group : (m,) group of the solid; boxes and visibility are reported per group
    """

    kind: NDArray[np.int64]
    centre: FloatArray
    axes: FloatArray
    clip: FloatArray
    colour: FloatArray
    texture: NDArray[np.void]
    material: NDArray[np.int64]
    group: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.kind)

    def moved(self, rotation: FloatArray, translation: ArrayLike) -> Solids:
        """Rotate by (3, 3) about the origin, then move by (3,) metres."""
        return replace(
            self, centre=self.centre @ rotation.T + np.asarray(translation), axes=rotation @ self.axes
        )

    def scaled(self, factor: ArrayLike) -> Solids:
        """Scale about the origin by a factor, or by one factor for each axis (3,)."""
        factor = np.broadcast_to(np.asarray(factor, dtype=float), (3,))
        return replace(self, centre=self.centre * factor, axes=self.axes * factor[:, None])

    def in_group(self, group: int) -> Solids:
        """Return the same solids, all in one group."""
        return replace(self, group=np.full(len(self), group, np.int64))

    @staticmethod
    def together(*parts: Solids) -> Solids:
        """Concatenate solids, sorted by group, for the ray caster."""
        names = Solids.__dataclass_fields__
        joined: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
        order = np.argsort(joined["group"], kind="stable")
        return Solids(**{name: values[order] for name, values in joined.items()})


class Builder:
    """Builder of solids; all lengths in metres."""

    def __init__(self) -> None:
        self._rows: list[tuple[Any, ...]] = []

    def ellipsoid(
        self,
        centre: ArrayLike,
        semi_axes: ArrayLike,
        colour: ArrayLike,
        *,
        clip: tuple[float, float, float, float] = _NO_CLIP,
        texture: tuple[int, float, float] = (PLAIN, 0.0, 0.0),
        skin: bool = False,
        rotation: FloatArray | None = None,
    ) -> None:
        """Add an ellipsoid; ``clip`` (n, d) is in units of its semi-axes."""
        self._add(ELLIPSOID, centre, semi_axes, colour, texture, skin=skin, clip=clip, rotation=rotation)

    def box(
        self,
        centre: ArrayLike,
        semi_axes: ArrayLike,
        colour: ArrayLike,
        *,
        texture: tuple[int, float, float] = (PLAIN, 0.0, 0.0),
        rotation: FloatArray | None = None,
    ) -> None:
        """Add a box of twice the semi-axes."""
        self._add(BOX, centre, semi_axes, colour, texture, rotation=rotation)

    def limb(
        self,
        start: ArrayLike,
        end: ArrayLike,
        radius: float,
        colour: ArrayLike,
        *,
        texture: tuple[int, float, float] = (PLAIN, 0.0, 0.0),
        skin: bool = False,
    ) -> None:
        """Add a tube from ``start`` to ``end`` (3,) with a ball at either end."""
        start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        along = end - start
        length = float(np.linalg.norm(along))
        w = along / length
        x, y, z = w.tolist()
        across = np.hypot(x, y)
        # Any frame around w will do: one axis horizontal, unless w is vertical.
        u = (-y / across, x / across, 0.0) if across > 1e-6 else (1.0, 0.0, 0.0)
        v = (y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0])
        rotation = np.array([u, v, (x, y, z)]).T
        middle, semi = (start + end) / 2.0, (radius, radius, length / 2.0)
        self._add(TUBE, middle, semi, colour, texture, skin=skin, rotation=rotation)
        for ball in (start, end):
            self._add(ELLIPSOID, ball, (radius,) * 3, colour, texture, skin=skin)

    def _add(
        self,
        kind: int,
        centre: ArrayLike,
        semi_axes: ArrayLike,
        colour: ArrayLike,
        texture: tuple[float, ...],
        *,
        skin: bool = False,
        clip: tuple[float, ...] = _NO_CLIP,
        rotation: FloatArray | None = None,
    ) -> None:
        axes = np.diag(np.asarray(semi_axes, dtype=float))
        if rotation is not None:
            axes = rotation @ axes
        self._rows.append((kind, centre, axes, clip, colour, texture, SKIN if skin else OTHER))

    def build(self, group: int = 0) -> Solids:
        """Return all added solids, in one group."""
        columns = list(zip(*self._rows, strict=True)) if self._rows else [()] * 7
        kind, centre, axes, clip, colour, texture, material = columns
        return Solids(
            np.array(kind, np.int64),
            np.array(centre, float).reshape(-1, 3),
            np.array(axes, float).reshape(-1, 3, 3),
            np.array(clip, float).reshape(-1, 4),
            np.array(colour, float).reshape(-1, 3),
            np.array(list(texture), TEXTURE),
            np.array(material, np.int64),
            np.full(len(kind), group, np.int64),
        )


def _rotation(angle: ArrayLike, first: int, second: int) -> FloatArray:
    """Return rotations (..., 3, 3) by angles (...) in radians that turn one axis towards another."""
    angle = np.asarray(angle, float)
    result = np.broadcast_to(np.eye(3), (*angle.shape, 3, 3)).copy()
    result[..., first, first] = result[..., second, second] = np.cos(angle)
    result[..., second, first] = np.sin(angle)
    result[..., first, second] = -np.sin(angle)
    return result


def rotation_z(angle: ArrayLike) -> FloatArray:
    """Rotations (..., 3, 3) by radians (...) about z, counter-clockwise from above."""
    return _rotation(angle, 0, 1)


def rotation_up(angle: ArrayLike) -> FloatArray:
    """Rotations (..., 3, 3) that lift the x axis by radians (...)."""
    return _rotation(angle, 0, 2)


def rotation_roll(angle: ArrayLike) -> FloatArray:
    """Rotations (..., 3, 3) by radians (...) about the x axis."""
    return _rotation(angle, 1, 2)
