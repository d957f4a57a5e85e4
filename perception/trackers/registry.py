"""The trackers by name; each is imported when it is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from perception.images.pixels import Image
from perception.trackers.tracker import Tracker

_HOMES = {
    "mixed-state": ("perception.trackers.mixed_state.tracker", "MixedStateTracker", "MixedStateParameters"),
    "sigma-pi": ("perception.trackers.sigma_pi.tracker", "SigmaPiTracker", "SigmaPiParameters"),
    "color": ("perception.trackers.color", "ColourTracker", "ColourParameters"),
}
TRACKERS = tuple(_HOMES)
OF_HEADS = ("mixed-state",)
"""Trackers whose box is that of a head."""
WITH_BACKGROUND = ("sigma-pi",)
"""Trackers that take images of what is never the target."""


def parameters_of(name: str, *, as_in_the_paper: bool = False) -> Any:
    """The parameters of a tracker: its defaults, or those that its paper has.

    Raises
    ------
    InputError
        If there is no tracker of that name.
    """
    if name not in _HOMES:
        raise InputError(f"tracker {name!r}", f"one of {', '.join(TRACKERS)}")
    module, _, settings = _HOMES[name]
    kind = getattr(import_module(module), settings)
    return kind.of_the_paper() if as_in_the_paper else kind()


def make_tracker(
    name: str,
    particles: int | None = None,
    seed: int | np.random.Generator = 0,
    parameters: Any = None,
    *,
    background: Sequence[Image] = (),
) -> Tracker:
    """A new tracker.

    Parameters
    ----------
    particles : number of them; by default what the tracker has
    parameters : of that tracker, if not its defaults; see `parameters_of`
    background : images of what is never the target, for those of `WITH_BACKGROUND`

    Raises
    ------
    InputError
        If there is none of that name, it takes no background, or less than two particles are asked for.
    """
    if parameters is None:
        parameters = parameters_of(name)
    if particles is not None and particles < 2:
        raise InputError(f"{particles} particles", "at least 2")
    if background and name not in WITH_BACKGROUND:
        raise InputError(f"images of the background for {name}", f"{', '.join(WITH_BACKGROUND)}, or none")
    module, kind, _ = _HOMES[name]
    if particles is not None:
        parameters = replace(parameters, particles=particles)
    options = {"background": background} if background else {}
    tracker: Tracker = getattr(import_module(module), kind)(parameters, seed=seed, **options)
    return tracker
