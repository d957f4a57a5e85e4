"""Motion of a camera in the image, from features of the background.

A camera that turns or zooms moves the image of everything by a homography; one that is carried, that of a
plane. Corners of a keyframe are found again in each frame (Lucas & Kanade 1981), and a homography is fitted
to them robustly. Keyframes are added where the view leaves those that exist, and used again where it returns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.geometry.camera import LARGEST_CONDITION, GroundCamera, apply_homography
from perception.detection.boxes import PersonBox, boxes_by_frame
from perception.images.frames import Frame
from perception.images.pixels import Image

_FEATURES = 600
"""Most corners of a keyframe."""
_FEWEST = 40
"""Fewest corners in view from which a motion is estimated."""
_SHARE = 0.15
"""Least share of the corners in view with a common motion: others are hidden, or people without a box."""
_ALIKE, _PATCH = 0.6, 4
"""Least correlation of a corner's surroundings, and pixels on each side; that of noise is about 0.1."""
_SECOND = 0.3
"""Corners with a second common motion, relative to those with the first, from which there is parallax."""
_UNCERTAIN = 0.02
"""Largest 1-σ of the motion at the image's corners, in widths of the image."""
_REACH = 2.0
"""Pixels between a corner and its place by the homography up to which it has the common motion."""
_OVERLAP = 0.7
"""Least overlap of the views of a frame and of its keyframe, as intersection over the larger one."""
_KEYFRAMES = 24
"""Most keyframes; the oldest but for the reference are forgotten."""
_ROUNDING = 1.0 / 32.0 / 12.0**0.5
"""Pixels, 1-σ: OpenCV interpolates at multiples of 1/32 pixel."""
_ROUNDS = 5
_STILL = 0.5
"""Pixels at the image's corners below which a warp makes no difference to the optical flow."""
_WINDOW, _LEVELS = 21, 4
_SAMPLED = 16
"""Pixels between those at which brightness is compared."""
_CELLS = 8
"""Columns and rows of the cells of the image within which errors of corners count as dependent."""
_MARGIN = 0.1
"""Margin around a person's box without corners, in heights of the box."""
_MATCHES = 20
"""Fewest matches of descriptors with a common motion from which an alignment begins."""

_Grey = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class ImageMotion:
    """Motion of the image since the reference frame.

    Attributes
    ----------
    to_reference : (3, 3) homography, ideal pixel of the frame → ideal pixel of the reference frame
    covariance : (9, 9) of E, row by row, in (1 + E)·``to_reference``
    """

    to_reference: FloatArray
    covariance: FloatArray

    @classmethod
    def none(cls) -> ImageMotion:
        """Return the motion of the reference frame."""
        return cls(np.eye(3), np.zeros((9, 9)))

    def since(self, other: ImageMotion) -> ImageMotion:
        """Return the motion since another frame; errors of both count as independent."""
        back = np.asarray(np.linalg.inv(other.to_reference), float)
        if self is other:
            return ImageMotion.none()
        return ImageMotion(back @ self.to_reference, transported(self.covariance + other.covariance, back))


def transported(covariance: FloatArray, by: FloatArray) -> FloatArray:
    """Return the covariance (9, 9) of B·E·B⁻¹ from that of E, row by row, for a homography B."""
    move = np.kron(by, np.linalg.inv(by).T)
    return np.asarray(move @ covariance @ move.T, float)


def displacement(points: FloatArray) -> FloatArray:
    """Return the derivative (n, 2, 9) of points (n, 2) mapped by 1 + E by E, row by row, at E = 0."""
    u, v = points.T
    one, zero = np.ones_like(u), np.zeros_like(u)
    first = [u, v, one, zero, zero, zero, -u * u, -u * v, -u]
    second = [zero, zero, zero, u, v, one, -v * u, -v * v, -v]
    return np.stack([np.stack(first, axis=1), np.stack(second, axis=1)], axis=1)


def spread(covariance: FloatArray, points: FloatArray) -> FloatArray:
    """Return covariances (n, 2, 2) of mapped points (n, 2), from that of E in (1 + E)·H, row by row."""
    moved = displacement(points)
    return np.asarray(moved @ covariance @ moved.transpose(0, 2, 1), float)


@dataclass(frozen=True)
class Lost:
    """Frame whose motion is not known, with the reason."""

    reason: str


