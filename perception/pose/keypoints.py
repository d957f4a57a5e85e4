"""Keypoints in COCO's order: other conventions, and body and head orientation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from graphtrack.geometry.angles import FloatArray, von_mises_log_density, with_outliers
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES
from perception.pose.classes import PoseClasses
from perception.pose.classifier import fit_temperature_and_share, with_neighbours
from perception.storage import ModelCard, Stored

NAMES = (
    "nose",
    "left_eye",
    "right_eye",
    "left_ear",
    "right_ear",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
)
"""Left and right are the person's own."""

N_POINTS = len(NAMES)
FACE = (0, 1, 2, 3, 4)
"""Nose, eyes and ears."""
EARS, SHOULDERS, HIPS, KNEES, ANKLES = (3, 4), (5, 6), (11, 12), (13, 14), (15, 16)
USED = (*FACE, *SHOULDERS, *HIPS)
"""Points that determine body and head orientation."""

_OPENPOSE = (0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10)
_BODY_25 = (0, 16, 15, 18, 17, 5, 2, 6, 3, 7, 4, 12, 9, 13, 10, 14, 11)
_BLAZEPOSE = (0, 2, 5, 7, 8, *range(11, 17), *range(23, 29))
_FIRST = tuple(range(N_POINTS))
BY_NUMBER: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {17: _FIRST, 18: _OPENPOSE, 25: _BODY_25, 26: _FIRST, 33: _BLAZEPOSE, 133: _FIRST, 136: _FIRST}
)
"""Indices of COCO's points in COCO, OpenPose's COCO and BODY_25, Halpe, BlazePose and COCO-WholeBody."""
KNOWN = "17 points (COCO), 18 or 25 (OpenPose), 26 or 136 (Halpe), 33 (MediaPipe) or 133 (COCO-WholeBody)"

Points = tuple[tuple[float, float, float], ...]
"""Columns, rows and confidences of one person's 17 points; confidence 0: missing."""
Joints = tuple[tuple[float, float, float], ...]
"""One person's 17 points in space: x right, y down, z away from the camera, in one unit; NaN: missing."""


def coco_indices(names: Sequence[str]) -> tuple[int, ...] | None:
    """Return indices of COCO's points among named points; None if any but a limb's is missing."""
    plain = [name.lower().replace(" ", "_").replace("-", "_") for name in names]
    indices = tuple(plain.index(name) if name in plain else -1 for name in NAMES)
    return None if any(indices[k] < 0 for k in USED) else indices


def in_coco_order(points: FloatArray, indices: Sequence[int], *, clipped: bool = True) -> FloatArray:
    """Convert points (..., k, 3) of another convention to COCO's (..., 17, 3); missing points are 0.

    Points without a position have confidence 0; confidences are clipped to 0…1 unless disabled.
    """
    chosen = np.where((np.array(indices) >= 0)[:, None], points[..., list(indices), :], 0.0)
    there = np.isfinite(chosen).all(axis=-1) & (chosen[..., 2] > 0.0)
    found = np.where(there[..., None], chosen, 0.0)
    if clipped:
        found[..., 2] = np.clip(found[..., 2], 0.0, 1.0)
    return np.asarray(found, float)


def as_points(values: FloatArray) -> Points:
    """Return one person's points (17, 3) as plain numbers, rounded to 0.01 pixels."""
    return tuple((round(x, 2), round(y, 2), round(c, 4)) for x, y, c in np.asarray(values, float).tolist())


def as_joints(values: FloatArray) -> Joints:
    """Return one person's points (17, 3) in space as plain numbers, rounded to 0.0001."""
    return tuple((round(x, 4), round(y, 4), round(z, 4)) for x, y, z in np.asarray(values, float).tolist())


def mirrored(points: FloatArray, order: NDArray[np.int64] | None = None) -> FloatArray:
    """Return points (..., k, 3) of the mirror image: columns negated, left and right exchanged.

    Parameters
    ----------
    order : (k,) indices of the points; all 17 by default
    """
    names = NAMES if order is None else tuple(NAMES[k] for k in order.tolist())
    swap = {"left": "right", "right": "left"}
    other = [names.index("_".join(swap.get(part, part) for part in name.split("_"))) for name in names]
    return np.asarray(points[..., other, :] * np.array([-1.0, 1.0, 1.0]), float)


