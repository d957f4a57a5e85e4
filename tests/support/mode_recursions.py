"""The recursions over coupling modes, called as the solver calls them, on evidence of one's own."""

from __future__ import annotations

import numpy as np

from graphtrack.model.coupling_modes import Following, ModeMemory, filter_modes, mode_memory, smooth_modes
from graphtrack.model.terms.couplings import BASE, BINS, Modes


def forward(
    dt: np.ndarray, logs: np.ndarray, modes: Modes, before: np.ndarray
) -> tuple[np.ndarray, ModeMemory]:
    """Filtered probabilities (n, ROW), not normalised, of log likelihoods (n, BASE) of the offsets."""
    memory = mode_memory(len(dt))
    memory.dt[:], memory.likelihood[:, :BASE] = dt, logs
    filter_modes(len(dt), modes, before, memory.filtered_body, memory)
    return memory.filtered_body, memory


def both_ways(
    dt: np.ndarray, logs: np.ndarray, modes: Modes, before: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Filtered and smoothed probabilities (n, ROW)."""
    filtered, memory = forward(dt, logs, modes, before)
    memory.after[:] = 0.0
    following, smoothed = Following(0.0, 1.0, 0.0, 1.0, 0.0), np.empty_like(filtered)
    for k in range(len(dt) - 1, -1, -1):
        sums, following = smooth_modes(k, modes, filtered, following, memory)
        smoothed[k] = memory.weight[0] / memory.weight[0].sum()
        glances = smoothed[k, BASE:]
        assert np.isclose(sums.own + sums.mistaken + sums.near + glances.sum(), 1.0)
        assert np.isclose(sums.glance_sin, glances @ modes.sin[:BINS])
    return filtered / filtered.sum(axis=1, keepdims=True), smoothed