@dataclass(frozen=True, eq=False)
class _Picture:
    """A frame in grey, without the lens, and the mask of its background."""

    grey: _Grey
    background: _Grey

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.grey.shape[1], self.grey.shape[0]

    @cached_property
    def corners(self) -> FloatArray:
        """Corners (n, 2) of the background, pixels."""
        apart = float(np.sqrt(self.grey.size / (2.0 * _FEATURES)))
        found = cv2.goodFeaturesToTrack(self.grey, _FEATURES, 0.01, apart, mask=self.background)
        return np.empty((0, 2)) if found is None else np.asarray(found.reshape(-1, 2), float)

    @cached_property
    def described(self) -> tuple[FloatArray, _Grey | None]:
        """Pixels (n, 2) and descriptors of the background."""
        points, descriptors = cv2.ORB.create(1000).detectAndCompute(self.grey, self.background)
        return np.array([point.pt for point in points]).reshape(-1, 2), descriptors

    def shows(self, pixels: FloatArray) -> BoolArray:
        """Return whether pixels (n, 2) are in the background."""
        columns, rows = self.size
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= 0.0) & (pixels <= (columns - 1.0, rows - 1.0))).all(axis=1)
        found = np.zeros(len(pixels), bool)
        u, v = pixels[inside].round().astype(int).T
        found[inside] = self.background[v, u] > 0
        return found


@dataclass(frozen=True, eq=False)
class _Keyframe:
    picture: _Picture
    motion: ImageMotion

    def overlap(self, homography: FloatArray) -> float:
        """Return the overlap with a frame, from its homography to the keyframe."""
        outline = _outline(self.picture.size)
        if (outline @ homography[2, :2] + homography[2, 2] <= 0.0).any():
            return 0.0
        own, other = outline.astype(np.float32), apply_homography(homography, outline).astype(np.float32)
        common, _ = cv2.intersectConvexConvex(own, other)
        return float(common / max(cv2.contourArea(own), cv2.contourArea(other)))


class CameraFollower:
    """Follower of a camera's motion, frame by frame in order.

    Parameters
    ----------
    lens : camera whose lens distortion is removed first; None: none
    """

    def __init__(self, lens: GroundCamera | None = None) -> None:
        self._lens = lens if lens is not None and lens.distortion is not None else None
        self._maps: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None
        self._keyframes: list[_Keyframe] = []
        self._last = ImageMotion.none()

    def step(self, image: Image, boxes: Iterable[PersonBox]) -> ImageMotion | Lost:
        """Return the motion of the next frame since the first one.

        Parameters
        ----------
        image : (h, w, 3), of one size
        boxes : people, who are no background

        Raises
        ------
        InputError
            If the first frame has too few corners.
        """
        boxes = list(boxes)
        picture = self._prepared(image, boxes)
        if not self._keyframes:
            if len(picture.corners) < _FEWEST:
                raise InputError(
                    f"{len(picture.corners)} corners of the background in the first frame",
                    f"at least {_FEWEST} to follow the camera; --homographies or --poses give its motion",
                )
            self._keyframes.append(_Keyframe(picture, self._last))
            return self._last
        reason = ""
        for keyframe, guess in self._guesses(picture):
            found = _aligned(keyframe.picture, picture, guess)
            if not isinstance(found, Lost):
                return self._kept(picture, keyframe, found)
            reason = reason or found.reason
        return Lost(reason)

    def _prepared(self, image: Image, boxes: list[PersonBox]) -> _Picture:
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        background = np.full(grey.shape, 255, np.uint8)
        for item in boxes:
            left, top, width, height = item.box
            margin = _MARGIN * height
            first = np.floor([left - margin, top - margin]).clip(0.0, grey.shape[::-1]).astype(int)
            last = np.ceil([left + width + margin, top + height + margin]).clip(0.0, grey.shape[::-1])
            background[first[1] : int(last[1]), first[0] : int(last[0])] = 0
        if self._lens is None:
            return _Picture(grey, background)
        if self._maps is None:
            k, distortion, size = self._lens.intrinsics, self._lens.distortion, grey.shape[::-1]
            lens = cv2.fisheye if self._lens.lens == "fisheye" else cv2
            self._maps = lens.initUndistortRectifyMap(k, distortion, np.eye(3), k, size, cv2.CV_32FC1)
        x, y = self._maps
        return _Picture(
            np.asarray(cv2.remap(grey, x, y, cv2.INTER_LINEAR), np.uint8),
            np.asarray(cv2.remap(background, x, y, cv2.INTER_NEAREST), np.uint8),
        )

    def _guesses(self, picture: _Picture) -> Iterator[tuple[_Keyframe, FloatArray]]:
        """Yield keyframes with a homography from the frame: by the last motion, then by descriptors.

        The oldest keyframe with enough overlap comes first: it has the least error.
        """
        by_last = [
            (keyframe, np.linalg.inv(keyframe.motion.to_reference) @ self._last.to_reference)
            for keyframe in self._keyframes
        ]
        overlaps = [keyframe.overlap(guess) for keyframe, guess in by_last]
        nearest = int(np.argmax(overlaps))
        first = next((k for k, overlap in enumerate(overlaps) if overlap >= _OVERLAP), nearest)
        yield by_last[first]
        if nearest != first:
            yield by_last[nearest]
        matched = [(keyframe, _matched(keyframe.picture, picture)) for keyframe in self._keyframes]
        best, (guess, count) = max(matched, key=lambda one: one[1][1])
        if guess is not None and count >= _MATCHES:
            yield best, guess

    def _kept(self, picture: _Picture, keyframe: _Keyframe, found: ImageMotion) -> ImageMotion:
        """Return the motion since the first frame, from that since a keyframe."""
        of_keyframe = keyframe.motion
        motion = ImageMotion(
            of_keyframe.to_reference @ found.to_reference,
            of_keyframe.covariance + transported(found.covariance, of_keyframe.to_reference),
        )
        self._last = motion
        if keyframe.overlap(found.to_reference) < _OVERLAP and len(picture.corners) >= _FEWEST:
            self._keyframes.append(_Keyframe(picture, motion))
            del self._keyframes[1 : max(1, len(self._keyframes) - _KEYFRAMES + 1)]
        return motion


