"""Sigma-Pi network of Yan, Weber & Wermter (2011), and the parameters of its tracker."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.trackers.tracker import BoxDynamics

CUES = ("motion", "colour", "shape")
TERMS: tuple[tuple[int, ...], ...] = ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2))
"""Cues of each of the seven terms of eq. 4: three linear, three quadratic, one cubic."""
TERM_NAMES = tuple("·".join(CUES[c] for c in term) for term in TERMS)


def products(activities: FloatArray) -> FloatArray:
    """Return the seven terms (..., 7) of activities (..., 3) in 0…1."""
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
    β/ε and 6 + β/ε. They are not normalised, since particle weights depend only on their ratios.

    Parameters
    ----------
    learning_rate : ε, in 0…1
    offset : β
    """
    gained = evaluation(products(activities))
    return np.asarray((1.0 - learning_rate) * reliabilities + learning_rate * gained + offset)


Estimate = Literal["cluster", "mean"]


WIDTH = 320
"""Columns of the processed frames; larger frames are reduced. Lengths are in pixels of these."""
FIRST_SIZE = (36.0, 36.0)
"""Width and height of the searched person if no box is given."""


@dataclass(frozen=True)
class SigmaPiParameters:
    """Parameters of the Sigma-Pi tracker.

    Attributes
    ----------
    particles : number of particles
    cues : active cues; the others have activity 0
    random_share : share of the particles that are reinitialised at random in each step
    random_weight : factor of the weight of reinitialised particles while the person is found: people jump
        less often than these particles (importance sampling)
    lost_share : share of unsupported particles that are reinitialised, while the person is not found
    learning_rate, offset : ε and β of eq. 5
    fixed : cues with a constant reliability of the linear term; ("motion",) in the paper
    estimate : "cluster": the mean of the heaviest cluster of particles; "mean": of all, as in the paper
    weigh_before_move : whether eq. 4 weights the particles before they move, as in the paper; by default they
        move first
    teach_always : whether colour and shape learn from every frame with the person found, as in the paper,
        and not only from estimates that other cues support
    views : whether the shape cue uses views (`ViewCue`) instead of local features, if a box is given
    redetect : whether a window at rest may be left for a moving region with the person's colours
    dynamics : of the particles; few are drawn from a guide's proposal, which assumes steady walking, while
        people in a room turn and stop
    """

    particles: int = 50
    cues: tuple[str, ...] = CUES
    random_share: float = 0.05
    random_weight: float = 0.3
    lost_share: float = 0.5
    learning_rate: float = 0.05
    offset: float = 0.01
    fixed: tuple[str, ...] = ()
    estimate: Estimate = "cluster"
    weigh_before_move: bool = False
    teach_always: bool = False
    views: bool = True
    redetect: bool = True
    dynamics: BoxDynamics = field(default_factory=lambda: BoxDynamics(0.6, 0.12, 0.2, 0.05, 0.03, 0.2))

    def __post_init__(self) -> None:
        if self.particles < 1:
            raise InputError(f"{self.particles} particles", "at least 1")
        if set(self.cues) - set(CUES) or not self.cues:
            raise InputError(f"the cues {', '.join(self.cues) or 'none'}", f"some of {', '.join(CUES)}")
        if set(self.fixed) - set(CUES):
            raise InputError(f"the fixed cues {', '.join(self.fixed)}", f"some of {', '.join(CUES)}, or none")
        if self.estimate not in ("cluster", "mean"):
            raise InputError(f"estimate {self.estimate!r}", "'cluster' or 'mean'")

    @classmethod
    def of_the_paper(cls, particles: int = 50) -> SigmaPiParameters:
        """Return the parameters of Yan et al. 2011 as far as published.

        Eq. 4 weights the particles at s_{t−1}, before they move (§2.1, §2.2); the estimate is their mean;
        5 % are reinitialised in each step, with full weight; motion's reliability is not adaptive (§2.2);
        colour and shape learn in every frame (§4.1), shape from local features.
        """
        share = cls().random_share
        return cls(
            particles,
            random_weight=1.0,
            lost_share=share,
            fixed=("motion",),
            estimate="mean",
            weigh_before_move=True,
            teach_always=True,
            views=False,
            redetect=False,
        )
