"""Every online engine on the same class likelihoods, with the preset ``joint``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from graphtrack.evaluation.reproduce.chen_joint import ANGLES, Scores
from graphtrack.evaluation.reproduce.chen_tables import detail
from graphtrack.evaluation.reproduce.experiment import Progress, Table
from graphtrack.geometry.angles import FloatArray, mean_absolute_error
from graphtrack.inference import track_online
from graphtrack.inference.online import OnlineEngine
from graphtrack.model import Model
from graphtrack.tracks import TrackSet

LAG = 2.0
"""Seconds that the online graphs keep open, as `graphtrack track` does."""

KNOWN = {"chain": "graph, chain", "isam2": "graph, isam2"}
"""Engine → method of the experiment that it is already."""

OTHERS: Mapping[str, tuple[OnlineEngine, float | None]] = {
    "isam2, full history": ("isam2", None),
    "fixed-lag": ("fixed-lag", LAG),
}
"""Name → engine and lag of those that the experiment has only here."""

_PRESET = "joint"


def engine_table(known: Scores, tracks: TrackSet, rng: np.random.Generator, progress: Progress) -> Table:
    """Errors of `KNOWN` and `OTHERS` on people of one source.

    Parameters
    ----------
    known : errors of the experiment's methods on these people
    tracks : the people
    rng : source of the intervals' resampling
    """
    errors: dict[tuple[str, str, str], FloatArray] = {}
    for angle in ANGLES:
        errors["observation", "", angle] = known.errors["observation", "", angle]
        for name, method in KNOWN.items():
            errors[_PRESET, name, angle] = known.errors[_PRESET, method, angle]
    model = Model(_PRESET)
    for name, (engine, lag) in OTHERS.items():
        found = []
        for track in tracks:
            estimate = track_online(track, model, engine=engine, lag=lag)
            found.append(
                [
                    mean_absolute_error(getattr(estimate, angle), getattr(track, f"true_{angle}"))
                    for angle in ANGLES
                ]
            )
            progress(1)
        for angle, of_people in zip(ANGLES, np.degrees(found).T, strict=True):
            errors[_PRESET, name, angle] = of_people
    groups = dict.fromkeys((*KNOWN, *OTHERS), "online")
    table = detail([Scores(known.data, known.people, errors)], groups, rng)
    return replace(table, title="Every online engine, with joint")
