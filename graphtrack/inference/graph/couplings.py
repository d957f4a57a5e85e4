"""What the modes of the couplings set, as the factors of GTSAM's engines read it."""

from __future__ import annotations

import numpy as np

from graphtrack.model.factors.derived import COUPLED


def couplings_of(records: np.ndarray) -> list[tuple[float, ...]]:
    """The `COUPLED` fields of packed frames, a row for each.

    A step that nothing steers is one of white-noise acceleration, for which the chain has another kernel;
    here it has the same moments.
    """
    rows = np.stack([records[name] for name in COUPLED], axis=1)
    unsteered = (rows[:, COUPLED.index("steer_gain")] == 0.0) & (records["motion_information"] > 0.0)
    if unsteered.any():
        dt, information = records["dt"][unsteered], records["motion_information"][unsteered]
        moments = (dt, 12.0 * information / dt**3, -6.0 * information / dt**2, 4.0 * information / dt)
        for name, values in zip(COUPLED[-4:], moments, strict=True):
            rows[unsteered, COUPLED.index(name)] = values
    return list(map(tuple, rows.tolist()))
