"""A model's cost about some states, and its derivatives by finite differences."""

from collections.abc import Callable, Sequence

import gtsam
import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.graph.batch import window_graph
from graphtrack.inference.state import Window, values_of
from graphtrack.model import Model, States, Step
from graphtrack.tracks.track import Track


def build_graph(
    steps: Sequence[Step], model: Model, states: States
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The factor graph of a whole track, and states as its values."""
    window = Window(tuple(steps), np.zeros((0, 6)), None, (float(states.body[0]), float(states.head[0])))
    columns = np.column_stack([states.position, states.velocity, states.body, states.head])
    return window_graph(window, model), values_of(steps, columns, model)


def states_of(track: Track) -> States:
    """Estimates of a smoothed track."""
    assert track.velocity is not None
    none = np.full(len(track), np.nan)
    return States(
        track.position,
        track.velocity,
        none if track.body is None else track.body,
        none if track.head is None else track.head,
    )


def moved(states: States, offset: np.ndarray) -> States:
    """The states plus offsets (n, 6) in the order of the covariance."""
    return States(
        states.position + offset[:, :2],
        states.velocity + offset[:, 2:4],
        states.body + offset[:, 4],
        states.head + offset[:, 5],
    )


def free(model: Model) -> list[int]:
    """The columns of the state that a model estimates."""
    return [0, 1, 2, 3] + ([4] if model.has_body else []) + ([5] if model.has_head else [])


def cost_around(
    states: States, track: Track, model: Model, camera: GroundCamera | None = None
) -> Callable[[np.ndarray], float]:
    """Model.cost as a function of one long vector of offsets from the states."""
    columns = free(model)

    def cost(vector: np.ndarray) -> float:
        offset = np.zeros((len(track), 6))
        offset[:, columns] = vector.reshape(len(track), len(columns))
        return model.cost(moved(states, offset), track, camera)

    return cost


def gradient(cost: Callable[[np.ndarray], float], size: int, step: float = 1e-4) -> np.ndarray:
    """The slope (size,) at 0, to the fourth order of the step."""
    units = np.eye(size) * step
    return np.array([(cost(-2 * u) - 8 * cost(-u) + 8 * cost(u) - cost(2 * u)) / (12 * step) for u in units])


def hessian(cost: Callable[[np.ndarray], float], size: int, step: float = 2e-4) -> np.ndarray:
    """The curvature (size, size) at 0, to the second order of the step."""
    units, here = np.eye(size) * step, cost(np.zeros(size))
    # The sum of the cost increases of a step forth and a step back: dᵀ·H·d.
    alone = [cost(a) + cost(-a) - 2.0 * here for a in units]
    found = np.diag(alone)
    for i in range(size):
        for j in range(i):
            d = units[i] + units[j]
            both = cost(d) + cost(-d) - 2.0 * here
            found[i, j] = found[j, i] = 0.5 * (both - alone[i] - alone[j])
    return found / step**2
