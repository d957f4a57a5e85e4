"""Every engine on the same class likelihoods, with the preset ``joint``."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from graphtrack.evaluation.reproduce.chen_tables import ANGLES, Methods, Scores, detail, estimated_errors
from graphtrack.evaluation.reproduce.experiment import Progress, Table
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference import smooth_track
from graphtrack.model import Model
from graphtrack.smoothing.recording import track_online
from graphtrack.tracks import TrackSet

LAG = 2.0
"""Seconds that the online graphs keep open, as `graphtrack track` does."""

KNOWN = {"chain": "graph, chain", "isam2": "graph, isam2", "chain, offline": "smoother"}
"""Engine → method of the experiment that it is already."""

OTHERS: Methods = {
    "isam2, full history": ("online", partial(track_online, engine="isam2", lag=None)),
    "fixed-lag": ("online", partial(track_online, engine="fixed-lag", lag=LAG)),
    "gtsam, offline": ("offline", lambda track, model: smooth_track(track, model, engine="gtsam").track),
}
"""Those that the experiment has only here."""

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
    models = {(_PRESET, name): Model(_PRESET) for name in OTHERS}
    errors |= estimated_errors(tracks, OTHERS, models, progress)
    groups = {name: "offline" if name.endswith("offline") else "online" for name in (*KNOWN, *OTHERS)}
    table = detail([Scores(known.data, known.people, errors)], groups, rng)
    return replace(table, title="Every engine, with joint")
