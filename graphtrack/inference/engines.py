"""Choice of the engine that interprets a model, offline and online."""

from __future__ import annotations

import math
from typing import Literal

from graphtrack.errors import InputError
from graphtrack.inference.chain.batch import is_chain
from graphtrack.inference.result import OfflineEngine
from graphtrack.model import Model
from graphtrack.tracks.validation import is_number

OnlineEngine = Literal["auto", "chain", "fixed-lag", "isam2"]
ENGINES: tuple[OnlineEngine, ...] = ("auto", "chain", "fixed-lag", "isam2")


def engine_of(model: Model, engine: str = "auto") -> OfflineEngine:
    """Return the requested engine, or for "auto" "chain" wherever that is possible.

    Raises
    ------
    InputError
        For an engine that is not offline, or the chain with a term that has no compiled kernel.
    """
    if engine in ("isam2", "fixed-lag"):
        raise InputError(
            f"engine {engine!r}, which is online, for offline smoothing",
            "gtsam, or graphtrack track with --engine isam2 --lag none",
        )
    if engine not in ("auto", "chain", "gtsam"):
        raise InputError(f"engine {engine!r}", "auto, chain or gtsam")
    if engine == "gtsam" or (engine == "auto" and not is_chain(model)):
        return "gtsam"
    for term in model.terms:
        if not term.is_compiled:
            raise InputError(
                f"engine 'chain' and the term {type(term).__name__}, which has no compiled kernel",
                "engine 'auto' or 'gtsam'",
            )
    return "chain"


def online_engine(model: Model, engine: OnlineEngine = "auto") -> OnlineEngine:
    """Return the requested online engine, or for "auto" "chain" where possible; errors as `engine_of`."""
    if engine not in ENGINES:
        raise InputError(f"engine {engine!r}", f"one of {', '.join(ENGINES)}")
    if engine == "auto":
        engine = "chain" if is_chain(model) else "isam2"
    if engine == "chain":
        engine_of(model, "chain")
    return engine


def check_lag(lag: float | None, engine: OnlineEngine) -> None:
    """Raise InputError for an invalid window length (seconds), or none where the engine needs one."""
    if lag is None and engine != "isam2":
        raise InputError(f"no lag with the engine {engine}", "seconds; the full history is for isam2")
    if lag is not None and not (is_number(lag) and math.isfinite(lag) and lag > 0.0):
        raise InputError(f"lag = {lag!r}", "a positive number of seconds")
