"""The Sigma-Pi network of Yan, Weber & Wermter (2011) and the parameters of its tracker."""

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


Estimate = Literal["cluster", "mean"]


@dataclass(frozen=True)
class CueParameters:
    """Parameters of the cues. Lengths are pixels of the reduced frame.

    Attributes
    ----------
    surround : size of a window with its surround, in sizes of the window
    background_rate : share of the difference by which the running average moves in a frame
    motion_threshold : grey levels from which a difference is motion
    motion_overlap, colour_overlap, shape_overlap : overlap of a window with what is salient, at which
        the cue's activity rises, and how steeply (`perception.trackers.sigma_pi_cues.activation`)
    colour_rate : of adapting the target's histogram, for one frame
    surroundings_rate : of adapting the background's histogram
    colour_odds : of the background against the target, for a pixel of which nothing is known
    memory : frames of features that are remembered
    background_features : how many features of the background are remembered
    matched : similarity from which two features are the same thing
    margin : lead of one similarity over the other that decides between target and background
    negative : how much a feature of the background counts against one of the target
    fewest : features of a target that are expected at least
    contrast : threshold of the SIFT detector
    focus : size of the part of the frame in which features are looked for while the person is found, in
        sizes of the window; the least such part has sides of ``focus_least``
    everywhere : frames after which they are looked for in the whole frame all the same
    view_gain : of `views.ViewCue`, at which its activity rises, and how steeply: halfway between what is
        beside the person and the view that was given
    view_new : gain below which a view is new
    view_least : least width and height of a box whose view is remembered: two pixels for each of its cells
    """

    surround: float = 2.2
    background_rate: float = 0.02
    motion_threshold: float = 16.0
    motion_overlap: tuple[float, float] = (0.25, 0.05)
    colour_overlap: tuple[float, float] = (0.25, 0.05)
    shape_overlap: tuple[float, float] = (0.15, 0.04)
    colour_rate: float = 0.015
    surroundings_rate: float = 0.01
    colour_odds: float = 3.0
    memory: int = 10
    background_features: int = 600
    matched: float = 0.85
    margin: float = 0.08
    negative: float = 0.5
    fewest: float = 6.0
    contrast: float = 0.03
    focus: float = 4.0
    focus_least: float = 120.0
    everywhere: int = 10
    view_gain: tuple[float, float] = (0.4, 0.1)
    view_new: float = 0.6
    view_least: float = 12.0


@dataclass(frozen=True)
class SigmaPiParameters:
    """Of the Sigma-Pi tracker. Lengths are pixels of frames reduced to ``width``.

    Attributes
    ----------
    particles : how many there are
    width : of the frames that are looked at; larger ones are reduced
    cues : which are used; the others stay silent
    random_share : of the particles that are drawn anew anywhere in each step
    random_weight : factor of the weight of particles drawn anew while the person is found: people jump less
        often than the particles that look out for them (importance sampling)
    lost_share : the same for particles that nothing supports, while the person is not found
    learning_rate, offset : ε and β of eq. 5
    reliability : of every term at first
    fixed : cues whose own reliability (that of the linear term) stays as at first; ("motion",) in the paper
    first_size : width and height of the person that is looked for where no box is given
    size_std : 1-σ of the logarithm of the size of particles that are drawn anew
    size_range : least and greatest width and height, in sizes of the first box and of ``first_size``
    size_rate : by which the size that is expected follows the one that is found, in a frame
    support : activity from which a cue supports the estimate
    found, lost : confidence from which the person is found, and below which they are lost again
    young : frames of the person in which one cue that supports the estimate is enough for the others to
        learn from it; later two have to
    stale : frames in a row with motion alone after which what was learned is taken to be of no more use
    patience : frames without or with support until that is believed
    estimate : "cluster": the mean of the heaviest cluster of particles; "mean": of all, as in the paper
    weigh_before_move : whether eq. 4 judges the particles where the last frame left them, before they move,
        as in the paper; by default they move first
    teach_always : whether colour and shape learn from every frame in which the person is found, as in the
        paper, and not only from estimates that other cues support
    views : whether a person whose box is given is told by the view in it (`views.ViewCue`) instead of by
        local features
    sharpness : power of eq. 4 that weighs the particles of a person who is told by views; 1 in the paper
    view_range : least and greatest size of such a person, in sizes of the first box
    dynamics : of the particles; few are drawn from a guide's proposal, which takes people to walk on,
        while in a room they turn and stop
    sights : of the cues
    """

    particles: int = 50
    width: int = 320
    cues: tuple[str, ...] = CUES
    random_share: float = 0.05
    random_weight: float = 0.3
    lost_share: float = 0.5
    learning_rate: float = 0.05
    offset: float = 0.01
    reliability: float = 1.0
    fixed: tuple[str, ...] = ()
    first_size: tuple[float, float] = (36.0, 36.0)
    size_std: float = 0.25
    size_range: tuple[float, float] = (0.75, 2.0)
    size_rate: float = 0.05
    young: int = 40
    stale: int = 15
    support: float = 0.5
    found: float = 0.5
    lost: float = 0.3
    patience: int = 3
    estimate: Estimate = "cluster"
    weigh_before_move: bool = False
    teach_always: bool = False
    views: bool = True
    sharpness: float = 4.0
    view_range: tuple[float, float] = (0.3, 3.0)
    dynamics: BoxDynamics = field(default_factory=lambda: BoxDynamics(0.6, 0.12, 0.2, 0.05, 0.03, 0.2))
    sights: CueParameters = field(default_factory=CueParameters)

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
        """Yan et al. 2011 as printed, as far as it says.

        Eq. 4 weighs the particles at s_{t−1}, which move then (§2.1, §2.2); the estimate is the mean of all;
        5 % go anywhere in each step and weigh as much as any; motion's reliability is not adaptive (§2.2);
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
        )
