"""The trackers by name; each is imported when it is asked for."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from perception.trackers.tracker import Tracker

_HOMES = {
    "mixed-state": ("perception.trackers.mixed_state.tracker", "MixedStateTracker", "MixedStateParameters"),
    "sigma-pi": ("perception.trackers.sigma_pi.tracker", "SigmaPiTracker", "SigmaPiParameters"),
    "color": ("perception.trackers.color", "ColourTracker", "ColourParameters"),
}
TRACKERS = tuple(_HOMES)
OF_HEADS = ("mixed-state",)
"""Trackers whose box is that of a head."""


def make_tracker(
    name: str, particles: int | None = None, seed: int | np.random.Generator = 0, parameters: Any = None
) -> Tracker:
    """A new tracker.

    Parameters
    ----------
    particles : number of them; by default what the tracker has
    parameters : of that tracker, if not its defaults

    Raises
    ------
    InputError
        If there is none of that name, or less than two particles are asked for.
    """
    if name not in _HOMES:
        raise InputError(f"tracker {name!r}", f"one of {', '.join(TRACKERS)}")
    if particles is not None and particles < 2:
        raise InputError(f"{particles} particles", "at least 2")
    module, kind, settings = _HOMES[name]
    home = import_module(module)
    if parameters is None:
        parameters = getattr(home, settings)()
    if particles is not None:
        parameters = replace(parameters, particles=particles)
    tracker: Tracker = getattr(home, kind)(parameters, seed=seed)
    return tracker
