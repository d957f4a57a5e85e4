"""Loss of the Sigma-Pi tracker's target, and its re-detection among the moving regions.

Colour and shape adapt to furniture that a window slips to, and motion remains where somebody has left, so
their activities stay high. The colours that the window had while its pixels changed adapt to neither.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.trackers.sigma_pi_cues import ColourCue, averaged
from perception.trackers.tracker import states_of

_CONFIRMED = 5
"""Consecutive frames in which a region is more similar to the target than the window."""


class Redetection:
    """Search for a lost target.

    While the window is at rest, the moving region with the most similar colours is followed; the target is
    re-detected there when it was more similar than the window in five frames.
    """

    def __init__(self) -> None:
        self.colours: FloatArray | None = None
        """Histogram (COUNT,) of the window in frames in which it moved."""
        self._frames = self._count = 0
        self._region: FloatArray | None = None

    def learn(self, colours: FloatArray) -> None:
        """Adapt to the histogram (COUNT,) of a window that moves."""
        self._frames += 1
        self.colours = averaged(self.colours, colours, self._frames)

    def reset(self) -> None:
        """Discard the followed region."""
        self._region, self._count = None, 0

    def search(
        self, window: FloatArray, regions: FloatArray, colour: ColourCue, margin: float
    ) -> FloatArray | None:
        """Return the region (4,) where the target is re-detected in this frame, or None.

        Parameters
        ----------
        window : (4,) at rest
        regions : (n, 4) possible regions
        margin : by which the Bhattacharyya coefficient of a region must exceed that of the window
        """
        if self.colours is None:
            return None
        likeness = [np.sqrt(colour.histogram(one) * self.colours).sum() for one in (window, *regions)]
        better = np.array(likeness[1:]) > likeness[0] + margin
        if self._region is not None and (followed := better & _near(self._region, regions)).any():
            better = followed
        else:
            self.reset()
        if not better.any():
            return None
        self._count += 1
        self._region = region = regions[np.where(better, likeness[1:], -np.inf).argmax()]
        if self._count < _CONFIRMED:
            return None
        self.reset()
        return np.asarray(region)


def _near(region: FloatArray, regions: FloatArray) -> NDArray[np.bool_]:
    """Mask those regions (n, 4) whose middle is within half a region (4,), or 4 pixels, of its middle."""
    apart = np.abs(states_of(regions)[:, :2] - states_of(region[None])[:, :2])
    return np.asarray((apart <= np.maximum(region[2:], 8.0) / 2.0).all(axis=1))
