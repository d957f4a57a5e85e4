"""Machine code of online groups, attention and forecasts before it is needed."""

from __future__ import annotations

import numpy as np

from graphtrack.behaviour.forecast.forecaster import Forecaster
from graphtrack.behaviour.online_attention import OnlineAttention
from graphtrack.behaviour.online_groups import OnlineGroups
from graphtrack.behaviour.people import People
from graphtrack.behaviour.places import Place
from graphtrack.readiness import Rehearsal, make_ready

ONLINE, FORECASTS = "groups and looks", "forecasts"
"""What is compiled here, in words."""


def online_rehearsal() -> Rehearsal:
    """What online groups and attention call."""
    return Rehearsal("groups and looks", _rehearse, 12.0)


def make_behaviour_ready() -> None:
    """Compile or load what groups and attention call; the log reports a long wait before and after."""
    make_ready(ONLINE, online_rehearsal())


def forecast_rehearsal() -> Rehearsal:
    """What forecasts call."""
    return Rehearsal("forecasts", _rehearse_forecast, 1.0)


def _rehearse() -> None:
    groups = OnlineGroups()
    attention = OnlineAttention([Place("made up", np.array([[0.0, 5.0]]), 0.5)])
    for k in range(2):
        aside = np.array([[0.0, 0.0], [1.0, 0.0]])
        ahead = np.array([[0.9, 0.1], [-0.9, 0.1]])
        rows, one = np.arange(2), np.array([k])
        people = People(rows, one, 1.0 * one, np.array([0, 2]), rows, aside, 0.0 * aside, ahead, ahead)
        attention.take(people, groups.take(people))


def _rehearse_forecast() -> None:
    forecaster = Forecaster()
    for k in range(3):
        forecaster.update(0.4 * k, [0, 1], [(0.5 * k, 0.0), (0.5 * k, 1.0)])
    forecaster.forecast([0.4])
