"""iSAM2 of one person, over the full history or in a window."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.inference.chain.engine import is_chain
from graphtrack.inference.graph.linearizers import (
    ANCHOR_KAPPA,
    Beginning,
    FactorLinearizer,
    KernelLinearizer,
    Linearizer,
)
from graphtrack.inference.graph.links import Link, is_recoupled
from graphtrack.inference.prior import MarginalPrior, StatePrior, on_state, on_variables
from graphtrack.inference.state import Angles, Newest, Window, finite, present
from graphtrack.inference.warm import has_own_kernels
from graphtrack.later import gtsam
from graphtrack.model import Model, Step
from graphtrack.model.factors.derived import Couplings
from graphtrack.model.kernels.layout import BODY, HEAD, TIME_TOLERANCE

_NEVER = 10**9
_RECOUPLED = 0.1
"""Share by which a coupling that the modes set has to change for its step to be linearised anew."""
_SMALL = 0.1
"""Of the threshold: a step that moves by less is the last one, into the past, whose estimate is read."""
_WILDFIRE = 1e-6
"""Metres, m/s or radians, below which GTSAM does not go on substituting into the past."""
_AT_ONCE = 12
"""Steps whose estimates are read together."""
_BATCH_SHARE = 0.6
"""Of the history: if more changes, GTSAM may order all variables anew; it does so from 65 % of them on."""


class Isam2:
    """An iSAM2 smoother of one person.

    A step is one variable of GTSAM's, of up to six coordinates, and its Bayes tree is eliminated in the order
    of time. An observation eliminates its own step anew, the one before it, and all since the earliest whose
    terms are linearised anew with it; back-substitution goes on into the past until nothing changes there any
    more.

    What is linearised anew is decided here. A step's terms are handed over as Gaussians, and exchanged with
    the next observation when the step is farther than the threshold from where that was done. GTSAM's own
    relinearisation moves variables in place of factors, which comes to the same; but for it GTSAM visits the
    whole history. The kernels of the presets' terms make the Gaussians where there is nothing else, which
    takes microseconds; of other terms GTSAM does, from their factors.

    With a lag, what has left the window is marginalised: it stays as a Gaussian on the step after it. Time
    and memory are bounded by the window then. Without, memory grows with the track; of the time, only what
    GTSAM takes to count the numbers in its tree after each update, to tell them with the result.

    Whatever a method raises, it leaves the smoother as it was, built again from the Gaussians of before.

    Parameters
    ----------
    model : the terms
    lag : seconds that the window reaches back from its newest step; infinite: all history
    relinearize_threshold : change of a coordinate beyond which it is linearised again (metres, m/s, radians)
    step_tolerance : the updates for an observation end when no coordinate is farther than this, or than the
        threshold, from where it was linearised
    max_iterations : or after so many
    couplings : what the modes of the couplings set, of each step; whoever has the smoother renews them before
        each observation, and says in `renewed` of how many steps
    """

    def __init__(
        self,
        model: Model,
        lag: float,
        relinearize_threshold: float,
        step_tolerance: float,
        max_iterations: int,
        couplings: Couplings | None = None,
    ) -> None:
        self._model, self._lag, self._threshold = model, lag, relinearize_threshold
        self._couplings, self.renewed = couplings, 0
        self._small = _SMALL * relinearize_threshold
        self._tolerance, self._max_iterations = max(relinearize_threshold, step_tolerance), max_iterations
        compiled = is_chain(model) and not has_own_kernels(model)
        self._linearizer: Linearizer = (KernelLinearizer if compiled else FactorLinearizer)(model, couplings)
        self._present = present(model)
        self.steps: list[Step] = []
        self._links: list[Link] = []
        self._places: dict[int, Link] = {}
        self._anchor: Angles | None = None
        self._beginning = Beginning()
        self._marginals: list[Any] = []
        self._marginal_slots: set[int] = set()
        self._moved: list[Link] = []
        self._first = len(self._present)
        self._changed = 0
        self._log: dict[int, tuple[Link, Any]] = {}
        self._isam = self._empty()

    def state(self, step: Step) -> tuple[float, ...]:
        """x, y, vx, vy, body, head of a step."""
        link = self._places[step.index]
        return self._state(link, self._isam.getDelta().at(link.key).tolist())

    def _state(self, link: Link, beyond: Sequence[float]) -> tuple[float, ...]:
        """x, y, vx, vy, body, head that are so far beyond where a step began; NaN for what there is not."""
        state = [math.nan] * 6
        for place, began, far in zip(self._present, link.began, beyond, strict=True):
            state[place] = began + far
        (left, bottom), (x, y, vx, vy, body, head) = self._beginning.origin, state
        whole = 2.0 * math.pi
        return x + left, y + bottom, vx, vy, math.remainder(body, whole), math.remainder(head, whole)

    # -- observations --------------------------------------------------------------------------------------

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; what is known about it then."""
        links, moved, anchor, beginning = self._links, self._moved, self._anchor, self._beginning
        self._log.clear()
        try:
            exchanged = self._linearised()
            if not links:
                self._anchor = (state[4], state[5])
                self._beginning = Beginning((state[0], state[1]), self._anchor)
                self._linearizer.begin((), self._beginning)
            began = self._beginning.coordinates(state, self._model)
            link = Link(step, began, links[-1].serial + 1 if links else 0)
            self._linearizer.add(link, links)
            links.append(link)
            self.steps.append(step)
            self._places[step.index] = link
            self._linearizer.linearise([len(links) - 1], links)
            self._update(exchanged, link)
            newest = self._settled()
            self._slide()
            return newest
        except BaseException:
            for one, kept in self._log.values():
                one.restore(kept)
            self._moved, self._anchor, self._beginning = moved, anchor, beginning
            if self.steps and self.steps[-1] is step:
                links.pop()
                self.steps.pop()
                del self._places[step.index]
                self._build()
            raise

    def rework(self, window: Window) -> Newest:
        """Take over a history that was changed; what is known about its newest step then."""
        before = self._marginals, self._links, self.steps, self._places, self._moved
        beginning = self._anchor, self._beginning
        self._log.clear()
        try:
            self.restore(window)
            return self._settled()
        except BaseException:
            self._marginals, self._links, self.steps, self._places, self._moved = before
            self._anchor, self._beginning = beginning
            for one, kept in self._log.values():
                one.restore(kept)
            self._linearizer.begin(self._links, self._beginning)
            self._build()
            raise

    def _settled(self) -> Newest:
        """What is known about the newest step, once none is too far from where it was linearised."""
        for _ in range(self._max_iterations - 1):
            if not self._read() > self._tolerance:
                break
            self._update(self._linearised())
        else:
            self._read()
        link = self._links[-1]
        state = finite(self._state(link, link.moved))
        found = self._isam.marginalCovariance(link.key)
        if len(self._present) == len(state):
            return state, found
        covariance = np.full((6, 6), np.nan)
        covariance[np.ix_(self._present, self._present)] = found
        return state, covariance

    def _read(self) -> float:
        """Read the estimates that have changed; the greatest distance from where one was linearised."""
        links, log, threshold = self._links, self._log, self._threshold
        newest, size, first = links[-1], len(self._present), self._first
        greatest, self._moved = 0.0, []
        # Not a copy: to read many variables costs no more than to ask for one.
        delta = self._isam.getDelta()
        for end in range(len(links), 0, -_AT_ONCE):
            block = links[max(0, end - _AT_ONCE) : end]
            numbers = delta.vector([link.key for link in block]).tolist()
            for i in range(len(block) - 1, -1, -1):
                link, now = block[i], numbers[i * size : (i + 1) * size]
                if link.serial not in log:
                    log[link.serial] = link, link.kept()
                before, link.moved = link.moved, now
                if first < size and (far := link.curvature * _distance(now, link.point, first)) > threshold:
                    self._moved.append(link)
                    greatest = max(greatest, far)
                if (
                    link.serial <= self._changed
                    and link is not newest
                    and link.curvature * _distance(now, before, first) <= self._small
                ):
                    return greatest
        return greatest

    # -- iSAM2 ---------------------------------------------------------------------------------------------

    def _linearised(self) -> list[tuple[Link, int]]:
        """Linearise what has moved where it is now; the Gaussians that are to be exchanged."""
        links = self._links
        moved = {link.serial - links[0].serial for link in self._moved}
        if self._couplings is not None:
            for i in range(max(0, len(links) - self.renewed), len(links)):
                link = links[i]
                if is_recoupled(link.coupled, self._couplings[link.step.index], _RECOUPLED):
                    moved.add(i)
        self._moved = []
        if not moved:
            return []
        places = sorted(moved | {i + 1 for i in moved if i + 1 < len(links)})
        for i in places:
            self._log.setdefault(links[i].serial, (links[i], links[i].kept()))
            if i in moved:
                links[i].point = links[i].moved
        kept = {i: links[i].gaussians[0] for i in places if i not in moved}
        self._linearizer.linearise(places, links)
        for i, own in kept.items():
            links[i].gaussians = own, links[i].gaussians[1]
        return [
            (links[i], part)
            for i in places
            for part in ((0, 1) if i in moved else (1,))
            if links[i].gaussians[part] is not None
        ]

    def _update(self, exchanged: list[tuple[Link, int]], new: Link | None = None) -> None:
        """Exchange Gaussians that stand in the links already, and add the newest link if it is ``new``."""
        links, newest = self._links, self._links[-1]
        self._changed = min([newest.serial - 1, *(link.serial - part for link, part in exchanged)])
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        removed = [link.slots[part] for link, part in exchanged]
        if new is not None:
            values.insert(new.key, np.zeros(len(self._present)))
            exchanged = [*exchanged, *((new, part) for part in (0, 1) if new.gaussians[part] is not None)]
            self._first = min(self._first, new.first)
        for link, part in exchanged:
            graph.push_back(link.gaussians[part])
        order = self._order(self._changed - links[0].serial)
        result = self._isam.update(graph, values, removed, order, None, None, False)
        for (link, part), slot in zip(exchanged, result.getNewFactorsIndices(), strict=False):
            link.slots[part] = slot

    def _order(self, changed: int) -> gtsam.KeyGroupMap:
        """In the order of time, for an update that changes the steps from a place on."""
        links = self._links
        first = changed - 1 if changed - 1 > (1.0 - _BATCH_SHARE) * len(links) else 0
        # GTSAM takes no group of a greater number than there are variables to eliminate.
        shift = max(0, max(changed, 0) - first)
        order = gtsam.KeyGroupMap()
        for group, link in enumerate(links[first:]):
            order.insert2(link.key, max(0, group - shift))
        return order

    def _slide(self) -> None:
        links = self._links
        horizon = links[-1].step.observation.t - self._lag - TIME_TOLERANCE
        while links[0].step.observation.t < horizon:
            gone = gtsam.KeyList()
            gone.push_back(links[0].key)
            made, absorbed = self._isam.marginalizeLeavesWithIndices(gone)
            if links[0] in self._moved:
                self._moved.remove(links[0])
            del self._places[links[0].step.index], links[0], self.steps[0]
            links[0].cut()
            self.steps[0] = links[0].step
            self._marginal_slots = (self._marginal_slots - {*absorbed}) | {*made}
            factors: Any = self._isam.getFactorsUnsafe()
            self._marginals = [factors.at(slot) for slot in sorted(self._marginal_slots)]

    def _build(self) -> None:
        """Eliminate all Gaussians at once, in a new Bayes tree."""
        self._isam, self._first = self._empty(), len(self._present)
        self._marginal_slots = set(range(len(self._marginals)))
        if not self._links:
            return
        graph, values, order = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.KeyGroupMap()
        for factor in self._marginals:
            graph.push_back(factor)
        for group, link in enumerate(self._links):
            self._first = min(self._first, link.first)
            values.insert(link.key, np.zeros(len(self._present)))
            for part in (0, 1):
                if link.gaussians[part] is not None:
                    link.slots[part] = graph.size()
                    graph.push_back(link.gaussians[part])
            order.insert2(link.key, group)
        self._isam.update(graph, values, [], order)
        self._changed = self._links[0].serial

    def _empty(self) -> gtsam.ISAM2:
        steps = gtsam.ISAM2GaussNewtonParams()
        steps.setWildfireThreshold(_WILDFIRE)
        parameters = gtsam.ISAM2Params()
        parameters.relinearizeSkip = _NEVER
        parameters.setOptimizationParams(steps)
        parameters.findUnusedFactorSlots = self._lag < math.inf
        return gtsam.ISAM2(parameters)

    # -- saved states --------------------------------------------------------------------------------------

    def restore(self, window: Window) -> None:
        """Take over a history as it stands."""
        self._anchor = window.anchor
        states = [window.values[step.index] for step in window.steps]
        if states:
            left, bottom = states[0][:2]
            self._beginning = Beginning((left, bottom), window.anchor or (0.0, 0.0))
        links = [
            Link(step, self._beginning.coordinates(state, self._model), serial)
            for serial, (step, state) in enumerate(zip(window.steps, states, strict=True))
        ]
        self._linearizer.begin(links, self._beginning)
        if links:
            self._linearizer.linearise(range(len(links)), links)
        self._marginals = [] if window.prior is None else [self._from_prior(window.prior, links[0])]
        self._links, self.steps, self._moved = links, list(window.steps), []
        self._places = {link.step.index: link for link in links}
        self._build()
        if links:
            self._read()

    def window(self) -> Window:
        """What another smoother needs to go on from here."""
        points = {link.step.index: self._state(link, link.point) for link in self._links}
        return Window(tuple(self.steps), points, self._prior(), self._anchor)

    def _prior(self) -> MarginalPrior | None:
        if not self._marginals:
            return None
        link, graph = self._links[0], gtsam.GaussianFactorGraph()
        for factor in self._marginals:
            graph.push_back(factor.factor())
        information, vector = graph.hessian(gtsam.Ordering([link.key]))
        # About where the step was linearised, which is what the window has of it.
        linear = np.ravel(vector) - information @ np.array(link.point)
        whole = StatePrior(np.zeros((6, 6)), np.zeros(6), np.array(self._state(link, link.point)))
        whole.information[np.ix_(self._present, self._present)] = information
        whole.linear[self._present] = linear
        return on_variables(whole, link.step, self._model)

    def _from_prior(self, prior: MarginalPrior, link: Link) -> gtsam.LinearContainerFactor:
        """What a prior says, about where a step began."""
        information, linear, point = on_state(prior, link.step, self._model)
        away = np.array(self._state(link, [0.0] * len(self._present))) - point
        away[4:] = wrap(away[4:])
        for angle in (BODY, HEAD):
            # Other engines hold a first orientation by less.
            information[angle, angle] = max(information[angle, angle], ANCHOR_KAPPA)
        rows = self._present
        information = information[np.ix_(rows, rows)]
        vector = linear[rows] - information @ away[rows]
        return gtsam.LinearContainerFactor(gtsam.HessianFactor(link.key, information, vector, 0.0))

    def arrays(self) -> dict[str, FloatArray]:
        """How far the estimates, as they were read, are from where the steps were linearised; see `resume`.

        GTSAM does not give its Bayes tree away. What is built again is the same but for rounding.
        """
        return {"moved": np.array([np.subtract(link.moved, link.point) for link in self._links])}

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Go on where `window` and `arrays` were taken, and exchange what would have been exchanged.

        Raises
        ------
        KeyError, ValueError
            If the arrays do not fit the window.
        """
        self.restore(window)
        rows = arrays["moved"].reshape(len(self._links), len(self._present)).tolist()
        self._moved = []
        for link, moved in zip(reversed(self._links), reversed(rows), strict=True):
            link.moved = moved
            if _distance(moved, link.point, self._first) > self._threshold:
                self._moved.append(link)


def _distance(a: Sequence[float], b: Sequence[float], first: int) -> float:
    """The greatest difference of two steps' coordinates (metres, m/s, radians), from one of them on."""
    greatest = 0.0
    for i in range(first, len(a)):
        if (far := abs(a[i] - b[i])) > greatest:
            greatest = far
    return greatest
