"""The camera above a ground plane: homographies, pixels ↔ metres, pose angles in the image ↔ in the world.

Source for the angles: Chen, Heili & Odobez 2011, §3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction, unit, wrap

LARGEST_CONDITION = 1e10
"""The condition number, after normalising the coordinates, from which a homography counts as singular."""

LARGEST_ENTRY = 1e15
"""The largest valid entry of a homography, and of a point to fit one to."""


@dataclass(frozen=True, eq=False)
class HomographyFit:
    """A homography fitted to pairs of points.

    Attributes
    ----------
    homography : (3, 3) source → target
    rms_error, max_error : distance between mapped source and target, in the target's units
    n_pairs : number of pairs; with four pairs the errors are always 0
    """

    homography: FloatArray
    rms_error: float
    max_error: float
    n_pairs: int


def fit_homography(source: ArrayLike, target: ArrayLike) -> HomographyFit:
    """The homography that takes ``source`` to ``target``, by the normalised direct linear transform.

    Parameters
    ----------
    source, target : (n, 2), n ≥ 4, any units

    Raises
    ------
    InputError
        With fewer than four pairs, values that are not finite, or points that do not determine a homography
        (three of four in a line, for instance).

    Notes
    -----
    Hartley & Zisserman, Multiple View Geometry, 2nd ed., algorithm 4.2.
    """
    source, target = np.array(source, dtype=float), np.array(target, dtype=float)
    if source.ndim != 2 or source.shape != target.shape or source.shape[1] != 2:
        raise InputError(f"points of shapes {source.shape} and {target.shape}", "two arrays of shape (n, 2)")
    if len(source) < 4:
        raise InputError(f"{len(source)} point pairs", "at least 4")
    if not (np.all(np.abs(source) <= LARGEST_ENTRY) and np.all(np.abs(target) <= LARGEST_ENTRY)):
        raise InputError("a point out of range", f"coordinates within ±{LARGEST_ENTRY:g}")
    into_source, into_target = _normaliser(source), _normaliser(target)
    (u, v), (x, y) = apply_homography(into_source, source).T, apply_homography(into_target, target).T
    one, zero = np.ones_like(u), np.zeros_like(u)
    equations = np.concatenate(
        [
            np.column_stack([u, v, one, zero, zero, zero, -x * u, -x * v, -x]),
            np.column_stack([zero, zero, zero, u, v, one, -y * u, -y * v, -y]),
        ]
    )
    _, singular, rows = np.linalg.svd(equations)
    if singular[7] <= singular[0] * 1e-9:
        raise InputError("points in a line, or repeated points", "4 points, no 3 of them in a line")
    normalised = rows[-1].reshape(3, 3)
    if np.linalg.cond(normalised) > LARGEST_CONDITION:
        raise InputError("points in a line", "4 points, no 3 of them in a line")
    homography = np.linalg.inv(into_target) @ normalised @ into_source
    # The visible part of a plane lies on one side of the horizon; the sign is chosen positive there.
    depth = homography[2, :2] @ source.T + homography[2, 2]
    if np.median(depth) < 0.0:
        homography, depth = -homography, -depth
    if np.any(depth <= 0.0):
        raise InputError("points on both sides of the horizon", "pairs that one camera can see")
    error = np.linalg.norm(apply_homography(homography, source) - target, axis=1)
    return HomographyFit(homography, float(np.sqrt(np.mean(error**2))), float(error.max()), len(source))


def apply_homography(homography: ArrayLike, points: ArrayLike) -> FloatArray:
    """Map points (..., 2); points on the line that goes to infinity give NaN."""
    homography, points = np.asarray(homography, dtype=float), np.asarray(points, dtype=float)
    mapped = points @ homography[:, :2].T + homography[:, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        result = mapped[..., :2] / mapped[..., 2:]
    return np.where(np.isfinite(result), result, np.nan)


def jacobian(homography: ArrayLike, points: ArrayLike) -> FloatArray:
    """Derivative (..., 2, 2) of `apply_homography` at points (..., 2)."""
    homography, points = np.asarray(homography, dtype=float), np.asarray(points, dtype=float)
    mapped = points @ homography[:, :2].T + homography[:, 2]
    w = mapped[..., 2, None, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        result = (homography[:2, :2] - mapped[..., :2, None] / w * homography[2, :2]) / w
    return np.where(np.isfinite(result), result, np.nan)


def check_homography(homography: ArrayLike) -> FloatArray:
    """The homography as a (3, 3) array, normalised in sign and scale.

    Raises
    ------
    InputError
        If it has another shape, is not finite or is numerically singular.
    """
    homography = np.array(homography, dtype=float)
    if homography.shape != (3, 3):
        raise InputError(f"a homography of shape {homography.shape}", "shape (3, 3)")
    if not np.all(np.abs(homography) <= LARGEST_ENTRY):
        raise InputError("a homography with a value out of range", f"nine numbers within ±{LARGEST_ENTRY:g}")
    # Balance rows and columns first: metres and pixels differ in scale without being singular.
    balanced = homography.copy()
    for _ in range(10):
        for axis in (0, 1):
            size = np.linalg.norm(balanced, axis=axis, keepdims=True)
            if np.any(size < 1.0 / LARGEST_ENTRY**2):
                raise InputError("a singular homography", "an invertible one")
            balanced = balanced / size
    if not np.linalg.cond(balanced) < LARGEST_CONDITION:
        raise InputError("a singular homography", "an invertible one")
    return homography


def _normaliser(points: FloatArray) -> FloatArray:
    """The similarity that brings points to mean 0 and mean distance √2."""
    centre = points.mean(axis=0)
    distance = float(np.mean(np.linalg.norm(points - centre, axis=1)))
    if not 0.0 < distance < np.inf:
        raise InputError("identical points", "4 points, no 3 of them in a line")
    scale = np.sqrt(2.0) / distance
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])


__all__ = ["GroundCamera", "HomographyFit", "apply_homography", "fit_homography"]

Lens = Literal["pinhole", "fisheye"]
_COEFFICIENTS = {"pinhole": 5, "fisheye": 4}

_UNDISTORTED_WITHIN = 0.5
"""Largest round-trip error of an undistorted point in pixels; beyond it, the lens model has no inverse."""


@dataclass(frozen=True, eq=False)
class GroundCamera:
    """A camera above the ground plane.

    *Raw* pixels (u, v) are those of the image, origin top left, v down. *Ideal* pixels are raw pixels without
    the lens distortion; without distortion they are the same.

    Attributes
    ----------
    homography : (3, 3) ideal pixel → ground (metres); the third coordinate is positive on the visible side
        of the horizon
    intrinsics : (3, 3) camera matrix in pixels, if known
    distortion : (5,) k1, k2, p1, p2, k3 of OpenCV's model, or (4,) k1 … k4 of its fisheye model; needs
        ``intrinsics``
    centre_on_ground : (2,) the ground point below the optical centre (metres), where it is known apart from
        the intrinsics
    lens : "pinhole", or "fisheye": OpenCV's model (Kannala & Brandt 2006), in which the radius in units of
        the focal length is θ·(1 + k1·θ² + k2·θ⁴ + k3·θ⁶ + k4·θ⁸), θ being the angle from the optical axis;
        without a distortion it is equidistant. Its ideal pixels are those of a pinhole with the same camera
        matrix; there are none from 90° on.

    Raises
    ------
    InputError
        For a singular homography, or a distortion or a fisheye without intrinsics.
    """

    homography: FloatArray
    intrinsics: FloatArray | None = None
    distortion: FloatArray | None = None
    centre_on_ground: FloatArray | None = None
    lens: Lens = "pinhole"

    def __post_init__(self) -> None:
        self._set("homography", check_homography(self.homography))
        if self.lens not in _COEFFICIENTS:
            raise InputError(f"a lens {self.lens!r}", "'pinhole' or 'fisheye'")
        if self.lens == "fisheye" and self.distortion is None:
            self._set("distortion", np.zeros(4))
        coefficients = (_COEFFICIENTS[self.lens],)
        for name, shape in (("intrinsics", (3, 3)), ("distortion", coefficients), ("centre_on_ground", (2,))):
            value = getattr(self, name)
            if value is None:
                continue
            value = np.array(value, dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(f"{name} {value.tolist()}", f"finite numbers of shape {shape}")
            self._set(name, value)
        if self.distortion is not None and self.intrinsics is None:
            raise InputError("distortion without intrinsics", "both or neither")
        if self.intrinsics is not None and abs(np.linalg.det(self.intrinsics)) < 1e-12:
            raise InputError("a singular camera matrix", "an invertible one")

    def _set(self, name: str, value: FloatArray) -> None:
        value.setflags(write=False)
        object.__setattr__(self, name, value)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, GroundCamera):
            return NotImplemented
        return all(np.array_equal(getattr(self, n), getattr(other, n)) for n in self.__dataclass_fields__)

    def __hash__(self) -> int:
        return hash(self.homography.tobytes())

    def __reduce__(self) -> tuple[Any, ...]:
        return GroundCamera, tuple(getattr(self, name) for name in self.__dataclass_fields__)

    @classmethod
    def from_homography(cls, homography: ArrayLike, *, visible: ArrayLike | None = None) -> GroundCamera:
        """A camera with only a known homography.

        Parameters
        ----------
        homography : (3, 3) pixel → ground (metres), of either sign
        visible : (n, 2) pixels of points on the ground, which determine the visible side of the horizon.
            Without them it is the side below the horizon, as in an upright image.
        """
        homography = check_homography(homography)
        points = None if visible is None else np.asarray(visible, dtype=float).reshape(-1, 2)
        if points is not None:
            points = points[np.isfinite(points).all(axis=1)]
        if points is not None and len(points):
            side = float(np.median(points @ homography[2, :2] + homography[2, 2]))
        else:
            # A slope that changes w by less than 0.1 ‰ over a large image is rounding: then w is constant.
            sloped = abs(homography[2, 1]) * 1e4 > abs(homography[2, 2]) * 1e-4
            side = float(homography[2, 1] if sloped else homography[2, 2])
        return cls(-homography if side < 0.0 else homography)

    @classmethod
    def from_point_pairs(cls, pixel: ArrayLike, ground: ArrayLike) -> tuple[GroundCamera, HomographyFit]:
        """A camera from n ≥ 4 pixels (n, 2) and their ground points (n, 2) in metres, with the fit."""
        fit = fit_homography(pixel, ground)
        return cls(fit.homography), fit

    @classmethod
    def from_calibration(
        cls,
        rotation: ArrayLike,
        translation: ArrayLike,
        intrinsics: ArrayLike,
        distortion: ArrayLike | None = None,
        *,
        lens: Lens = "pinhole",
    ) -> GroundCamera:
        """A calibrated camera over the ground plane z = 0.

        Parameters
        ----------
        rotation : (3, 3), world → camera
        translation : (3,) metres: a point X has camera coordinates R·X + t
        intrinsics : (3, 3) camera matrix in pixels
        distortion : (5,) k1, k2, p1, p2, k3, or (4,) k1 … k4 of a fisheye
        lens : as in the attributes
        """
        rotation, translation = np.asarray(rotation, dtype=float), np.asarray(translation, dtype=float)
        intrinsics = np.asarray(intrinsics, dtype=float)
        # Ground → camera → image; the third coordinate is the depth, so the inverse has 1/depth there.
        to_image = intrinsics @ np.column_stack([rotation[:, :2], translation])
        centre = -rotation.T @ translation
        return cls(
            np.asarray(np.linalg.inv(check_homography(to_image)), dtype=float),
            intrinsics,
            None if distortion is None else np.asarray(distortion, dtype=float),
            centre[:2],
            lens,
        )

    @classmethod
    def from_scale(
        cls, metres_per_pixel: float, *, tilt: float = math.pi / 2.0, nadir: ArrayLike | None = None
    ) -> GroundCamera:
        """A view from far away, ``tilt`` radians down: x = s·u, y = −s·v / sin(tilt).

        By default from straight above; ``nadir`` (2,) is then the pixel below the camera.
        """
        s, deep = metres_per_pixel, metres_per_pixel / math.sin(tilt)
        centre = None if nadir is None else np.asarray(nadir, dtype=float) * [s, -deep]
        return cls(np.diag([s, -deep, 1.0]), centre_on_ground=centre)

    def resized(self, factor: float) -> GroundCamera:
        """The same camera for its image at ``factor`` times the size."""
        to_old = np.diag([1.0 / factor, 1.0 / factor, 1.0])
        intrinsics = None if self.intrinsics is None else np.diag([factor, factor, 1.0]) @ self.intrinsics
        return replace(self, homography=self.homography @ to_old, intrinsics=intrinsics)

    def undistort(self, pixel: ArrayLike) -> FloatArray:
        """Ideal pixels (..., 2) of raw pixels (..., 2); NaN where the lens model has no inverse."""
        pixel = np.asarray(pixel, dtype=float)
        if self.distortion is None or pixel.size == 0:
            return pixel.copy()
        import cv2

        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
        flat = np.ascontiguousarray(pixel.reshape(-1, 1, 2))
        k = self.intrinsics
        if self.lens == "fisheye":
            found = cv2.fisheye.undistortPoints(flat, k, self.distortion, R=np.eye(3), P=k, criteria=criteria)
        else:
            found = cv2.undistortPointsIter(flat, k, self.distortion, np.eye(3), k, criteria)
        ideal = np.asarray(found, float).reshape(pixel.shape)
        with np.errstate(invalid="ignore", over="ignore"):
            miss = np.linalg.norm(self.distort(ideal) - pixel, axis=-1, keepdims=True)
        return np.where(miss < _UNDISTORTED_WITHIN, ideal, np.nan)

    def distort(self, pixel: ArrayLike) -> FloatArray:
        """Raw pixels (..., 2) of ideal pixels (..., 2)."""
        pixel = np.asarray(pixel, dtype=float)
        if self.distortion is None or self.intrinsics is None or pixel.size == 0:
            return pixel.copy()
        import cv2

        ahead = apply_homography(np.linalg.inv(self.intrinsics), pixel).reshape(-1, 1, 2)
        if self.lens == "fisheye":
            bent = cv2.fisheye.distortPoints(ahead, np.eye(3), self.distortion)
        else:
            points = np.concatenate([ahead, np.ones((len(ahead), 1, 1))], axis=2)
            bent, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), self.distortion)
        return apply_homography(self.intrinsics, np.asarray(bent, float).reshape(pixel.shape))

    def image_to_ground(self, pixel: ArrayLike) -> FloatArray:
        """Ground points (..., 2) in metres of raw pixels (..., 2); NaN at and beyond the horizon."""
        ideal = self.undistort(pixel)
        depth = ideal @ self.homography[2, :2] + self.homography[2, 2]
        with np.errstate(invalid="ignore"):
            return np.where((depth > 0.0)[..., None], apply_homography(self.homography, ideal), np.nan)

    def ground_to_image(self, position: ArrayLike) -> FloatArray:
        """Raw pixels (..., 2) of ground points (..., 2, metres); NaN behind the camera."""
        position = np.asarray(position, dtype=float)
        depth = position @ self._to_image[2, :2] + self._to_image[2, 2]
        with np.errstate(invalid="ignore"):
            ideal = np.where((depth > 0.0)[..., None], apply_homography(self._to_image, position), np.nan)
        return self.distort(ideal)

    def ground_jacobian(self, pixel: ArrayLike) -> FloatArray:
        """Metres per ideal pixel: (..., 2, 2) derivative of the ground point at raw pixels (..., 2)."""
        return jacobian(self.homography, self.undistort(pixel))

    def pixel_jacobian(self, pixel: ArrayLike) -> FloatArray:
        """Metres per raw pixel: (..., 2, 2) derivative of the ground point at raw pixels (..., 2).

        It equals `ground_jacobian` except for a fisheye, whose raw and ideal pixels differ much.
        """
        return self.ground_jacobian(pixel) if self.lens == "pinhole" else self._metres_per_step(pixel)

    def _metres_per_step(self, pixel: ArrayLike) -> FloatArray:
        """Central differences (..., 2, 2) of `image_to_ground` for a step of one raw pixel, lens included."""
        pixel = np.asarray(pixel, dtype=float)
        steps = 0.5 * np.eye(2)
        return np.stack(
            [self.image_to_ground(pixel + step) - self.image_to_ground(pixel - step) for step in steps],
            axis=-1,
        )

    @cached_property
    def is_mirrored(self) -> bool:
        """Return whether the ground's axes are left-handed as seen from above.

        Image axes (u right, v down) are left-handed, so a map to a right-handed ground turns orientation.
        On the visible side the third coordinate is positive, and the sign is that of the determinant.
        """
        return bool(np.linalg.det(self.homography) > 0.0)

    @cached_property
    def optical_centre_on_ground(self) -> FloatArray | None:
        """The ground point (2,) below the optical centre in metres; None if only a homography is known."""
        if self.centre_on_ground is not None:
            return self.centre_on_ground
        centre = self._optical_centre
        return None if centre is None else centre[:2]

    @cached_property
    def height(self) -> float | None:
        """Metres of the optical centre above the ground; None if the camera matrix is not known."""
        centre = self._optical_centre
        return None if centre is None else abs(float(centre[2]))

    @cached_property
    def _optical_centre(self) -> FloatArray | None:
        """(3,) metres, by homography and camera matrix."""
        if self.intrinsics is None:
            return None
        pose = np.linalg.inv(self.intrinsics) @ self._to_image
        first, second, translation = pose.T / np.sqrt(np.linalg.norm(pose[:, 0]) * np.linalg.norm(pose[:, 1]))
        # Nearest rotation: the two columns are orthonormal only for an exact homography.
        rough = np.column_stack([first, second, np.cross(first, second)])
        left, _, right = np.linalg.svd(rough)
        return np.asarray(-(left @ right).T @ translation, dtype=float)

    def ray_bearing(self, position: ArrayLike) -> FloatArray:
        """World direction (..., radians) of the camera's view towards ground points (..., 2).

        With a known optical centre this is the direction from the point below it. Else the image is assumed
        to be upright: the ray's vertical plane then projects to the image column through the point, exactly
        on the central column and approximately elsewhere for a small downward tilt.
        """
        position = np.asarray(position, dtype=float)
        centre = self.optical_centre_on_ground
        if centre is not None:
            return direction(position - centre)
        ideal = apply_homography(self._to_image, position)
        away = jacobian(self.homography, ideal) @ np.array([0.0, -1.0])
        return direction(away)

    def world_angle(self, image_angle: ArrayLike, position: ArrayLike) -> FloatArray:
        """World angles (radians) of pose angles in the image frame, for people at ground points (..., 2).

        A pose angle in the image frame is 0 when the person faces the camera and grows counter-clockwise as
        seen from above, so that at +π/2 the person faces the right of the image. Hence world angle =
        image angle + bearing of the ray + π (Chen et al. 2011, §3); on a mirrored ground the image angle
        counts negative.
        """
        sign = -1.0 if self.is_mirrored else 1.0
        return wrap(sign * np.asarray(image_angle, dtype=float) + self.ray_bearing(position) + np.pi)

    def image_angle(self, world_angle: ArrayLike, position: ArrayLike) -> FloatArray:
        """The inverse of `world_angle`."""
        sign = -1.0 if self.is_mirrored else 1.0
        facing = np.asarray(world_angle, dtype=float) - self.ray_bearing(position) - np.pi
        return wrap(sign * facing)

    def image_direction_to_world(self, direction_in_image: ArrayLike, pixel: ArrayLike) -> FloatArray:
        """World direction (radians) of a horizontal object that points along an image-plane direction.

        Parameters
        ----------
        direction_in_image : (...,) radians in the image, 0 = right, counter-clockwise with v *up*
        pixel : (..., 2) raw pixel of the object

        Notes
        -----
        The map is the derivative of `image_to_ground` at the pixel, the lens distortion included. It holds at
        any height: the plane at the object's height has the same image as the ground, enlarged about the
        camera. So take the pixel of the object itself, not of its foot point.
        """
        pixel = np.asarray(pixel, dtype=float)
        toward = unit(direction_in_image) * np.array([0.5, -0.5])
        moved = self.image_to_ground(pixel + toward) - self.image_to_ground(pixel - toward)
        return np.where(np.isfinite(moved).all(axis=-1), direction(moved), np.nan)

    def world_direction_to_image(self, heading: ArrayLike, pixel: ArrayLike) -> FloatArray:
        """The inverse of `image_direction_to_world`: directions in the image of headings (...,), radians."""
        metres = self._metres_per_step(pixel)
        # Adjugate times heading, with the sign of the determinant: a direction needs no division.
        x, y = np.moveaxis(unit(heading), -1, 0)
        right = metres[..., 1, 1] * x - metres[..., 0, 1] * y
        down = metres[..., 0, 0] * y - metres[..., 1, 0] * x
        sign = np.sign(metres[..., 0, 0] * metres[..., 1, 1] - metres[..., 0, 1] * metres[..., 1, 0])
        known = np.isfinite(metres).all(axis=(-2, -1))
        return np.where(known, np.arctan2(-sign * down, sign * right), np.nan)

    @property
    def is_scale(self) -> bool:
        """Return True if a direction in the image has the same heading everywhere."""
        return self.distortion is None and not np.any(self.homography[2, :2])

    @cached_property
    def _to_image(self) -> FloatArray:
        """Ground → ideal pixel, the third coordinate positive on the visible side."""
        return np.asarray(np.linalg.inv(self.homography), dtype=float)
