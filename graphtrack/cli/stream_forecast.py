"""Forecasts in the answers of `graphtrack track -`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from graphtrack.association.packing import pack_tree, unpack_tree
from graphtrack.behaviour.forecast.forecaster import Forecast, Forecaster
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.state import Estimate
from graphtrack.model import Observation
from graphtrack.saved import real, whole

FORECASTS = "forecasts"
"""Name of forecasts among the members of a stream whose states are kept."""

STEP = 0.4
"""Seconds between the times ahead that are told, where the horizon is no shorter."""


def told(forecast: Forecast) -> dict[int, list[dict[str, float]]]:
    """Forecasts of each person: a dictionary for each time ahead."""
    variance = forecast.covariance
    columns = {
        "x": forecast.position[..., 0],
        "y": forecast.position[..., 1],
        "x_std": np.sqrt(variance[..., 0, 0]),
        "y_std": np.sqrt(variance[..., 1, 1]),
        "xy_cov": variance[..., 0, 1],
        "radius_50": forecast.radius_50,
        "radius_90": forecast.radius_90,
    }
    ahead = forecast.ahead.round(9).tolist()
    numbers = np.stack(list(columns.values()), axis=2).tolist()
    return {
        one: [
            {"ahead": h, **dict(zip(columns, row, strict=True))} for h, row in zip(ahead, rows, strict=True)
        ]
        for one, rows in zip(forecast.track_id.tolist(), numbers, strict=True)
    }


class FrameForecasts:
    """Forecasts for rows with identities: they are told when a frame has ended, with the next time.

    Parameters
    ----------
    ahead : (A,) seconds
    """

    def __init__(self, ahead: FloatArray) -> None:
        self._ahead, self._forecaster = ahead, Forecaster()
        self._t, self._frame = -np.inf, 0
        self._seen: dict[int, tuple[float, float, float, float]] = {}

    def state(self) -> dict[str, Any]:
        """Everything needed to go on elsewhere, as JSON-able data; see `from_state`."""
        return pack_tree(
            {
                "forecaster": self._forecaster.state(),
                "t": self._t if np.isfinite(self._t) else None,
                "frame": self._frame,
                "ids": np.array(list(self._seen), np.int64),
                "seen": np.array(list(self._seen.values()), float).reshape(-1, 4),
            }
        )

    @classmethod
    def from_state(cls, ahead: FloatArray, state: Mapping[str, Any]) -> FrameForecasts:
        """Forecasts that go on where `state` was taken, for the same times (A,)."""
        values = unpack_tree(state)
        found = cls(ahead)
        found._forecaster = Forecaster.from_state(values["forecaster"])
        found._t = -np.inf if values["t"] is None else real(values["t"])
        found._frame = whole(values["frame"])
        found._seen = dict(zip(values["ids"].tolist(), map(tuple, values["seen"].tolist()), strict=True))
        return found

    def take(self, track_id: int, observation: Observation, estimate: Estimate) -> list[dict[str, Any]]:
        """Somebody is seen; the forecasts of the frame before, if that has ended. Late rows do not count."""
        t = observation.t
        if estimate.status == "waiting" or t < self._t or t <= self._forecaster.t:
            return []
        rows = self.finish() if t > self._t else []
        self._t, self._frame = t, observation.frame
        x, y = estimate.position.tolist() if observation.position is None else observation.position
        std = np.nan if observation.position_std is None else observation.position_std
        head = np.nan if observation.head is None else observation.head
        if np.isfinite(x) and np.isfinite(y):
            self._seen[track_id] = (x, y, std, head)
        return rows

    def finish(self) -> list[dict[str, Any]]:
        """The forecasts of the frame that has ended, a row for each person; later rows of it do not count."""
        if not self._seen:
            return []
        ids, values = list(self._seen), np.array(list(self._seen.values()))
        self._forecaster.update(self._t, ids, values[:, :2], values[:, 2], values[:, 3])
        self._seen = {}
        found = told(self._forecaster.forecast(self._ahead))
        return [
            {"track_id": one, "frame": self._frame, "t": self._t, "forecast": rows}
            for one, rows in found.items()
        ]
