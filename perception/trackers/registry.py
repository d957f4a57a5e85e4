"""Registry of trackers by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from perception.images.pixels import Image
from perception.trackers.color import ColourParameters, ColourTracker
from perception.trackers.cue_graph import CueGraphParameters, CueGraphTracker
from perception.trackers.head_graph import HeadGraphParameters, HeadGraphTracker
from perception.trackers.mixed_state import MixedStateParameters, MixedStateTracker
from perception.trackers.sigma_pi import SigmaPiTracker
from perception.trackers.sigma_pi_network import SigmaPiParameters
from perception.trackers.tracker import Tracker

_KINDS: dict[str, tuple[Any, Any]] = {
    "mixed-state": (MixedStateTracker, MixedStateParameters),
    "sigma-pi": (SigmaPiTracker, SigmaPiParameters),
    "cue-graph": (CueGraphTracker, CueGraphParameters),
    "head-graph": (HeadGraphTracker, HeadGraphParameters),
    "color": (ColourTracker, ColourParameters),
}
TRACKERS = tuple(_KINDS)
OF_HEADS = ("mixed-state", "head-graph")
"""Trackers of a head's box."""
WITH_BACKGROUND = ("sigma-pi", "cue-graph")
"""Trackers of a person, which take background images and need no first box."""
IN_THE_GRAPH = {"cue-graph": "sigma-pi", "head-graph": "mixed-state"}
"""Trackers without particles → the published form, with particles."""


def parameters_of(name: str, *, as_in_the_paper: bool = False) -> Any:
    """Return the default or the published parameters of a tracker.

    Raises
    ------
    InputError
        If there is no tracker of that name, or it has no published form.
    """
    if name not in _KINDS:
        raise InputError(f"tracker {name!r}", f"one of {', '.join(TRACKERS)}")
    if as_in_the_paper and name in IN_THE_GRAPH:
        raise InputError(
            f"{name} as in the paper", f"{IN_THE_GRAPH[name]}, the published form with particles"
        )
    kind = _KINDS[name][1]
    return kind.of_the_paper() if as_in_the_paper else kind()


def make_tracker(
    name: str,
    particles: int | None = None,
    seed: int | np.random.Generator = 0,
    parameters: Any = None,
    *,
    background: Sequence[Image] = (),
    rate: float = 25.0,
) -> Tracker:
    """Create a tracker.

    Parameters
    ----------
    particles : overrides the number in the parameters
    parameters : of that tracker; by default `parameters_of`
    background : images without the target, for the trackers of `WITH_BACKGROUND`
    rate : frames a second, for the trackers of `IN_THE_GRAPH`

    Raises
    ------
    InputError
        For an unknown name, a tracker that takes no background or no particles, or less than two particles.
    """
    parameters = parameters_of(name) if parameters is None else parameters
    if particles is not None and particles < 2:
        raise InputError(f"{particles} particles", "at least 2")
    if background and name not in WITH_BACKGROUND:
        raise InputError(f"images of the background for {name}", f"{', '.join(WITH_BACKGROUND)}, or none")
    options: dict[str, Any] = {"background": background} if background else {}
    if name in IN_THE_GRAPH:
        if particles is not None:
            raise InputError(f"{particles} particles for {name}", "none")
        options["rate"] = rate
    else:
        options |= {"particles": particles, "seed": seed}
    tracker: Tracker = _KINDS[name][0](parameters, **options)
    return tracker
