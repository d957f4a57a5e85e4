"""A place that attracts or repels people."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import Field, Kernel, X, Y
from graphtrack.model.observation import States
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term
from graphtrack.tracks.track import Track


@compiled
def add_place(
    state: FloatArray,
    origin_x: float,
    origin_y: float,
    place_weight: float,
    place_x: float,
    place_y: float,
    place_radius: float,
    place_sign: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """w·(1 − e^−u) of an attracting place, w·e^−u of a repelling one, with u = ½(distance/radius)²."""
    scale = 1.0 / (place_radius * place_radius)
    dx, dy = state[X] - (place_x - origin_x), state[Y] - (place_y - origin_y)
    near = math.exp(-0.5 * scale * (dx * dx + dy * dy))
    pull = place_sign * place_weight * near * scale
    gradient[X] += pull * dx
    gradient[Y] += pull * dy
    # Gauss–Newton, from the rows √pull·d, or of √(2·w·e^−u), which has one row.
    round_part = pull if exact or place_sign > 0.0 else 0.0
    long_part = -pull * scale if exact else (0.0 if place_sign > 0.0 else -0.5 * pull * scale)
    hessian[X, X] += round_part + long_part * dx * dx
    hessian[Y, X] += long_part * dx * dy
    hessian[Y, Y] += round_part + long_part * dy * dy
    return place_weight * (1.0 - near if place_sign > 0.0 else near)


class PlacePrior(Term):
    """A place near which people are more, or less, likely than elsewhere (`PlaceParameters`)."""

    repeats = True
    reads = ("place.x", "place.y", "place.radius", "place.strength", "coupling.correlation_time")
    fields = (Field("place_weight", "|strength| with the frame's weight"),)
    shared = (
        Field("place_x", "the place in the world, metres"),
        Field("place_y", ""),
        Field("place_radius", "metres"),
        Field("place_sign", "1: it attracts people, −1: it repels them"),
    )
    kernels = (Kernel(add_place, gate="place_weight", variables=("position",)),)

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ w·|strength|·(1 − e^−u), or e^−u where the strength is negative."""
        place = self.parameters.place
        away = np.linalg.norm(states.position - [place.x, place.y], axis=1) / place.radius
        near = np.exp(-0.5 * away**2)
        weights = abs(place.strength) * self.parameters.coupling.weights(track.dt)
        return float(np.sum(weights * (1.0 - near if place.strength > 0.0 else near)))

    def pack(self, packed: PackedTracks) -> None:
        """The strength with the frames' weights, and the place."""
        place, shared = self.parameters.place, packed.shared
        weights = self.parameters.coupling.weights(packed.dt)
        packed.records["place_weight"] = abs(place.strength) * weights
        shared["place_x"], shared["place_y"], shared["place_radius"] = place.x, place.y, place.radius
        shared["place_sign"] = 1.0 if place.strength > 0.0 else -1.0
