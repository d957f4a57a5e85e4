"""Conventions of angles in files: direction of zero, sense of rotation, unit.

Inside the package an angle is in radians, counter-clockwise from +x. An angle a of another convention is the
heading z + s·a, with z the heading of its zero and s = ±1; in an image the same holds for directions in the
image, which the camera maps to the ground.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, class_centres, likelihood_at, wrap
from graphtrack.geometry.camera import GroundCamera

Sense = Literal["ccw", "cw"]
Zero = Literal["right", "up", "left", "down", "x", "y", "-x", "-y", "east", "north", "west", "south"]

IMAGE = {"right": 0.0, "up": 90.0, "left": 180.0, "down": -90.0}
"""Direction in the image → degrees counter-clockwise from its right; on a plane without image up is +y."""

COMPASS = {"east": 0.0, "north": 90.0, "west": 180.0, "south": -90.0}
"""Direction of the compass → heading in degrees, where x points east and y north."""

_AXES = {"x": 0.0, "y": 90.0, "-x": 180.0, "-y": -90.0}
_ZEROS: Mapping[str, float] = IMAGE | COMPASS | _AXES
_SENSES: Mapping[str, Sense] = {
    **dict.fromkeys(("ccw", "counterclockwise", "anticlockwise"), "ccw"),
    **dict.fromkeys(("cw", "clockwise"), "cw"),
}
_SPELLINGS = {"+x": "x", "+y": "y", "top": "up", "bottom": "down", "upwards": "up"}
_UNITS = {"deg": "deg", "degrees": "deg", "rad": "rad", "radians": "rad"}
_FILLERS = ("from", "the", "image", "of", "in", "and", "positive", "zero", "at", "is")
_WORD = re.compile(r"[+-]?[a-z]+|[+-]?\d+(?:\.\d+)?")

EXPECTED = (
    "a sense (clockwise, counter-clockwise) and a zero (up, right, left, down of the image; x, y, -x, -y; "
    "north, east, south, west; degrees counter-clockwise from x), such as 'clockwise from image up', "
    "'compass', 'radians, clockwise from y'"
)

ANGLES = ("body", "head", "body_axis", "true_body", "true_head")
"""Fields of a track that are angles in the plane."""

UNPLACED = "the camera maps directions at the place of a person"
"""Reason why an angle in an image has no heading."""

_LIKELIHOODS = ("body_likelihood", "head_likelihood")


@dataclass(frozen=True)
class AngleConvention:
    """Meaning of the angles in a file; by default the one of the native table.

    Attributes
    ----------
    zero : direction of the angle 0. ``right``, ``up``, ``left`` and ``down`` are directions in the image
        where rows have a camera or a scale, else +x, +y, −x and −y; ``x``, ``y``, ``-x``, ``-y`` are axes of
        the ground; ``north`` is +y and ``east`` +x; a number is in degrees, counter-clockwise from +x
    sense : "ccw" or "cw", counter-clockwise or clockwise seen from above, or in the image
    unit : "deg" or "rad", of the columns; columns named as radians are in radians

    Raises
    ------
    InputError
        For another value.
    """

    zero: str | float = "x"
    sense: Sense = "ccw"
    unit: Literal["deg", "rad"] = "deg"

    def __post_init__(self) -> None:
        number = not isinstance(self.zero, str | bool) and math.isfinite(self.zero)
        if not number and self.zero not in _ZEROS:
            raise InputError(f"a zero of angles {self.zero!r}", f"one of {', '.join(_ZEROS)}, or degrees")
        if self.sense not in ("ccw", "cw"):
            raise InputError(f"a sense of angles {self.sense!r}", "ccw or cw")
        if self.unit not in ("deg", "rad"):
            raise InputError(f"a unit of angles {self.unit!r}", "deg or rad")

    @classmethod
    def of(cls, given: AngleConvention | str) -> AngleConvention:
        """Return a convention from text such as "clockwise from image up", "compass", "ccw from -y, radians".

        Counter-clockwise from +x and degrees are the defaults; angles from a direction of the compass are
        clockwise by default.
        """
        if isinstance(given, cls):
            return given
        if not isinstance(given, str):
            raise InputError(f"angles of type {type(given).__name__}", EXPECTED)
        text = re.sub(r"(counter|anti)[\s-]+clockwise", r"\1clockwise", given.lower().replace("−", "-"))
        text = re.sub(r"(?<=[a-z])-(?=[a-z])", " ", text)  # clockwise-from-up
        found: dict[str, Any] = {}
        place = 0
        for word in _WORD.finditer(text):
            if text[place : word.start()].strip(" ,;:°\t-"):
                raise InputError(f"angles {given!r}", EXPECTED)
            place = word.end()
            name = _SPELLINGS.get(word[0], word[0])
            for key, value in _meaning(name, given):
                if found.setdefault(key, value) != value:
                    raise InputError(f"angles {given!r}, with two meanings of the {key}", EXPECTED)
        if text[place:].strip(" ,;:°\t.") or not found or (found.get("zero") in COMPASS and "image" in text):
            raise InputError(f"angles {given!r}", EXPECTED)
        return cls.between(found.get("zero"), found.get("sense"), found.get("unit", "deg"))

    @classmethod
    def between(
        cls, zero: str | float | None, sense: Sense | None, unit: Literal["deg", "rad"] = "deg"
    ) -> AngleConvention:
        """Return the convention of a zero and a sense, with the defaults of `of` where one is None."""
        default: Sense = "cw" if isinstance(zero, str) and zero in COMPASS else "ccw"
        return cls("x" if zero is None else zero, default if sense is None else sense, unit)

    @property
    def is_in_image(self) -> bool:
        """Return True if the angles are directions in an image, where there is one."""
        return self.zero in IMAGE

    @property
    def origin(self) -> float:
        """Direction of the angle 0, radians counter-clockwise from +x, or from the image's right."""
        return math.radians(_ZEROS[self.zero] if isinstance(self.zero, str) else self.zero)

    @property
    def sign(self) -> float:
        """1 for counter-clockwise, -1 for clockwise."""
        return 1.0 if self.sense == "ccw" else -1.0

    def headings(self, angles: ArrayLike) -> FloatArray:
        """Return headings of angles of this convention, of any shape, both in radians, within (−π, π]."""
        return wrap(self.origin + self.sign * np.asarray(angles, float))

    def angles(self, headings: ArrayLike) -> FloatArray:
        """Return the angles of headings: the inverse of `headings`; bearings of a compass are in [0, 2π)."""
        found = self.sign * (np.asarray(headings, float) - self.origin)
        return np.mod(found, 2.0 * np.pi) if self.zero in COMPASS else wrap(found)

    def __str__(self) -> str:
        sense = "counter-clockwise" if self.sense == "ccw" else "clockwise"
        zero = self.zero if isinstance(self.zero, str) else f"{self.zero:g}"
        return ("radians, " if self.unit == "rad" else "") + f"{sense} from {zero}"


