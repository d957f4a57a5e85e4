"""Where people may be in a frame of a camera whose ground plane is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from perception.detection.background import Background
from perception.detection.bands import GroundBands
from perception.detection.blocks import (
    ORIENTATIONS,
    TALL,
    WINDOW,
    WindowFilter,
    window_at,
)
from perception.detection.sizes import PersonSizes
from perception.images.pixels import Image

FEATURES = WINDOW[0] * WINDOW[1] * (ORIENTATIONS + 1)
"""Numbers that are kept of a candidate's window."""
_MOST_FOREGROUND = 0.5
"""Share of the frame; where it is more, the camera moved or the light was switched."""


@dataclass(frozen=True)
class SearchParameters:
    """How to look for people on the ground.

    Attributes
    ----------
    most : candidates of a frame
    close : metres to the side and upwards within which candidates are one
    apart : the same, of detections
    inside, outside : what a person and their surroundings are worth as foreground, in scores of the SVM
    """

    most: int = 120
    close: tuple[float, float] = (0.15, 0.25)
    apart: tuple[float, float] = (0.4, 0.6)
    inside: float = 4.0
    outside: float = 2.0


@dataclass(frozen=True, eq=False)
class Candidates:
    """Where people may be in a frame.

    Attributes
    ----------
    foot : (n, 2) pixels of the feet
    height : (n,) pixels
    score : (n,)
    features : (n, `FEATURES`) blocks of the windows
    """

    foot: FloatArray
    height: FloatArray
    score: FloatArray
    features: NDArray[np.float16]

    def __len__(self) -> int:
        return len(self.score)

    def taken(self, places: NDArray[np.int64]) -> Candidates:
        """The candidates at some places."""
        return Candidates(self.foot[places], self.height[places], self.score[places], self.features[places])

    def scored(self, score: FloatArray) -> Candidates:
        """The same with other scores (n,)."""
        return replace(self, score=score)


class GroundSearch:
    """Looks for people where they have the height of a person.

    Parameters
    ----------
    camera : over the ground
    size : columns and rows of the images

    Raises
    ------
    InputError
        If nobody would stand upright in the image, or be as high as 28 pixels.
    """

    def __init__(
        self,
        camera: GroundCamera,
        size: tuple[int, int],
        parameters: SearchParameters = SearchParameters(),
    ) -> None:
        self.size, self.parameters = size, parameters
        self._bands = bands = GroundBands.of(PersonSizes.of(camera, size), size)
        if not bands.bands:
            raise InputError(
                f"images of {size[0]} × {size[1]} pixels in which nobody is upright and large enough",
                "a calibration of this view, or --boxes",
            )
        self._first = first_filter(parameters)
        counts = [len(windows) for windows in bands.windows]
        self._band = np.repeat(np.arange(len(counts)), counts)
        self._window = np.vstack(bands.windows)
        self._foot = np.vstack(bands.foot)
        self._height = TALL / np.repeat([band.scale for band in bands.bands], counts)

    def candidates(self, image: Image, background: Background | None) -> Candidates:
        """The best of a frame, best first; without a background by gradients alone.

        Raises
        ------
        InputError
            If the frame has another size.
        """
        size = (image.shape[1], image.shape[0])
        if size != self.size:
            raise InputError(
                f"a frame of {size[0]} × {size[1]} pixels", f"{self.size[0]} × {self.size[1]} as the first"
            )
        foreground = None if background is None else background.foreground(image)
        if foreground is not None and float(foreground.mean()) > _MOST_FOREGROUND:
            foreground = None
        grids = self._bands.grids(image, foreground)
        score = np.concatenate(
            [
                self._first.scores(grid)[windows[:, 0], windows[:, 1]]
                for grid, windows in zip(grids, self._bands.windows, strict=True)
            ]
        ).astype(float)
        most = self.parameters.most
        best = np.argsort(-score, kind="stable")[: 40 * most]
        kept = best[strongest(self._foot[best], self._height[best], score[best], self.parameters.close, most)]
        features = [window_at(grids[self._band[k]], *self._window[k].tolist()) for k in kept.tolist()]
        return Candidates(
            self._foot[kept],
            self._height[kept],
            score[kept],
            np.array(features, np.float16).reshape(-1, FEATURES),
        )


def first_filter(parameters: SearchParameters = SearchParameters()) -> WindowFilter:
    """OpenCV's people detector, and the foreground in the middle of the window against that around it."""
    svm = WindowFilter.of_opencv()
    across, down = WINDOW
    inside, outside = np.zeros((2, down, across, 1), np.float32)
    inside[2:-2, 2:-2] = 1.0
    outside[[0, -1]], outside[:, [0, -1]] = 1.0, 1.0
    share = parameters.inside * inside / inside.sum() - parameters.outside * outside / outside.sum()
    return WindowFilter(np.concatenate([svm.weight, share], axis=2), svm.bias)


def strongest(
    foot: FloatArray,
    height: FloatArray,
    score: FloatArray,
    apart: tuple[float, float],
    most: int | None = None,
    person: float = 1.7,
) -> NDArray[np.int64]:
    """Which of n are left, best first, when each drops the weaker ones about it.

    Parameters
    ----------
    foot, height, score : (n, 2), (n,) pixels and (n,)
    apart : metres to the side and upwards, half axes of an ellipse in the upright plane at the person
    most : that are left; None: all
    person : metres that a height is
    """
    alive, kept = np.ones(len(score), bool), []
    for k in np.argsort(-score, kind="stable").tolist():
        if alive[k]:
            kept.append(k)
            if len(kept) == most:
                break
            away = (foot - foot[k]) * (person / height[k]) / np.array(apart)
            alive &= np.einsum("nk,nk->n", away, away) >= 1.0
    return np.array(kept, np.int64)


def joined(candidates: Candidates, apart: tuple[float, float], person: float = 1.7) -> Candidates:
    """What is left of candidates whose scores are probabilities, each at the mean of those about it.

    The mean is weighed by the probabilities, so that places between the grid's come out.
    """
    kept = strongest(candidates.foot, candidates.height, candidates.score, apart, person=person)
    foot, height = np.empty((len(kept), 2)), np.empty(len(kept))
    for i, k in enumerate(kept.tolist()):
        away = (
            (candidates.foot - candidates.foot[k]) * (2.0 * person / candidates.height[k]) / np.array(apart)
        )
        weight = np.where(np.einsum("nk,nk->n", away, away) < 1.0, candidates.score, 0.0) + 1e-9 * (
            np.arange(len(candidates)) == k
        )
        foot[i] = weight @ candidates.foot / weight.sum()
        height[i] = np.exp(weight @ np.log(candidates.height) / weight.sum())
    return Candidates(foot, height, candidates.score[kept], candidates.features[kept])