def image_motions(
    frames: Iterable[Frame],
    people: Iterable[PersonBox],
    lens: GroundCamera | None,
    refuse: Callable[[str], object],
    reference: int | None = None,
) -> dict[int, ImageMotion | Lost]:
    """Return the motion of each frame since the reference frame.

    Parameters
    ----------
    frames : in order, of one size
    people : their boxes are no background
    lens : as of `CameraFollower`
    refuse : receives frames whose motion is not known
    reference : number of the reference frame; None: the first

    Raises
    ------
    InputError
        If no motion can be followed, or the reference frame's motion is not known.
    """
    boxes, follower = boxes_by_frame(people), CameraFollower(lens)
    found: dict[int, ImageMotion | Lost] = {}
    for frame in frames:
        if frame.image is not None:
            found[frame.number] = follower.step(frame.image, boxes.get(frame.number, ()))
    lost = {number: motion.reason for number, motion in found.items() if isinstance(motion, Lost)}
    if lost and len(lost) == len(found) - 1:
        number, reason = next(iter(lost.items()))
        expected = "a background that can be followed; --homographies or --poses give the camera's motion"
        raise InputError(f"{reason} in frame {number}, and none that is known in any other", expected)
    if reference is not None:
        base = found.get(reference)
        if not isinstance(base, ImageMotion):
            why = f"whose motion is not known ({base.reason})" if base else "that is not in the recording"
            raise InputError(f"--reference-frame {reference}, {why}", "another frame")
        found = {
            number: motion.since(base) if isinstance(motion, ImageMotion) else motion
            for number, motion in found.items()
        }
    for number, reason in lost.items():
        refuse(f"frame {number}: {reason}")
    return found


def _outline(size: tuple[int, int]) -> FloatArray:
    columns, rows = size[0] - 1.0, size[1] - 1.0
    return np.array([[0.0, 0.0], [columns, 0.0], [columns, rows], [0.0, rows]])


def _matched(keyframe: _Picture, picture: _Picture) -> tuple[FloatArray | None, int]:
    """Return the homography from a frame to a keyframe by descriptors, and the number of its matches."""
    (there, first), (here, second) = keyframe.described, picture.described
    if first is None or second is None:
        return None, 0
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(second, first)
    place, corner = here[[pair.queryIdx for pair in pairs]], there[[pair.trainIdx for pair in pairs]]
    found, moves = _common_motion(place, corner)
    return found, int(moves.sum())


def _aligned(keyframe: _Picture, picture: _Picture, guess: FloatArray) -> ImageMotion | Lost:
    """Return the motion of a frame since a keyframe, from a first guess of its homography.

    The frame is warped by the guess, corners are found in it by optical flow, and so on until nothing moves.
    """
    corners, outline = keyframe.corners, _outline(keyframe.size)
    homography = guess if _moved(guess, outline) > _STILL else np.eye(3)
    step, there, moves = np.eye(3), corners, np.zeros(len(corners), bool)
    for _ in range(_ROUNDS):
        visible = np.flatnonzero(picture.shows(apply_homography(np.linalg.inv(homography), corners)))
        if len(visible) < _FEWEST:
            return Lost(f"{len(visible)} corners of a known view, fewer than {_FEWEST}")
        warped = _warped(picture, homography, keyframe)
        flow, status, _ = cv2.calcOpticalFlowPyrLK(
            keyframe.grey,
            warped,
            corners[visible].astype(np.float32),
            np.empty(0, np.float32),
            winSize=(_WINDOW, _WINDOW),
            maxLevel=_LEVELS,
        )
        known = status.ravel() > 0
        place, there = flow[known].astype(float), corners[visible[known]]
        alike = _correlation(warped, place, keyframe.grey, there) > _ALIKE
        place, there = place[alike], there[alike]
        found, moves = _common_motion(place, there)
        if found is None:
            return Lost(f"{len(place)} of {len(visible)} corners found again, without a common motion")
        step = found
        homography = step @ homography
        homography = homography / homography[2, 2]
        if _moved(step, outline) < _STILL:
            break
    share = moves.sum() / len(visible)
    if share < _SHARE or moves.sum() < _FEWEST // 2:
        return Lost(f"a common motion of {100 * share:.0f} % of the background's corners alone")
    second = int(_common_motion(place[~moves], there[~moves])[1].sum())
    if second > _SECOND * moves.sum() and second >= _FEWEST // 2:
        return Lost("two motions of the background, as of a camera that is carried past things (parallax)")
    error = apply_homography(step, place[moves]) - there[moves]
    covariance = _covariance(there[moves], error, keyframe.size)
    uncertain = float(np.sqrt(np.diagonal(spread(covariance, outline), axis1=1, axis2=2).max()))
    if uncertain > _UNCERTAIN * keyframe.size[0]:
        return Lost(f"a motion of the background that is known to {uncertain:.0f} pixels alone")
    return ImageMotion(homography, covariance)


