"""Keypoints of one person after another, in the crop of the person's box (top-down).

RTMPose and other networks with SimCC outputs (Li et al. 2022) in ONNX files, as MMDeploy exports them:
(1, k, s·columns) and (1, k, s·rows), the scores of columns and rows of k keypoints in steps of 1/s pixels.
MediaPipe's BlazePose, of the package ``mediapipe`` with weights in its wheel, which has points in space too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.detection.boxes import FrameDetections
from perception.detection.onnx_network import OnnxNetwork, ScoreCheck
from perception.images.pixels import Image
from perception.pose.keypoints import BY_NUMBER, KNOWN, N_POINTS, in_coco_order

_MEAN, _DEVIATION = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)
"""Of red, green and blue in ImageNet, by which MMPose normalises images."""


MEDIAPIPE = Path("mediapipe")
"""Name of the package in place of a file of keypoints."""
_INSTALL = (
    "pip install 'graphtrack[mediapipe]', then pip install --no-deps mediapipe==0.10.14: its dependency "
    "opencv-contrib-python would overwrite opencv-python-headless"
)


class PoseOfBox(ABC):
    """Pose network of one person, in the crop of the person's box.

    Attributes
    ----------
    size : columns and rows of the crop
    checked : scores of all images so far
    margin : sides of the crop in sides of the box
    """

    size: tuple[int, int]
    checked: ScoreCheck
    margin: ClassVar[float]

    def detect(self, image: Image, boxes: Sequence[tuple[float, float, float, float]]) -> FrameDetections:
        """Return the keypoints of the people in boxes (n) of an image (h, w, 3) uint8, in their order."""
        n = len(boxes)
        points, joints = np.zeros((n, N_POINTS, 3)), np.full((n, N_POINTS, 3), np.nan)
        for k, box in enumerate(boxes):
            picture, scale, corner = _crop(image, box, self.size, self.margin)
            found = self._points(picture)
            if found is not None:
                points[k], joints[k] = found
                points[k, :, :2] = points[k, :, :2] / scale + corner
                points[k][points[k, :, 2] <= 0.0] = 0.0
        self.checked.add("scores of keypoints", points[..., 2])
        return FrameDetections(np.asarray(boxes, float).reshape(-1, 4), np.ones(n), points, joints)

    @abstractmethod
    def _points(self, picture: Image) -> tuple[FloatArray, FloatArray] | None:
        """Return COCO's points (17, 3) in pixels of a crop, and in space or NaN; None: nobody."""


def _crop(
    image: Image, box: tuple[float, float, float, float], size: tuple[int, int], margin: float
) -> tuple[Image, float, FloatArray]:
    """Return the surroundings of a box, of columns and rows, its scale, and its corner (2,) in the image."""
    left, top, width, height = box
    scale = min(size[0] / (margin * width), size[1] / (margin * height))
    corner = np.array([left + width / 2.0, top + height / 2.0]) - np.array(size) / (2.0 * scale)
    move = scale * np.column_stack([np.eye(2), -corner])
    # Positions are those of pixel edges in boxes, of pixel centres in OpenCV.
    move[:, 2] += 0.5 * scale - 0.5
    return np.asarray(cv2.warpAffine(image, move, size, flags=cv2.INTER_LINEAR), np.uint8), scale, corner


class SimccNetwork(PoseOfBox):
    """Pose network with SimCC outputs.

    Parameters
    ----------
    network : the opened file
    size : columns and rows of the input, if the file leaves them open

    Raises
    ------
    InputError
        If its outputs are not of SimCC, or of unknown keypoints.
    """

    margin = 1.25  # as in the training of RTMPose

    def __init__(self, network: OnnxNetwork, size: tuple[int, int] | None = None) -> None:
        self._network, self.size = network, network.input_size(size)
        self.checked = ScoreCheck(network.path)
        shapes = [values.shape for values in self._run(np.zeros((self.size[1], self.size[0], 3), np.uint8))]
        steps = [shape[-1] / side for shape, side in zip(shapes, self.size, strict=True)]
        if shapes[0][:2] != shapes[1][:2] or shapes[0][0] != 1 or steps[0] != steps[1] or steps[0] < 1.0:
            of_input = f"for an input of {self.size[0]} × {self.size[1]}"
            found = f"outputs of shapes {shapes[0]} and {shapes[1]} {of_input}"
            expected = "YOLO-pose's (1, 56, cells), or SimCC's (1, 17, s·columns) and (1, 17, s·rows)"
            raise InputError(found, expected, path=network.path)
        if shapes[0][1] not in BY_NUMBER:
            raise InputError(f"a network of {shapes[0][1]} keypoints", KNOWN, path=network.path)
        self._order, self._steps = BY_NUMBER[shapes[0][1]], steps[0]

    @staticmethod
    def fits(network: OnnxNetwork) -> bool:
        """Return True for two outputs of three dimensions."""
        return network.ranks == [3, 3]

    def _run(self, picture: Image) -> list[NDArray[np.float32]]:
        values = (picture[..., ::-1].astype(np.float32) - _MEAN) / _DEVIATION
        return self._network.run(np.ascontiguousarray(values.transpose(2, 0, 1)[None], np.float32))

    def _points(self, picture: Image) -> tuple[FloatArray, FloatArray]:
        columns, rows = (np.asarray(values[0], float) for values in self._run(picture))
        places = np.stack([columns.argmax(axis=1), rows.argmax(axis=1)], axis=1) / self._steps + 0.5
        scores = np.minimum(columns.max(axis=1), rows.max(axis=1))
        points = in_coco_order(np.column_stack([places, scores]), self._order)
        return points, np.full((N_POINTS, 3), np.nan)


class MediaPipePose(PoseOfBox):
    """BlazePose of the package ``mediapipe``."""

    margin = 2.0  # it searches the crop for a person again: at 1.25 it finds half as many
    size = (256, 256)

    def __init__(self) -> None:
        self.checked = ScoreCheck(str(MEDIAPIPE))
        try:
            solutions = import_module("mediapipe").solutions
        except (ImportError, AttributeError) as error:
            raise InputError("no package mediapipe with weights in it", _INSTALL) from error
        self._pose: Any = solutions.pose.Pose(static_image_mode=True, model_complexity=1)

    def _points(self, picture: Image) -> tuple[FloatArray, FloatArray] | None:
        found = self._pose.process(np.ascontiguousarray(picture[..., ::-1]))
        if found.pose_landmarks is None:
            return None
        flat, space = (
            np.array([(one.x, one.y, one.z, one.visibility) for one in of_image.landmark])
            for of_image in (found.pose_landmarks, found.pose_world_landmarks)
        )
        order = BY_NUMBER[len(flat)]
        return in_coco_order(flat[:, [0, 1, 3]] * [*self.size, 1.0], order), space[list(order), :3]
