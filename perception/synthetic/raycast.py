"""Ray casting of solids over a ground plane, with one light, an ambient term and shadows on the ground.

The compiled kernels intersect rays with ellipsoids, tubes and boxes in their local coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import Rehearsal, kept, make_ready
from perception.synthetic.solids import BOX, CHECKED, SKIN, SPECKLED, STRIPED, TUBE, Solids

_FAR = 1e9
_NEAR = 1e-6


class _Packed(NamedTuple):
    """Solids in the form of the kernels: those of `Solids`, with bounding spheres of solids and groups."""

    kind: NDArray[np.int64]
    centre: FloatArray
    inverse: FloatArray
    radius: FloatArray
    clip: FloatArray
    colour: FloatArray
    texture: NDArray[np.void]
    material: NDArray[np.int64]
    first: NDArray[np.int64]  # (g + 1,) first solid of each group
    ball_centre: FloatArray  # (g, 3) bounding sphere of each group
    ball_radius: FloatArray  # (g,) 0: empty

    @classmethod
    def of(cls, solids: Solids, groups: int) -> _Packed:
        """Pack solids sorted by group."""
        lengths = np.linalg.norm(solids.axes, axis=1)
        radius = np.where(solids.kind == 0, lengths.max(axis=1), np.linalg.norm(lengths, axis=1))
        first = np.searchsorted(solids.group, np.arange(groups + 1))
        ball_centre, ball_radius, used = (
            np.zeros((groups, 3)),
            np.zeros(groups),
            np.flatnonzero(np.diff(first)),
        )
        start = first[used]
        low = np.minimum.reduceat(solids.centre - radius[:, None], start)
        high = np.maximum.reduceat(solids.centre + radius[:, None], start)
        ball_centre[used] = 0.5 * (low + high)
        away = np.linalg.norm(solids.centre - ball_centre[solids.group], axis=1)
        ball_radius[used] = np.maximum.reduceat(away + radius, start)
        return cls(
            solids.kind,
            solids.centre,
            np.asarray(np.linalg.inv(solids.axes), float),
            radius,
            solids.clip,
            solids.colour,
            solids.texture,
            solids.material,
            first,
            ball_centre,
            ball_radius,
        )


@kept(inline="always")
def _misses_ball(dx: float, dy: float, dz: float, x: float, y: float, z: float, radius: float) -> bool:
    """Return True if the half line along d from the origin intersects the sphere around (x, y, z)."""
    along = x * dx + y * dy + z * dz
    outside = x * x + y * y + z * z - radius * radius
    return outside > 0.0 and (along <= 0.0 or along * along < outside)


@kept()
def _to_local(inverse: Any, x: float, y: float, z: float, out: Any) -> None:
    for i in range(3):
        out[i] = inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] * z


@kept()
def _hit(kind: int, p: Any, q: Any, clip: Any, local: Any, normal: Any) -> float:
    """Distance along the ray p + t·q in local coordinates, 1e9 if missed.

    Fills the local point and the outward local normal.
    """
    if kind == BOX:
        return _hit_box(p, q, local, normal)
    n = 2 if kind == TUBE else 3
    a, b, c = 0.0, 0.0, -1.0
    for i in range(n):
        a += q[i] * q[i]
        b += p[i] * q[i]
        c += p[i] * p[i]
    root = b * b - a * c
    if root <= 0.0 or a < 1e-18:
        return _FAR
    root = np.sqrt(root)
    for side in range(2):
        t = (-b - root) / a if side == 0 else (-b + root) / a
        if t < _NEAR:
            continue
        for i in range(3):
            local[i] = p[i] + t * q[i]
        if kind == TUBE and abs(local[2]) > 1.0:
            continue
        if clip[0] * local[0] + clip[1] * local[1] + clip[2] * local[2] > clip[3]:
            continue
        sign = 1.0 if side == 0 else -1.0  # the far side is hit from within
        for i in range(3):
            normal[i] = sign * local[i]
        if kind == TUBE:
            normal[2] = 0.0
        return t
    return _FAR


@kept()
def _hit_box(p: Any, q: Any, local: Any, normal: Any) -> float:
    near, far, axis = -_FAR, _FAR, 0
    for i in range(3):
        if abs(q[i]) < 1e-12:
            if abs(p[i]) > 1.0:
                return _FAR
            continue
        t0, t1 = (-1.0 - p[i]) / q[i], (1.0 - p[i]) / q[i]
        if t0 > t1:
            t0, t1 = t1, t0
        if t0 > near:
            near, axis = t0, i
        far = min(far, t1)
    if near > far or near < _NEAR:
        return _FAR
    for i in range(3):
        local[i] = p[i] + near * q[i]
        normal[i] = 0.0
    normal[axis] = -1.0 if q[axis] > 0.0 else 1.0
    return near


@kept(inline="always")
def _noise(x: float, y: float, z: float) -> float:
    """Noise in −1…1, constant on unit cells."""
    i = int(np.floor(x)) * 73856093 ^ int(np.floor(y)) * 19349663 ^ int(np.floor(z)) * 83492791
    i = (i ^ (i >> 13)) * 1274126177 & 0x7FFFFFFF
    i = (i ^ (i >> 16)) & 0xFFFF
    return i / 32767.5 - 1.0


@kept()
def _textured(texture: Any, local: Any) -> float:
    """Factor of the albedo at a local point."""
    kind, contrast, periods = texture.kind, texture.contrast, texture.periods
    if kind == SPECKLED:
        return 1.0 + contrast * _noise(local[0] * periods, local[1] * periods, local[2] * periods)
    band = int(np.floor(local[2] * periods)) & 1
    if kind == STRIPED:
        return 1.0 - contrast * band
    if kind == CHECKED:
        return 1.0 - contrast * 0.5 * (band + (int(np.floor(local[0] * periods)) & 1))
    return 1.0


@kept()
def _in_shadow(point: Any, toward: Any, solids: Any, scratch: Any) -> bool:
    """Return True if a solid lies between a point and the light."""
    lx, ly, lz = toward
    for g in range(len(solids.ball_radius)):
        b, radius = solids.ball_centre[g], solids.ball_radius[g]
        if radius == 0.0 or _misses_ball(
            lx, ly, lz, b[0] - point[0], b[1] - point[1], b[2] - point[2], radius
        ):
            continue
        for i in range(solids.first[g], solids.first[g + 1]):
            x = solids.centre[i, 0] - point[0]
            y, z = solids.centre[i, 1] - point[1], solids.centre[i, 2] - point[2]
            if _misses_ball(lx, ly, lz, x, y, z, solids.radius[i]):
                continue
            _to_local(solids.inverse[i], -x, -y, -z, scratch[0])
            _to_local(solids.inverse[i], lx, ly, lz, scratch[1])
            if _hit(solids.kind[i], scratch[0], scratch[1], solids.clip[i], scratch[2], scratch[3]) < _FAR:
                return True
    return False


@kept()
def cast_rays(
    origin: Any,
    rays: Any,
    width: int,
    solids: _Packed,
    owner: Any,
    light: Light,
    floor: TiledFloor,
    has_floor: bool,
) -> Any:
    """Follow each ray to the first surface and shade it; see `raycast.cast` for the output."""
    kind, centre, inverse, radius = solids.kind, solids.centre, solids.inverse, solids.radius
    clip, first, ball_radius = solids.clip, solids.first, solids.ball_radius
    n, groups = len(rays), len(ball_radius)
    colour = np.zeros((n, 3), np.float32)
    covered, skin = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    nearest = np.full(n, -1, np.int32)
    extent = np.full((groups, 4), -1, np.int64)
    owners = owner[-1] + 1 if groups else 0
    covers, shows = np.zeros(owners, np.int64), np.zeros(owners, np.int64)
    q, local, normal, world = np.empty(3), np.empty(3), np.empty(3), np.zeros(3)
    best_local, best_normal = np.empty(3), np.empty(3)
    scratch = np.empty((4, 3))
    start, away = np.empty((len(kind), 3)), centre - origin
    for i in range(len(kind)):
        _to_local(inverse[i], -away[i, 0], -away[i, 1], -away[i, 2], start[i])
    ball_away = solids.ball_centre - origin
    toward = light.direction
    for r in range(n):
        dx, dy, dz = rays[r]
        if not np.isfinite(dx):
            continue
        t_best, hit, last = _FAR, -1, -1
        for g in range(groups):
            b = ball_away[g]
            if ball_radius[g] == 0.0 or _misses_ball(dx, dy, dz, b[0], b[1], b[2], ball_radius[g]):
                continue
            met = False
            for i in range(first[g], first[g + 1]):
                if _misses_ball(dx, dy, dz, away[i, 0], away[i, 1], away[i, 2], radius[i]):
                    continue
                _to_local(inverse[i], dx, dy, dz, q)
                t = _hit(kind[i], start[i], q, clip[i], local, normal)
                if t >= _FAR:
                    continue
                met = True
                if t < t_best:
                    t_best, hit = t, i
                    nearest[r] = g
                    for k in range(3):
                        best_local[k], best_normal[k] = local[k], normal[k]
            if met:
                u, v = r % width, r // width
                e = extent[g]
                if e[0] < 0:
                    e[0], e[1], e[2], e[3] = u, u, v, v
                e[0], e[1] = min(e[0], u), max(e[1], u)
                e[2], e[3] = min(e[2], v), max(e[3], v)
                if owner[g] != last:
                    last = owner[g]
                    covers[last] += 1
        if has_floor and dz < -1e-6 and -origin[2] / dz < t_best:
            nearest[r] = -1
            covered[r] = True
            t = -origin[2] / dz
            world[0], world[1], world[2] = origin[0] + t * dx, origin[1] + t * dy, 0.0
            dark = (int(np.floor(world[0] / floor.tile)) + int(np.floor(world[1] / floor.tile))) & 1
            lit = toward[2]
            if _in_shadow(world, toward, solids, scratch):
                lit = 0.0
            for k in range(3):
                shade = floor.colour[k] * (1.0 - floor.contrast * dark)
                colour[r, k] = shade * (light.ambient[k] + light.key[k] * lit)
            continue
        if hit < 0:
            continue
        shows[owner[nearest[r]]] += 1
        covered[r] = True
        skin[r] = solids.material[hit] == SKIN
        length, lit = 0.0, 0.0
        for k in range(3):  # normals transform by the transposed inverse
            world[k] = 0.0
            for j in range(3):
                world[k] += inverse[hit, j, k] * best_normal[j]
            length += world[k] * world[k]
            lit += world[k] * toward[k]
        length = np.sqrt(length)
        lit = max(lit / length, 0.0)
        sky = 0.75 + 0.25 * world[2] / length
        factor = _textured(solids.texture[hit], best_local)
        for k in range(3):
            colour[r, k] = solids.colour[hit, k] * factor * (light.ambient[k] * sky + light.key[k] * lit)
    return colour, covered, skin, nearest, extent, covers, shows


class Light(NamedTuple):
    """Distant light and ambient light.

    Attributes
    ----------
    direction : (3,) unit vector towards the light
    key : (3,) strength of the light, blue green red
    ambient : (3,) strength of the ambient light
    """

    direction: tuple[float, float, float]
    key: tuple[float, float, float]
    ambient: tuple[float, float, float]

    @classmethod
    def above(cls, bearing: float, height: float, key: ArrayLike, ambient: ArrayLike) -> Light:
        """Return a light at a bearing and an elevation, in radians; strengths (3,)."""
        toward = np.cos(height) * np.cos(bearing), np.cos(height) * np.sin(bearing), np.sin(height)
        return cls(*(tuple(np.asarray(values, float).tolist()) for values in (toward, key, ambient)))

    def shaded(self, share: float) -> Light:
        """Return a light with less ambient light and a stronger key light, by a share 0…1."""
        if share == 0.0:
            return self
        b, g, r = ((1.0 + share) * value for value in self.key)
        blue, green, red = ((1.0 - share) * value for value in self.ambient)
        return Light(self.direction, (b, g, r), (blue, green, red))


class TiledFloor(NamedTuple):
    """A tiled floor z = 0.

    Attributes
    ----------
    colour : (3,) albedo
    tile : size of a tile in metres
    contrast : relative darkening of every other tile, 0…1
    """

    colour: tuple[float, float, float]
    tile: float = 0.6
    contrast: float = 0.1


@dataclass(frozen=True, eq=False)
class Cast:
    """Hits of the rays of an image of h × w pixels.

    Attributes
    ----------
    colour : (h, w, 3) incident light, white is 1; 0 without a hit
    covered : (h, w) whether a solid or the ground was hit
    skin : (h, w) whether skin was hit
    nearest : (h, w) group hit first; −1 for ground and no hit
    extent : (g, 4) first and last column and row that each group covers, hidden or not; −1 without any
    covers, shows : (owners,) number of pixels covered by each owner, and of pixels where it is nearest
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
    ground: TiledFloor | None = None,
    n_groups: int | None = None,
    owner: NDArray[np.int64] | None = None,
) -> Cast:
    """Cast rays into a scene.

    Parameters
    ----------
    origin : (3,) metres, where all rays start
    rays : (h, w, 3) unit directions; NaN outside the lens
    solids : sorted by group (`Solids.together` does that)
    ground : the floor; None: no floor
    n_groups : number of reported groups; by default up to the last that occurs
    owner : (g,) ascending owner numbers of the groups; by default each group is its own. A group
        that hides another of the same owner does not count as in front of it.
    """
    count = (int(solids.group[-1]) + 1 if len(solids) else 0) if n_groups is None else n_groups
    packed = _Packed.of(solids, count)
    owner = np.arange(count) if owner is None else owner
    floor = TiledFloor((0.0, 0.0, 0.0)) if ground is None else ground
    h, w = rays.shape[:2]

    def follow(some: FloatArray) -> tuple[Any, ...]:
        start, has_floor = np.asarray(origin, float), ground is not None
        found: tuple[Any, ...] = cast_rays(start, some, w, packed, owner, light, floor, has_floor)
        return found

    flat = np.ascontiguousarray(rays, float).reshape(-1, 3)
    make_ready("the renderer", Rehearsal("renderer", lambda: follow(flat[:1]), 7.0))
    colour, *images, extent, covers, shows = follow(flat)
    covered, skin, nearest = (image.reshape(h, w) for image in images)
    return Cast(colour.reshape(h, w, 3), covered, skin, nearest, extent, covers, shows)
