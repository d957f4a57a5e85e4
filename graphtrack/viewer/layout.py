"""Layout of the window: the ground, the video and the series of one person."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.viewer.people import GROUND, SERIES
from graphtrack.viewer.recording import TIME, rerun

VIDEO: Final = "video"

_PLOTS = {
    "x white, y pink (m)": ("x", "y"),
    "speed (m/s)": ("speed",),
    "body blue, head orange (°)": ("body", "head"),
}
_MARGIN = 1.0
"""Metres."""


@dataclass(frozen=True)
class Extent:
    """Rectangle on the ground: lower and upper corner (2,), metres."""

    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, position: FloatArray, radius: FloatArray | float = 0.0) -> Extent:
        """Return the extent of the finite positions (n, 2), or of circles around them, with a margin.

        Parameters
        ----------
        position : metres
        radius : (n,) or one for all, metres
        """
        around = np.broadcast_to(radius, len(position))[:, None]
        there = np.column_stack([position - around, position + around])
        there = there[np.isfinite(there).all(axis=1)]
        if not len(there):
            there = np.zeros((1, 4))
        return cls(there[:, :2].min(axis=0) - _MARGIN, there[:, 2:].max(axis=0) + _MARGIN)

    @property
    def size(self) -> float:
        """Longer side, metres."""
        return float(np.max(self.high - self.low))

    def around(self, other: Extent, room: float) -> Extent:
        """Return the union enlarged by this factor if the other exceeds this extent; else this extent."""
        if (other.low >= self.low).all() and (other.high <= self.high).all():
            return self
        low, high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        return Extent(low - room * (high - low), high + room * (high - low))


def circles_of(forecasts: Mapping[str, NDArray[np.generic]]) -> Extent:
    """Return the extent of the forecasts' circles; columns as of `viewer.interaction.show_forecasts`."""
    there = np.column_stack([forecasts["x"], forecasts["y"]]).astype(float)
    return Extent.of(there, forecasts["radius_90"].astype(float))


def layout(
    extent: Extent,
    person: int | None,
    *,
    series: Collection[str] = ("x", "y", "speed", "body", "head"),
    video: bool = False,
    live: bool = False,
) -> Any:
    """Return the blueprint of the window.

    Parameters
    ----------
    extent : visible extent of the ground
    person : person whose time series are drawn; None: none
    series : known series
    video : True if there are pictures or boxes
    live : True if the view follows the newest time
    """
    views = rerun().blueprint
    (left, bottom), (right, top) = extent.low.tolist(), extent.high.tolist()
    ground = views.Spatial2DView(
        name="Ground (m)",
        origin="/",
        contents=f"/{GROUND}/**",
        visual_bounds=views.VisualBounds2D(x_range=[left, right], y_range=[-top, -bottom]),
    )
    video_views = [views.Spatial2DView(name="Video", origin=f"/{VIDEO}")] if video else []
    if person is not None:
        for name, lines in _PLOTS.items():
            known = [f"/{SERIES}/{person}/{line}" for line in lines if line in series]
            if known:
                video_views.append(
                    views.TimeSeriesView(
                        name=f"Person {person}: {name}",
                        origin=f"/{SERIES}/{person}",
                        contents=known,
                        plot_legend=views.PlotLegend(visible=False),
                    )
                )
    shares = [2.0 if k == 0 and video else 1.0 for k in range(len(video_views))]
    parts = [ground, views.Vertical(*video_views, row_shares=shares)] if video_views else [ground]
    panel = views.TimePanel(state="collapsed", timeline=TIME, play_state="following" if live else None)
    return views.Blueprint(
        views.Horizontal(*parts, column_shares=[3.0, 2.0][: len(parts)]),
        views.BlueprintPanel(state="collapsed"),
        views.SelectionPanel(state="collapsed"),
        panel,
        auto_layout=False,
        auto_views=False,
    )
