"""The Sigma-Pi network of Yan, Weber & Wermter (2011): cues, their products, and how reliable each is."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import FloatArray

CUES = ("motion", "colour", "shape")
TERMS: tuple[tuple[int, ...], ...] = ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2))
"""Cues of each of the seven terms of eq. 4: three linear, three quadratic, one cubic."""
TERM_NAMES = tuple("·".join(CUES[c] for c in term) for term in TERMS)


def products(activities: FloatArray) -> FloatArray:
    """The seven terms (..., 7) of activities (..., 3) in 0…1."""
    columns = [activities[..., list(term)].prod(axis=-1) for term in TERMS]
    return np.stack(columns, axis=-1)


def output(activities: FloatArray, reliabilities: FloatArray) -> FloatArray:
    """Eq. 4: weights (...,), not normalised, of activities (..., 3) and reliabilities (7,)."""
    return np.asarray(products(activities) @ reliabilities)


def evaluation(terms: FloatArray) -> FloatArray:
    """Eq. 6: f_c = Σ_{i≠c} A_i·A_c (7,) of the seven terms (7,) at the estimate; 0…6."""
    return np.asarray(terms * (terms.sum() - terms))


def adapted(
    reliabilities: FloatArray, activities: FloatArray, learning_rate: float, offset: float
) -> FloatArray:
    """Eq. 5: reliabilities (7,) after a frame with activities (3,) at the estimate.

    α ← (1 − ε)·α + ε·f + β is a contraction towards f + β/ε, with f in 0…6: reliabilities stay between
    β/ε, below which no cue falls for good, and 6 + β/ε. They need no normalising, for only their ratios
    matter to the particles.

    Parameters
    ----------
    learning_rate : ε, in 0…1
    offset : β
    """
    gained = evaluation(products(activities))
    return np.asarray((1.0 - learning_rate) * reliabilities + learning_rate * gained + offset)
