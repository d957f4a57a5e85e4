"""Compiled code of the online engine, as it comes from the cache."""

from __future__ import annotations

import subprocess
import sys

from graphtrack.inference.online import Engine
from graphtrack.inference.warm import SOLVER, online_rehearsal
from graphtrack.model import Model
from graphtrack.readiness import is_cold, make_ready


def warm_up(model: Model, engine: Engine) -> None:
    """Load what the chain engine runs; what was never compiled on this machine is compiled first.

    Compiling is left to a process of its own: code as it is compiled and the same code from the cache round
    differently, and a run that is gone on with must round as the run before.
    """
    if engine != "chain":
        return
    if any(map(is_cold, online_rehearsal(model).called)):
        preset = "full" if model.has_modes else "joint"
        code = f"from {__name__} import load; load({preset!r})"
        subprocess.run([sys.executable, "-c", code], stdin=subprocess.DEVNULL, check=False)
    load(model)


def load(model: Model | str) -> None:
    """Have the compiled window's code in this process; compile what there is none of."""
    make_ready(SOLVER, online_rehearsal(Model.named(model)))
