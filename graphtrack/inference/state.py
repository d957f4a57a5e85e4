"""The state of an online smoother: its estimate, its window, and both as JSON-able data."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from graphtrack.angles import FloatArray
from graphtrack.errors import InputError
from graphtrack.geometry import GroundCamera
from graphtrack.inference.marginal import MarginalPrior
from graphtrack.model import Observation, Step

STATE_VERSION = 1

Status = Literal["new", "late", "duplicate", "too-late", "waiting", "failed"]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known after an observation, at the latest time seen so far.

    Attributes
    ----------
    t, frame : the time of the estimate (seconds) and its frame
    position : (2,) metres; velocity : (2,) m/s; NaN while waiting for a first position
    body, head : radians; NaN when the model does not estimate them
    covariance : (6, 6) in the order of `graphtrack.tracks.STATE`
    status : what became of the observation. "new": it came in order. "late": it came out of order but
        within the window, and was worked in. "duplicate": its time was known and it had nothing new, so it
        was left out. "too-late": it was older than the window and left out. "waiting": no position has been
        seen yet, so it was left out. "failed": it could not be used; the state is the one before it.
    reason : why it failed
    """

    t: float
    frame: int
    position: FloatArray
    velocity: FloatArray
    body: float
    head: float
    covariance: FloatArray
    status: Status
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Window:
    """What a smoother is built again from.

    Attributes
    ----------
    steps : the steps whose variables are still open, oldest first
    values : index of a step → linearisation point x, y, vx, vy, body, head (metres, m/s, radians)
    prior : what remains of the steps before; None if there were none
    """

    steps: tuple[Step, ...]
    values: dict[int, tuple[float, ...]]
    prior: MarginalPrior | None


def pack_state(window: Window, last: Estimate | None, next_index: int) -> dict[str, Any]:
    """A window and the last estimate as JSON-able data; NaN becomes null."""
    prior = window.prior
    return {
        "version": STATE_VERSION,
        "next_index": next_index,
        "steps": [
            {
                "index": step.index,
                "starts": step.starts,
                "dt": step.dt,
                "values": _nulls(window.values[step.index]),
                "observation": {k: v for k, v in asdict(step.observation).items() if v is not None},
            }
            for step in window.steps
        ],
        "prior": None
        if prior is None
        else {
            "keys": list(prior.keys),
            "point": [list(point) for point in prior.point],
            "information": prior.information.tolist(),
            "linear": prior.linear.tolist(),
            "constant": prior.constant,
        },
        "last": None
        if last is None
        else {
            "t": last.t,
            "frame": last.frame,
            "state": _nulls((*last.position, *last.velocity, last.body, last.head)),
            "covariance": [_nulls(row) for row in last.covariance],
        },
    }


def unpack_state(state: dict[str, Any], camera: GroundCamera | None) -> tuple[Window, Estimate | None, int]:
    """The inverse of `pack_state`.

    Raises
    ------
    InputError
        If the data are not what `pack_state` makes.
    """
    if not isinstance(state, dict) or state.get("version") != STATE_VERSION:
        raise InputError("a state of another version", f"version {STATE_VERSION}")
    try:
        steps: list[Step] = []
        values = {}
        for entry in state["steps"]:
            seen = entry["observation"].items()
            channels: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in seen}
            previous = steps[-1] if steps else None
            observation = Observation(**channels)
            steps.append(Step(entry["index"], observation, previous, entry["dt"], entry["starts"], camera))
            values[entry["index"]] = tuple(_nans(entry["values"]).tolist())
        prior = None
        if state["prior"] is not None:
            saved = state["prior"]
            prior = MarginalPrior(
                tuple(saved["keys"]),
                tuple(tuple(point) for point in saved["point"]),
                np.array(saved["information"], dtype=float),
                np.array(saved["linear"], dtype=float),
                float(saved["constant"]),
            )
        last = None
        if state["last"] is not None:
            saved = state["last"]
            x = _nans(saved["state"])
            covariance = np.array([_nans(row) for row in saved["covariance"]])
            last = Estimate(
                saved["t"], saved["frame"], x[:2], x[2:4], float(x[4]), float(x[5]), covariance, "new"
            )
        return Window(tuple(steps), values, prior), last, int(state["next_index"])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(f"a damaged state ({error!r})", "what a smoother saved") from error


def _nulls(numbers: Any) -> list[float | None]:
    return [None if math.isnan(x) else float(x) for x in numbers]


def _nans(numbers: list[float | None]) -> FloatArray:
    return np.array([math.nan if x is None else x for x in numbers], dtype=float)