def facing(joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return directions of body and head (n,), radians in the image frame, of `Joints` (n, 17, 3).

    The body's is square to the sum of the axes through shoulders and hips, the head's that of the nose and
    square to the axis through the ears, all in the plane square to the trunk. NaN: a point is missing.
    """
    pairs = [joints[:, pair[0]] - joints[:, pair[1]] for pair in (EARS, SHOULDERS, HIPS)]
    middle = [joints[:, pair].mean(axis=1) for pair in (EARS, SHOULDERS, HIPS)]
    up = middle[1] - middle[2]
    up = np.where(np.isfinite(up), up, [0.0, -1.0, 0.0])
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    away = np.array([0.0, 0.0, 1.0]) - up * up[:, 2:]
    right = np.cross(away, up)

    def level(vectors: FloatArray) -> FloatArray:
        """Return the parts (n,) of vectors (n, 3) to the right and away, as complex numbers."""
        return np.asarray((vectors * right).sum(axis=1) + 1j * (vectors * away).sum(axis=1))

    ears, shoulders, hips = (level(pair) for pair in pairs)
    body = shoulders + np.where(np.isfinite(hips), hips, 0.0)
    # A nose to the front is a left ear to the right, a quarter turn on.
    head = ears + 1j * level(joints[:, FACE[0]] - middle[0])
    return np.asarray(np.angle(body)), np.asarray(np.angle(head))


BODY, HEAD = PoseClasses.circle(BODY_CLASSES), PoseClasses.circle(HEAD_CLASSES)
FLOOR = 0.05
"""Uniform share of the likelihood, for network errors that the simulation lacks."""

_FACE = 5
_SURE = 0.95
_UNSEEN = 0.05  # largest confidence of a missing point
_ORDER = np.array(USED)
_KAPPA, _OUTLIERS = 8.0, 0.2
"""Concentration and outlier share of directions in space: of MediaPipe on walkers of Town Centre (σ 21°, 17 %
of bodies turned round)."""


def features(points: FloatArray) -> NDArray[np.float32]:
    """Features (n, 48) of the points (n, 9, 3) of `USED`.

    Positions relative to the mean and the spread of all points, and of the face's points relative to the
    face's, weighted by confidence; confidences; the spreads in pixels and their ratio.
    """
    points = np.asarray(points, float)
    confidence = np.where(points[..., 2] > _UNSEEN, np.minimum(points[..., 2], _SURE), 0.0)
    document, spread = _relative(points, confidence)
    face, of_face = _relative(points[:, :_FACE], confidence[:, :_FACE])
    n = len(points)
    ratio = np.where((spread > 0.0) & (of_face > 0.0), of_face / np.maximum(spread, 1e-6), 0.0)
    found = [
        (document * confidence[..., None]).reshape(n, -1),
        (face * confidence[:, :_FACE, None]).reshape(n, -1),
        confidence,
        (confidence > 0.0).astype(float),
        np.stack([np.log(np.maximum(spread, 1.0)) / 3.0, 3.0 * ratio], axis=1),
    ]
    return np.concatenate(found, axis=1).astype(np.float32)


def _relative(points: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions (n, k, 2) about their weighted mean, in spreads, and the spreads (n,) in pixels."""
    total = np.maximum(weight.sum(axis=1), 1e-9)[:, None]
    middle = (points[..., :2] * weight[..., None]).sum(axis=1) / total
    away = points[..., :2] - middle[:, None]
    spread = np.sqrt(((away**2).sum(axis=2) * weight).sum(axis=1) / total[:, 0])
    # Coincident points, or a single one, have no spread.
    scale = np.maximum(spread, 0.3)
    return np.clip(away / scale[:, None, None], -4.0, 4.0), spread


@dataclass(frozen=True, eq=False)
class Layers:
    """Network with rectified units between the layers.

    Attributes
    ----------
    weights : of each layer (inputs, units)
    biases : of each (units,)
    temperature, share : as in `fit_temperature_and_share`
    """

    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    temperature: float = 1.0
    share: float = 0.0

    def scores(self, points: FloatArray) -> FloatArray:
        """Return log likelihoods (n, classes) before calibration, equivariant to mirroring."""
        classes = len(self.biases[-1])
        of_mirror = (-np.arange(classes)) % classes
        straight, turned = (
            log_softmax(self._forward(features(some)), axis=1) for some in (points, mirrored(points, _ORDER))
        )
        return np.asarray(0.5 * (straight + turned[:, of_mirror]), float)

    def _forward(self, values: NDArray[np.float32]) -> FloatArray:
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weight + bias
            if k < last:
                values = np.maximum(values, 0.0)
        return np.asarray(values, float)

    def calibrated(self, points: FloatArray, labels: NDArray[np.int64]) -> Layers:
        """Return the network with temperature and share fitted to labels (n,) of other people."""
        return Layers(self.weights, self.biases, *fit_temperature_and_share(self.scores(points), labels))

    def log_likelihoods(self, points: FloatArray) -> FloatArray:
        """Return calibrated log likelihoods (n, classes); uniform without any point."""
        scores = self.scores(points)
        p = with_neighbours(np.exp(log_softmax(scores / self.temperature, axis=1)), self.share)
        p = (1.0 - FLOOR) * p + FLOOR / p.shape[1]
        detected = np.any(points[..., 2] > _UNSEEN, axis=1)
        p = np.where(detected[:, None], p / p.sum(axis=1, keepdims=True), 1.0 / p.shape[1])
        return np.asarray(np.log(p), float)


def _with_direction(log_likelihood: FloatArray, classes: PoseClasses, angle: FloatArray) -> FloatArray:
    """Return log likelihoods (n, classes) averaged with those of directions (n,) in space; NaN: not known."""
    known = np.isfinite(angle)
    density = with_outliers(von_mises_log_density(classes.pan, angle[known, None], _KAPPA), _OUTLIERS)
    result = log_likelihood.copy()
    result[known] = log_softmax(0.5 * (log_likelihood[known] + density), axis=1)
    return result


@dataclass(eq=False)
class KeypointPose(Stored):
    """Model of likelihoods of body (8 classes) and head (12) directions, image frame.

    A small network on shoulders, hips, nose, eyes and ears, trained on skeletons in front of random cameras
    (`perception.synthetic.skeletons`); see docs/perception.md.
    """

    kind: ClassVar[str] = "keypoints"

    body: Layers
    head: Layers
    card: ModelCard

    def log_likelihoods(
        self, points: FloatArray, joints: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Log likelihoods of body (n, 8) and head (n, 12) for COCO's points (n, 17, 3).

        Parameters
        ----------
        joints : (n, 17, 3) the points in space, as `Joints`, NaN where not known. They come from the same
            network as the points, with dependent errors, so that the two log likelihoods are averaged.
        """
        used = np.asarray(points, float).reshape(-1, N_POINTS, 3)[:, _ORDER]
        flat = self.body.log_likelihoods(used), self.head.log_likelihoods(used)
        if joints is None:
            return flat
        body, head = map(_with_direction, flat, (BODY, HEAD), facing(np.asarray(joints, float)))
        return body, head

    def parameters(self) -> dict[str, Any]:
        """Calibrations."""
        parts = (("body", self.body), ("head", self.head))
        return {name: {"temperature": part.temperature, "share": part.share} for name, part in parts}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Weights."""
        found: dict[str, NDArray[Any]] = {}
        for name, part in (("body", self.body), ("head", self.head)):
            for k, (weight, bias) in enumerate(zip(part.weights, part.biases, strict=True)):
                found |= {f"{name}_weight_{k}": weight, f"{name}_bias_{k}": bias}
        return found

    @classmethod
    def restored(cls, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Self:
        """Load the model of a file."""
        return cls(_layers("body", card, arrays), _layers("head", card, arrays), card)


def _layers(name: str, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Layers:
    count = sum(key.startswith(f"{name}_weight_") for key in arrays)
    weights, biases = (
        tuple(arrays[f"{name}_{part}_{k}"] for k in range(max(count, 1))) for part in ("weight", "bias")
    )
    given = card.parameters[name]
    return Layers(weights, biases, float(given["temperature"]), float(given["share"]))
