"""A step of an incremental smoother: where it was linearised, and the Gaussians that stand for its terms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from graphtrack.inference.graph.chain_view import is_ambiguous
from graphtrack.later import gtsam
from graphtrack.model import Step

_OF_CLASSES = 10.0


class Link:
    """A step of an incremental smoother.

    The step is one variable of GTSAM's: its coordinates x, y, vx, vy (metres, m/s), and the orientations that
    the model has (radians), as differences from where they began.

    Parameters
    ----------
    step : the step
    began : coordinates at which GTSAM's variable is zero
    serial : greater by one than that of the step before

    Attributes
    ----------
    key : of the variable
    curvature : how many times as near to where it was linearised the step has to stay as others: likelihoods
        of classes have peaks where angles have none
    moved : the estimate's coordinates beyond ``began``, as they were read last
    point : the coordinates beyond ``began`` where the Gaussians were linearised
    first : the first coordinate that terms which are not linear depend on, of this step or the one before;
        their number: none
    gaussians : of the terms of the step alone, and of those that link it to the one before; None: there are
        none
    slots : their numbers in GTSAM
    coupled : what the modes of the couplings had set when it was linearised last; None without modes
    terms : what whoever linearises keeps of the step
    """

    __slots__ = (
        "began",
        "coupled",
        "curvature",
        "first",
        "gaussians",
        "key",
        "moved",
        "point",
        "serial",
        "slots",
        "step",
        "terms",
    )

    def __init__(self, step: Step, began: Sequence[float], serial: int) -> None:
        self.step, self.serial, self.key = step, serial, gtsam.symbol("s", step.index)
        self.curvature = _OF_CLASSES if is_ambiguous(step) else 1.0
        self.began = list(began)
        self.point = self.moved = [0.0] * len(self.began)
        self.first = 0
        self.gaussians: tuple[Any, Any] = (None, None)
        self.slots = [-1, -1]
        self.coupled: Sequence[float] | None = None
        self.terms: Any = None

    @property
    def linearised(self) -> list[float]:
        """The coordinates where the Gaussians were linearised."""
        return [a + b for a, b in zip(self.began, self.point, strict=True)]

    @property
    def estimate(self) -> list[float]:
        """The coordinates as they were read last."""
        return [a + b for a, b in zip(self.began, self.moved, strict=True)]

    def cut(self) -> None:
        """Forget the step before, which was marginalised with all that reached it."""
        self.step = self.step.alone()
        self.gaussians, self.slots = (self.gaussians[0], None), [self.slots[0], -1]

    def kept(self) -> tuple[Any, ...]:
        """What linearising anew and reading change."""
        return self.moved, self.point, self.gaussians, self.coupled

    def restore(self, kept: tuple[Any, ...]) -> None:
        """The inverse of `kept`."""
        self.moved, self.point, self.gaussians, self.coupled = kept


def is_recoupled(old: Sequence[float] | None, new: Sequence[float], threshold: float) -> bool:
    """Whether a coupling, the steering or a doubt differs by more than a share; rows as in `COUPLED`."""
    if old is None or new is old:
        return False
    for kappa, cos, sin in ((0, 1, 2), (3, 4, 5)):
        a, b = old[kappa], new[kappa]
        change = math.hypot(b * new[cos] - a * old[cos], b * new[sin] - a * old[sin])
        if change > threshold * max(a, b):
            return True
    if abs(new[6] - old[6]) > threshold:
        return True
    return abs(new[7] - old[7]) > threshold * max(new[7], old[7])
