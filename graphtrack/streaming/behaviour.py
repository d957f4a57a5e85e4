"""Groups, attention and forecasts of a stream, reported when a frame has ended."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from graphtrack.association.sensors import BETWEEN_SCANS
from graphtrack.forecasting.forecaster import Forecast, Forecaster
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.state import Estimate
from graphtrack.interaction.attention import OnlineAttention
from graphtrack.interaction.groups import Groups, OnlineGroups
from graphtrack.interaction.people import Numbers, People, Place, numbers_of, people_at
from graphtrack.model import Observation
from graphtrack.saved import Saved
from graphtrack.tracks.time import TIME_TOLERANCE

FRAMES = "frames"
"""Key of `EndedFrames` among the saved members of a stream."""


@dataclass(frozen=True)
class Asked:
    """Selection of groups and attention to add to the estimates in answers.

    Attributes
    ----------
    groups, attention : whether to report them
    places : possible targets of gaze in addition to people
    """

    groups: bool = False
    attention: bool = False
    places: tuple[Place, ...] = ()

    def settings(self) -> dict[str, Any]:
        """Return settings that the answers depend on, as JSON-able data; empty without a selection."""
        found: dict[str, Any] = {}
        if self.groups:
            found["groups"] = True
        if self.attention:
            found["attention"] = [[one.name, one.outline.tolist(), one.radius] for one in self.places]
        return found


class SceneBehaviour(Saved):
    """Estimator of groups and attention of a scene, as columns of the people of each frame."""

    _saved: ClassVar = {"_groups": Saved, "_attention": Saved}

    def __init__(self, asked: Asked) -> None:
        self._asked = asked
        self._groups = OnlineGroups()
        self._attention = OnlineAttention(asked.places) if asked.attention else None

    def after(self, t: float) -> float:
        """Return a time, or a little later one where the last frame with people is at that time."""
        return max(t, self._groups.t + BETWEEN_SCANS)

    def columns(self, people: People) -> dict[int, dict[str, Any]]:
        """Return the columns of each person of a frame, by track id, ascending."""
        found = self._groups.take(people)
        rows: dict[int, dict[str, Any]] = {one: {} for one in found.track_id.tolist()}
        if self._asked.groups:
            rows = dict(zip(rows, _group_columns(found), strict=True))
        if self._attention is not None:
            for one, gaze in self._attention.take(people, found).by_person().items():
                rows[one]["attention"] = [
                    {"kind": kind, "target": target, "probability": p} for kind, target, p in gaze
                ]
        return rows


def _group_columns(found: Groups) -> list[dict[str, Any]]:
    """Return a dictionary for each row: the columns of the table, null where a cell is empty."""
    columns = {name: values.tolist() for name, values in found.columns().items()}
    names = ("group", "kind", "probability", "centre_x", "centre_y")
    return [
        {name: _null(value) for name, value in zip(names, row, strict=True)}
        for row in zip(*(columns[name] for name in names), strict=True)
    ]


def _null(value: Any) -> Any:
    return None if value != value or value == "" else value


STEP = 0.4
"""Default interval of forecasts, seconds, for horizons that are not shorter."""


def by_person(forecast: Forecast) -> dict[int, list[dict[str, float]]]:
    """Return the forecasts of each person: a dictionary for each time ahead."""
    columns = forecast.columns()
    ahead = forecast.ahead.round(9).tolist()
    numbers = np.stack(list(columns.values()), axis=2).tolist()
    return {
        one: [
            {"ahead": h, **dict(zip(columns, row, strict=True))} for h, row in zip(ahead, rows, strict=True)
        ]
        for one, rows in zip(forecast.track_id.tolist(), numbers, strict=True)
    }


class EndedFrames(Saved):
    """Groups, attention and forecasts for rows with identities, reported when a frame has ended.

    A frame ends with the next time. A row out of sequence changes no frame that has ended; it changes people
    of the current frame through their estimates, and no forecast.

    Parameters
    ----------
    behaviour : groups and attention; None: not requested
    forecaster : of the people; None: no forecasts
    ahead : (A,) seconds of the forecasts
    """

    _saved: ClassVar = {
        "_t": float,
        "_frame": int,
        "_is_open": bool,
        "_behaviour": Saved,
        "_forecaster": Saved,
        "_people": dict[int, tuple[float, ...]],
        "_observed": dict[int, tuple[float, ...]],
    }

    def __init__(
        self,
        behaviour: SceneBehaviour | None = None,
        forecaster: Forecaster | None = None,
        ahead: FloatArray = np.empty(0),
    ) -> None:
        self._behaviour, self._forecaster, self._ahead = behaviour, forecaster, ahead
        self._t, self._frame = -math.inf, 0
        self._is_open = False
        self._people: dict[int, Numbers] = {}
        self._observed: dict[int, tuple[float, ...]] = {}

    def take(self, track_id: int, observation: Observation, estimate: Estimate) -> list[dict[str, Any]]:
        """Add a row; return a row for each person of the previous frame, if that has ended."""
        if estimate.status == "waiting":
            return []
        rows: list[dict[str, Any]] = []
        if observation.t > self._t + TIME_TOLERANCE:
            rows = self.finish()
            self._t, self._frame, self._is_open = observation.t, observation.frame, True
        if not self._is_open:
            return rows
        if self._behaviour is not None and abs(estimate.t - self._t) <= TIME_TOLERANCE:
            self._people[track_id] = numbers_of(estimate)
        if self._forecaster is not None and abs(observation.t - self._t) <= TIME_TOLERANCE:
            at = observation.position
            x, y = estimate.position.tolist() if at is None else at
            given = (observation.position_std, observation.head)
            if math.isfinite(x) and math.isfinite(y):
                self._observed[track_id] = (x, y, *(math.nan if one is None else one for one in given))
        return rows

    def finish(self) -> list[dict[str, Any]]:
        """Return the rows of the frame, one for each person, and end it; later rows of it are ignored."""
        behaviour: dict[int, dict[str, Any]] = {}
        ahead: dict[int, list[dict[str, float]]] = {}
        if self._behaviour is not None and self._people:
            behaviour = self._behaviour.columns(people_at(self._t, self._frame, self._people))
        if self._forecaster is not None and self._observed:
            values = np.array(list(self._observed.values()))
            self._forecaster.update(self._t, list(self._observed), values[:, :2], values[:, 2], values[:, 3])
            ahead = by_person(self._forecaster.forecast(self._ahead))
        if self._people or self._observed:
            self._is_open = False
        self._people, self._observed = {}, {}
        of_frame = {"frame": self._frame, "t": self._t}
        known = sorted({*behaviour, *ahead}) if behaviour else ahead
        return [
            {"track_id": one, **of_frame, **behaviour.get(one, {})}
            | ({"forecast": ahead[one]} if one in ahead else {})
            for one in known
        ]
