"""Ray casting of solids over a ground plane, with one light, an ambient term and shadows on the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.readiness import Rehearsal, make_ready
from perception.synthetic.raycast_kernels import cast_rays, group_balls
from perception.synthetic.solids import Solids


@dataclass(frozen=True)
class Light:
    """A distant light and the light from all around.

    Attributes
    ----------
    direction : (3,) unit vector towards the light
    key : (3,) strength of the light, blue green red
    ambient : (3,) strength from all around
    """

    direction: tuple[float, float, float]
    key: tuple[float, float, float]
    ambient: tuple[float, float, float]

    @classmethod
    def above(cls, bearing: float, height: float, key: ArrayLike, ambient: ArrayLike) -> Light:
        """A light at a bearing and a height above the horizon, in radians; strengths (3,)."""
        toward = np.cos(height) * np.cos(bearing), np.cos(height) * np.sin(bearing), np.sin(height)
        return cls(*(tuple(np.asarray(values, float).tolist()) for values in (toward, key, ambient)))


@dataclass(frozen=True)
class Ground:
    """A tiled floor z = 0.

    Attributes
    ----------
    colour : (3,) albedo
    tile : size of a tile in metres
    contrast : how much every other tile is darker, 0…1
    """

    colour: tuple[float, float, float]
    tile: float = 0.6
    contrast: float = 0.1


@dataclass(frozen=True, eq=False)
class Cast:
    """What the rays of an image of h × w pixels met.

    Attributes
    ----------
    colour : (h, w, 3) light that arrives, 1 being white; 0 where nothing was met
    covered : (h, w) whether a solid or the ground was met
    skin : (h, w) whether skin was met
    nearest : (h, w) group met first; −1 for ground and nothing
    extent : (g, 4) first and last column and row that each group covers, hidden or not; −1 without any
    covers, shows : (owners,) pixels that each owner covers, and of these the ones where it is the nearest
    """

    colour: NDArray[np.float32]
    covered: NDArray[np.bool_]
    skin: NDArray[np.bool_]
    nearest: NDArray[np.int32]
    extent: NDArray[np.int64]
    covers: NDArray[np.int64]
    shows: NDArray[np.int64]


def cast(
    origin: FloatArray,
    rays: FloatArray,
    solids: Solids,
    light: Light,
    *,
    ground: Ground | None = None,
    n_groups: int | None = None,
    owner: NDArray[np.int64] | None = None,
) -> Cast:
    """Follow rays into a scene.

    Parameters
    ----------
    origin : (3,) metres, where all rays start
    rays : (h, w, 3) unit directions; NaN where the lens shows nothing
    solids : sorted by group (`Solids.together` does that)
    ground : the floor, if there is one
    n_groups : groups to tell of; by default up to the last that occurs
    owner : (g,) ascending numbers of what the groups belong to; each group to itself by default. A group
        that hides another of the same owner does not count as in front of it.
    """
    inverse = np.linalg.inv(solids.axes)
    lengths = np.linalg.norm(solids.axes, axis=1)
    radius = np.where(solids.kind == 0, lengths.max(axis=1), np.linalg.norm(lengths, axis=1))
    count = (int(solids.group[-1]) + 1 if len(solids) else 0) if n_groups is None else n_groups
    first = np.searchsorted(solids.group, np.arange(count + 1))
    balls = group_balls(solids.centre, radius, first)
    owner = np.arange(count) if owner is None else owner
    floor = np.zeros(6)
    if ground is not None:
        floor[:] = 1.0, *ground.colour, ground.tile, ground.contrast
    h, w = rays.shape[:2]

    def follow(some: FloatArray) -> tuple[Any, ...]:
        found: tuple[Any, ...] = cast_rays(
            np.asarray(origin, float),
            some,
            w,
            solids.kind,
            solids.centre,
            inverse,
            radius,
            solids.clip,
            solids.colour,
            solids.texture,
            solids.material,
            first,
            balls,
            owner,
            np.array([light.direction, light.key, light.ambient], float),
            floor,
        )
        return found

    flat = np.ascontiguousarray(rays, float).reshape(-1, 3)
    make_ready("the renderer", Rehearsal("renderer", lambda: follow(flat[:1]), 7.0))
    colour, covered, skin, nearest, extent, covers, shows = follow(flat)
    return Cast(
        colour.reshape(h, w, 3),
        covered.reshape(h, w),
        skin.reshape(h, w),
        nearest.reshape(h, w),
        extent,
        covers,
        shows,
    )
