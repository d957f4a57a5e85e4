"""A scene whose camera and furniture stand still: cast once, then only the rays near what moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from graphtrack.geometry.angles import FloatArray
from perception.synthetic.scene import (
    Furniture,
    Person,
    RenderedFrame,
    Scene,
    cast_scene,
    developed,
    furniture_solids,
)
from perception.synthetic.sensor import Sensor
from perception.synthetic.solids import Solids

_MARGIN = 3
"""Pixels around the boxes of what moves; a lens bends the edges of a box a little outwards."""
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


class StillScene:
    """Renders the same frames as `render_frame`, faster, where little of the scene moves.

    Parameters
    ----------
    scene : all that never moves
    oversampling : rays a pixel and axis
    """

    def __init__(self, scene: Scene, *, oversampling: int = 2) -> None:
        self._scene, self._oversampling = scene, oversampling
        self._rays = scene.camera.rays(oversampling)
        self._still = cast_scene(scene, (), self._rays)
        self._chosen = np.full_like(self._rays, np.nan)

    def render(
        self,
        people: Sequence[Person],
        sensor: Sensor,
        rng: np.random.Generator,
        *,
        moving: Sequence[Furniture] = (),
    ) -> RenderedFrame:
        """One frame with people, and with furniture that is not part of the scene itself."""
        scene = replace(self._scene, furniture=(*self._scene.furniture, *moving))
        solids = [person.solids() for person in people]
        movers = [*(Solids.together(*parts) for parts in solids), *(furniture_solids(f) for f in moving)]
        areas = [self._area(mover) for mover in movers]
        for area in areas:
            self._chosen[area] = self._rays[area]
        shown = cast_scene(scene, people, self._chosen)
        colour, covered = self._still.colour.copy(), self._still.covered.copy()
        for area in areas:
            colour[area], covered[area] = shown.colour[area], shown.covered[area]
            self._chosen[area] = np.nan
        shown = replace(shown, colour=colour, covered=covered)
        return developed(scene, people, shown, sensor, rng, oversampling=self._oversampling)

    def _area(self, solids: Solids) -> tuple[slice, slice]:
        """Rows and columns of the rays that may meet the solids or their shadow on the ground."""
        half = np.abs(solids.axes).sum(axis=2)
        corners = (solids.centre[:, None] + half[:, None] * _CORNERS).reshape(-1, 3)
        toward = np.array(self._scene.light.direction)
        shadow = corners - corners[:, 2:] / toward[2] * toward
        seen: FloatArray = self._scene.camera.project(np.vstack([corners, shadow]))
        if not np.isfinite(seen).all():
            return slice(None), slice(None)
        low = np.maximum((np.floor(seen.min(axis=0)) - _MARGIN) * self._oversampling, 0).astype(int)
        high = np.maximum((np.ceil(seen.max(axis=0)) + _MARGIN) * self._oversampling, 0).astype(int)
        return slice(low[1], high[1]), slice(low[0], high[0])
