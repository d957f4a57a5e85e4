"""Shape of a person whose box was given: views of the whole window, which need fewer pixels than features."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, grey
from perception.trackers.patches import cut
from perception.trackers.sigma_pi.parameters import CueParameters
from perception.trackers.sigma_pi.windows import activation

_SIDE, _CELLS = 24, 6
"""Pixels of a window's patch and cells along each side."""
_GRAIN = 0.3
"""Root of the mean gradient of a cell (grey levels a pixel) below which a window counts as blank."""


def _pooling() -> NDArray[np.float32]:
    """Shares (cells, pixels) of a side's pixels in its cells: triangles that reach into the next ones."""
    middle = (np.arange(_CELLS) + 0.5) * _SIDE / _CELLS
    apart = np.abs(np.arange(_SIDE) + 0.5 - middle[:, None])
    return np.asarray(np.maximum(1.0 - apart * _CELLS / _SIDE, 0.0) * _CELLS / _SIDE, np.float32)


_POOLING = _pooling()


def descriptors(image: Image, windows: FloatArray) -> NDArray[np.float32]:
    """Gradients by direction and cell (n, 288) of windows (n, 4) of a grey image (h, w).

    Roots of the mean gradients in 6 × 6 cells and 8 directions, less their mean; of length 1, or less where
    a window is nearly blank. The product of two is their correlation, −1…1.
    """
    patches = cut(image, windows, _SIDE).astype(np.float32)
    across, down = np.zeros_like(patches), np.zeros_like(patches)
    across[:, :, 1:-1] = (patches[:, :, 2:] - patches[:, :, :-2]) / 2.0
    down[:, 1:-1] = (patches[:, 2:] - patches[:, :-2]) / 2.0
    half = np.float32(np.sqrt(0.5))
    along = np.stack([across, down, (across + down) * half, (across - down) * half], axis=1)
    turned = np.concatenate([np.maximum(along, 0.0), np.maximum(-along, 0.0)], axis=1)
    held = np.sqrt(_POOLING @ turned @ _POOLING.T).reshape(len(windows), -1)
    held -= held.mean(axis=1, keepdims=True)
    blank = _GRAIN * np.sqrt(held.shape[1])
    return np.asarray(held / np.hypot(np.linalg.norm(held, axis=1, keepdims=True), blank), np.float32)


class ViewCue:
    """What looks as the target did in the box that was given, or in the last views of it.

    A view is remembered only where it is new, and the first is never forgotten: who stands is always
    compared with what was given, so that windows do not creep off (Matthews, Ishikawa & Baker 2004, "The
    template update problem").
    """

    def __init__(self, parameters: CueParameters, image: Image, window: FloatArray) -> None:
        self._parameters = parameters
        self._grey = grey(image)
        aside = np.tile(window, (4, 1))
        aside[:, :2] += 0.5 * window[2:] * np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
        self._first, *others = descriptors(self._grey, np.vstack([window, aside]))
        self._later: deque[NDArray[np.float32]] = deque(maxlen=parameters.memory)
        self._usual = float(np.mean(np.array(others) @ self._first))
        self.frames = 1

    @classmethod
    def of(cls, parameters: CueParameters, image: Image, window: FloatArray) -> ViewCue | None:
        """The cue of a target in a window (4,) of an image (h, w, 3); None where it is too small or blank."""
        if window[2:].min() < parameters.view_least:
            return None
        cue = cls(parameters, image, window)
        return cue if np.linalg.norm(cue._first) ** 2 > 0.5 else None

    def look(self, image: Image) -> None:
        """Take in a frame."""
        self._grey = grey(image)

    def gain(self, windows: FloatArray) -> FloatArray:
        """How alike windows (n, 4) are to any view (n,): 1 as the first one, 0 as what was beside it."""
        known = np.array([self._first, *self._later])
        found = (descriptors(self._grey, windows) @ known.T).max(axis=1)
        most = float(self._first @ self._first)
        return np.asarray(np.clip((found - self._usual) / (most - self._usual), 0.0, 1.0), float)

    def activity(self, windows: FloatArray) -> FloatArray:
        """Activities (n,) of windows (n, 4)."""
        return activation(self.gain(windows), *self._parameters.view_gain)

    def adapt(self, window: FloatArray) -> None:
        """Remember the view in a window (4,), if it is new."""
        self.frames += 1
        if self.gain(window[None])[0] < self._parameters.view_new:
            self._later.append(descriptors(self._grey, window[None])[0])

    def give(self, images: list[Image]) -> None:
        """Images of what is never the target tell nothing here."""

    def focus(self, window: FloatArray | None) -> None:
        """Windows are looked at one by one anyway."""

    def surroundings(self, outside: NDArray[np.bool_]) -> None:
        """What is beside the target was seen in the first frame."""