def _meaning(word: str, given: str) -> list[tuple[str, Any]]:
    """Return the fields that a word of a convention decides."""
    if word in _SENSES:
        return [("sense", _SENSES[word])]
    if word in _ZEROS:
        return [("zero", word)]
    if word in _UNITS:
        return [("unit", _UNITS[word])]
    if word in ("compass", "bearing", "bearings"):
        return [("zero", "north"), ("sense", "cw")]
    if word in _FILLERS:
        return []
    try:
        return [("zero", float(word))]
    except ValueError:
        raise InputError(f"angles {given!r}", EXPECTED) from None


NATIVE = AngleConvention()
BEARINGS = AngleConvention("north", "cw")
"""Compass bearings: clockwise from north."""


def converted(
    channels: Mapping[str, Any],
    convention: AngleConvention,
    camera: GroundCamera | None,
    *,
    back: bool = False,
) -> dict[str, FloatArray]:
    """Return the angles and class likelihoods among channels as headings, or ``back`` in the convention.

    Directions in an image are mapped by the camera at the row's pixel, else at its position. Without either
    the heading is NaN, unless the camera is a scale.

    Parameters
    ----------
    channels : `Track` attribute → (n, ...), angles in radians; None where missing
    camera : of the rows; None: directions of the image are those of the ground

    Returns
    -------
    dict
        The changed channels.
    """
    given = {name: one for name in (*ANGLES, *_LIKELIHOODS) if (one := channels.get(name)) is not None}
    if not given:
        return {}
    mapped = _Mapping(convention, camera, channels, len(next(iter(given.values()))))
    found: dict[str, FloatArray] = {}
    for name, values in given.items():
        if name in ANGLES:
            found[name] = mapped.angles(values) if back else mapped.headings(values)
        else:
            centres = np.broadcast_to(class_centres(values.shape[1]), values.shape)
            place = mapped.headings(centres) if back else mapped.angles(centres)
            # A multiple of a class is exact, up to rounding.
            known = np.isfinite(place).all(axis=1) & np.isfinite(values).all(axis=1)
            found[name] = np.full(values.shape, np.nan)
            total = values[known].sum(axis=1, keepdims=True)
            found[name][known] = likelihood_at(values[known], place[known]) * total
    return found


class _Mapping:
    """Angles of a convention ↔ headings, (n,) or (n, k), of n rows."""

    def __init__(
        self, convention: AngleConvention, camera: GroundCamera | None, channels: Mapping[str, Any], n: int
    ) -> None:
        self._convention = convention
        self._camera = camera if convention.is_in_image else None
        if self._camera is None:
            return
        pixel, position = channels.get("pixel"), channels.get("position")
        if position is not None:
            image = self._camera.ground_to_image(position)
            pixel = image if pixel is None else np.where(np.isfinite(pixel), pixel, image)
        if pixel is None:
            pixel = np.full((n, 2), np.nan)
        self._pixel = np.nan_to_num(pixel) if self._camera.is_scale else pixel

    def _pixels(self, angles: FloatArray) -> FloatArray:
        pixel = self._pixel if angles.ndim == 1 else self._pixel[:, None]
        return np.broadcast_to(pixel, (*angles.shape, 2))

    def headings(self, angles: FloatArray) -> FloatArray:
        directions = self._convention.headings(angles)
        if self._camera is None:
            return directions
        return self._camera.image_direction_to_world(directions, self._pixels(angles))

    def angles(self, headings: FloatArray) -> FloatArray:
        if self._camera is None:
            return self._convention.angles(headings)
        directions = self._camera.world_direction_to_image(headings, self._pixels(headings))
        return self._convention.angles(directions)