def _moved(homography: FloatArray, points: FloatArray) -> float:
    """Return the largest distance that points (n, 2) move."""
    return float(np.linalg.norm(apply_homography(homography, points) - points, axis=1).max())


def _correlation(first: _Grey, place: FloatArray, second: _Grey, there: FloatArray) -> FloatArray:
    """Return the normalised cross-correlation (n,) of two images about points (n, 2) of each."""
    around = np.arange(-_PATCH, _PATCH + 1)

    def patches(grey: _Grey, points: FloatArray) -> FloatArray:
        highest = np.array(grey.shape[::-1]) - _PATCH - 1
        u, v = points.round().clip(_PATCH, highest).astype(np.int64).T[:, :, None, None]
        found = grey[v + around[:, None], u + around].reshape(len(points), -1).astype(float)
        return found - found.mean(axis=1, keepdims=True)

    a, b = patches(first, place), patches(second, there)
    scale = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
    return np.asarray((a * b).sum(axis=1) / np.maximum(scale, 1.0), float)


def _common_motion(place: FloatArray, there: FloatArray) -> tuple[FloatArray | None, BoolArray]:
    """Return the homography from most places (n, 2) to their corners, and a mask (n,) of those."""
    nothing = None, np.zeros(len(place), bool)
    if len(place) < 4:
        return nothing
    found, moves = cv2.findHomography(place, there, cv2.RANSAC, _REACH)
    if found is None or np.linalg.cond(found) > LARGEST_CONDITION:
        return nothing
    return np.asarray(found, float), np.asarray(moves.ravel() > 0)


def _warped(picture: _Picture, homography: FloatArray, keyframe: _Picture) -> _Grey:
    """Return a frame in the view of a keyframe, with its brightness and contrast."""
    warped = cv2.warpPerspective(picture.grey, homography, keyframe.size)
    rows, columns = (np.arange(0, side, _SAMPLED) for side in keyframe.grey.shape)
    sampled = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    common = picture.shows(apply_homography(np.linalg.inv(homography), sampled.astype(float)))
    common &= keyframe.shows(sampled.astype(float))
    if not common.any():
        return np.asarray(warped, np.uint8)
    u, v = sampled[common].T
    own, other = keyframe.grey[v, u], warped[v, u]
    gain = own.std() / max(float(other.std()), 1.0)
    table = (np.arange(256.0) - other.mean()) * gain + own.mean()
    return np.asarray(cv2.LUT(warped, table.clip(0.0, 255.0).round().astype(np.uint8)), np.uint8)


def _covariance(points: FloatArray, errors: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return the covariance (9, 9) of E by the errors (n, 2) of mapped points (n, 2).

    Errors within a cell of the image count as dependent (the sandwich estimator with clusters).
    """
    columns, rows = size
    to_unit = np.array([[2.0 / columns, 0.0, -1.0], [0.0, 2.0 / columns, -rows / columns], [0.0, 0.0, 1.0]])
    moved = displacement(apply_homography(to_unit, points))
    inverse = np.linalg.pinv(np.einsum("nik,nil->kl", moved, moved), rcond=1e-12, hermitian=True)
    scores = np.einsum("nik,ni->nk", moved, errors * 2.0 / columns)
    cell = (points * _CELLS / size).astype(np.int64) @ np.array([1, _CELLS])
    parts = np.zeros((_CELLS * _CELLS, 9))
    np.add.at(parts, cell, scores)
    occupied = len(np.unique(cell))
    found = inverse @ (parts.T @ parts) @ inverse * occupied / max(occupied - 4, 1)
    found = transported(found, np.linalg.inv(to_unit))
    found[[2, 5], [2, 5]] += _ROUNDING**2
    return found
