"""Observations that come late, or again: what is added to the window of an online smoother."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from graphtrack.geometry.angles import wrap
from graphtrack.inference.state import Window
from graphtrack.model import Observation, Step
from graphtrack.model.observation import CHANNELS, seconds_between


def worked_in(window: Window, observation: Observation, place: int, inserted: bool, template: Step) -> Window:
    """The window with one more observation, in a step like ``template`` or in place of one; linked anew."""
    values = dict(window.values)
    steps = list(window.steps[:place])
    if inserted:
        values[template.index] = _between(window, steps[-1], window.steps[place], observation.t)
    else:
        template = replace(window.steps[place], observation=observation)
    for step in (template, *window.steps[place if inserted else place + 1 :]):
        if steps:
            previous = steps[-1].alone()
            dt = seconds_between(previous, step.observation)
            step = replace(step, previous=previous, dt=dt)
        steps.append(step)
    return replace(window, steps=tuple(steps), values=values)


def merged(known: Observation, new: Observation) -> Observation | None:
    """The known observation with the channels that only the new one has; None if there are none."""
    added: dict[str, Any] = {
        name: getattr(new, name)
        for name in CHANNELS
        if getattr(known, name) is None and getattr(new, name) is not None
    }
    if new.inputs.keys() - known.inputs.keys():
        added["inputs"] = {**new.inputs, **known.inputs}
    return replace(known, **added) if added else None


def _between(window: Window, before: Step, after: Step, t: float) -> tuple[float, ...]:
    """Initial state at t, between two steps of the window."""
    start, end = before.observation.t, after.observation.t
    share = (t - start) / (end - start)
    a, b = np.array(window.values[before.index]), np.array(window.values[after.index])
    state = a + share * (b - a)
    state[4:] = wrap(a[4:] + share * wrap(b[4:] - a[4:]))
    return tuple(state.tolist())
