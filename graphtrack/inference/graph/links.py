"""A step of an incremental smoother: its factors, and the Gaussians that stand for some of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np

from graphtrack.inference.graph.batch import variable_keys
from graphtrack.model import Model, Step
from graphtrack.model.factors.derived import Couplings

_LINEAR = (gtsam.WnoaMotionFactorPoint2, gtsam.PriorFactorPoint2)


class Link:
    """A step, its factors, and where they were linearised.

    Coordinates are numbers in the order of the keys: x, y, vx, vy (metres, m/s), and the orientations that
    the model has (radians).

    Parameters
    ----------
    step, model : whose factors they are
    state : x, y, vx, vy, body, head where the step's variables begin
    serial : greater by one than that of the step before
    couplings : what the modes of the couplings set, of each step

    Attributes
    ----------
    keys : of the variables
    own, back : factors that are not linear: on the step's own variables, and that reach the step before
    linear, linear_back : the same of linear ones, for GTSAM as they are
    first : the first coordinate that ``own`` or ``back`` depends on, of either step; their number: none
    began, begun : where GTSAM has the variables: coordinates, and values
    moved : the estimate's coordinates beyond these, as they were read last
    point, values : where the Gaussians were linearised: coordinates beyond ``began``, and values
    gaussians : of ``own`` and ``back``; None: there is nothing to say
    slots : their numbers in GTSAM
    coupled : what the modes had set of the step when ``own`` was linearised last; None without modes
    """

    __slots__ = (
        "back",
        "began",
        "begun",
        "coupled",
        "couplings",
        "first",
        "gaussians",
        "keys",
        "linear",
        "linear_back",
        "moved",
        "own",
        "point",
        "serial",
        "slots",
        "step",
        "values",
    )

    def __init__(
        self,
        step: Step,
        model: Model,
        state: Sequence[float],
        serial: int,
        couplings: Couplings | None = None,
    ) -> None:
        self.step, self.serial, self.couplings = step, serial, couplings
        self.coupled: Sequence[float] | None = None
        self.keys = variable_keys(step, model)
        angles = [state[i] for i, has in ((4, model.has_body), (5, model.has_head)) if has]
        self.began = [*state[:4], *angles]
        self.point = self.moved = [0.0] * len(self.began)
        self.values = self.begun = gtsam.Values()
        for key, place in zip(self.keys[:2], (0, 2), strict=True):
            self.values.insert(key, np.array(state[place : place + 2]))
        for key, angle in zip(self.keys[2:], angles, strict=True):
            self.values.insert(key, gtsam.Rot2(angle))
        self.gaussians: list[Any] = [None, None]
        self.slots = [-1, -1]
        self.linear, self.linear_back = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
        self.own, self.back = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
        self._sort(model)

    def _sort(self, model: Model) -> None:
        own = self.keys
        before = [] if self.step.previous is None else variable_keys(self.step.previous, model)
        self.first = len(self.began)
        for factor in model.factors(self.step, self.couplings):
            is_own = True
            is_linear = isinstance(factor, _LINEAR) and not _is_robust(factor)
            for key in factor.keys():  # noqa: SIM118
                is_own = is_own and key in own
                if not is_linear:
                    # Two coordinates each of position and velocity, then one each.
                    place = (own if key in own else before).index(key)
                    self.first = min(self.first, 2 * place if place < 2 else 2 + place)
            if is_linear:
                (self.linear if is_own else self.linear_back).push_back(factor)
            else:
                (self.own if is_own else self.back).push_back(factor)

    def state(self, model: Model) -> tuple[float, ...]:
        """x, y, vx, vy, body, head where the Gaussians were linearised; NaN for what the model lacks."""
        found = [a + b for a, b in zip(self.began, self.point, strict=True)]
        angles = iter(found[4:])
        nan = float("nan")
        body, head = (next(angles) if has else nan for has in (model.has_body, model.has_head))
        return (*found[:4], body, head)

    def begin(self) -> None:
        """Have GTSAM's variables where the Gaussians were linearised."""
        self.began = [a + b for a, b in zip(self.began, self.point, strict=True)]
        self.moved = [a - b for a, b in zip(self.moved, self.point, strict=True)]
        self.point, self.begun = [0.0] * len(self.began), self.values

    def turn(self, far: float) -> None:
        """Have GTSAM's orientations where the estimate is, if that is farther than so many radians."""
        turned = [x if i > 3 and abs(x) > far else 0.0 for i, x in enumerate(self.moved)]
        self.began = [a + b for a, b in zip(self.began, turned, strict=True)]
        self.moved = [a - b for a, b in zip(self.moved, turned, strict=True)]
        self.point = [a - b for a, b in zip(self.point, turned, strict=True)]
        self.begun = gtsam.Values(self.begun)
        for key, angle in zip(self.keys[2:], self.began[4:], strict=True):
            self.begun.update(key, gtsam.Rot2(angle))

    def move(self, delta: gtsam.VectorValues) -> None:
        """Linearise at the estimate from now on, which is so far from where GTSAM has the variables."""
        self.point, self.values = self.moved, self.begun.retract(delta)

    def linearise(self, previous: Link | None, own: bool = True) -> None:
        """Make the Gaussians: of ``back``, at the points of both steps, and of ``own`` if wanted."""
        gaussians = list(self.gaussians)
        if own:
            self.coupled = None if self.couplings is None else self.couplings[self.step.index]
            gaussians[0] = _gaussian(self.own, self.values)
        if previous is not None and self.back.size():
            both = gtsam.Values(previous.values)
            both.insert(self.values)
            gaussians[1] = _gaussian(self.back, both)
        self.gaussians = gaussians

    def cut(self) -> None:
        """Forget the step before, which was marginalised with all that reached it."""
        self.step = self.step.alone()
        self.back, self.linear_back = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
        self.gaussians, self.slots = [self.gaussians[0], None], [self.slots[0], -1]

    def is_recoupled(self, threshold: float) -> bool:
        """Whether the modes have set a coupling, or the steering, that differs by more than this share."""
        if self.couplings is None or self.coupled is None:
            return False
        old, new = self.coupled, self.couplings[self.step.index]
        if new is old:
            return False
        for kappa, cos, sin in ((0, 1, 2), (3, 4, 5)):
            a, b = old[kappa], new[kappa]
            change = math.hypot(b * new[cos] - a * old[cos], b * new[sin] - a * old[sin])
            if change > threshold * max(a, b):
                return True
        return abs(new[6] - old[6]) > threshold * max(new[6], old[6])

    def kept(self) -> tuple[Any, ...]:
        """What linearising anew and reading change."""
        return self.began, self.begun, self.moved, self.point, self.values, self.gaussians, self.coupled

    def restore(self, kept: tuple[Any, ...]) -> None:
        """The inverse of `kept`."""
        self.began, self.begun, self.moved, self.point, self.values, self.gaussians, self.coupled = kept


def _is_robust(factor: gtsam.PriorFactorPoint2 | gtsam.WnoaMotionFactorPoint2) -> bool:
    return isinstance(factor.noiseModel(), gtsam.noiseModel.Robust)


def _gaussian(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.LinearContainerFactor | None:
    if not graph.size():
        return None
    return gtsam.LinearContainerFactor(gtsam.HessianFactor(graph.linearize(values)), values)
