"""iSAM2 of one person, over the full history or in a window."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import gtsam
import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.graph.batch import anchors, bounded
from graphtrack.inference.graph.links import Link
from graphtrack.inference.prior import MarginalPrior, marginal_prior
from graphtrack.inference.state import Angles, Newest, Window, finite
from graphtrack.model import Model, Step
from graphtrack.model.factors.derived import Couplings

_NEVER = 10**9
_ANCHOR_KAPPA = 1e-4
"""Concentration at which first orientations are held. GTSAM's Bayes tree refuses a clique whose last pivot is
less than 2⁻²⁴ of the one before, as between turning and a weaker anchor in the frames of a video."""
_FAR = 1.0
"""Radians from where GTSAM has an orientation, at which it is set anew: half a turn would be ambiguous."""
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

    GTSAM's Bayes tree is eliminated in the order of time. An observation eliminates its own step anew, the
    one before it, and all since the earliest whose factors are linearised anew with it; back-substitution
    goes on into the past until nothing changes there any more.

    What is linearised anew is decided here. A step's factors that are not linear are handed over as
    Gaussians, and exchanged with the next observation when one of the step's variables is farther than the
    threshold from where that was done. GTSAM's own relinearisation moves variables in place of factors,
    which in the plane and on the circle comes to the same; but for it GTSAM visits the whole history.

    With a lag, what has left the window is marginalised: it stays as a Gaussian on the step after it. Time
    and memory are bounded by the window then. Without, memory grows with the track; of the time, only what
    GTSAM takes to count the numbers in its tree after each update, to tell them with the result.

    Whatever a method raises, it leaves the smoother as it was, built again from the Gaussians of before.

    Parameters
    ----------
    model : the terms
    lag : seconds that the window reaches back from its newest step; infinite: all history
    relinearize_threshold : change of a variable beyond which it is linearised again (metres, m/s, radians)
    step_tolerance : the updates for an observation end when no variable is farther than this, or than the
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
        present = [0, 1, 2, 3, *([4] if model.has_body else []), *([5] if model.has_head else [])]
        self._rows = np.ix_(present, present)
        self.steps: list[Step] = []
        self._links: list[Link] = []
        self._anchor: Angles | None = None
        self._marginals: list[gtsam.NonlinearFactor] = []
        self._marginal_slots: set[int] = set()
        self._moved: list[Link] = []
        self._far: list[Link] = []
        self._first = len(present)
        self._changed = 0
        self._log: dict[int, tuple[Link, Any]] = {}
        self._isam = self._empty()

    def state(self, step: Step) -> tuple[float, ...]:
        """x, y, vx, vy, body, head of a step."""
        nan = math.nan
        isam = self._isam
        body = isam.calculateEstimateRot2(step.body_key).theta() if self._model.has_body else nan
        head = isam.calculateEstimateRot2(step.head_key).theta() if self._model.has_head else nan
        position = isam.calculateEstimatePoint2(step.position_key)
        velocity = isam.calculateEstimateVector(step.velocity_key)
        return (*position.tolist(), *velocity.tolist(), body, head)

    # -- observations --------------------------------------------------------------------------------------

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; what is known about it then."""
        links, moved, anchor = self._links, self._moved, self._anchor
        self._log.clear()
        try:
            exchanged = self._linearised()
            serial = links[-1].serial + 1 if links else 0
            link = Link(step, self._model, tuple(state), serial, self._couplings)
            if not links:
                self._anchor = (state[4], state[5])
                self._hold(link)
            link.linearise(links[-1] if links else None)
            links.append(link)
            self.steps.append(step)
            self._update(exchanged, link)
            newest = self._settled()
            self._slide()
            return newest
        except BaseException:
            for one, kept in self._log.values():
                one.restore(kept)
            self._moved, self._anchor = moved, anchor
            if self.steps and self.steps[-1] is step:
                links.pop()
                self.steps.pop()
                self._build()
            raise

    def rework(self, window: Window) -> Newest:
        """Take over a history that was changed; what is known about its newest step then."""
        before = self._marginals, self._links, self.steps, self._anchor, self._moved
        self._log.clear()
        try:
            self.restore(window)
            return self._settled()
        except BaseException:
            self._marginals, self._links, self.steps, self._anchor, self._moved = before
            for one, kept in self._log.values():
                one.restore(kept)
            self._build()
            raise

    def _settled(self) -> Newest:
        """What is known about the newest step, once no variable is too far from where it was linearised."""
        for _ in range(self._max_iterations - 1):
            if not self._read() > self._tolerance:
                break
            self._update(self._linearised())
        else:
            self._read()
        link = self._links[-1]
        state = finite(self.state(link.step))
        keys = link.keys
        covariance = np.full((6, 6), np.nan)
        covariance[self._rows] = self._isam.jointMarginalCovariance(keys).fullMatrix()
        return state, bounded(covariance)

    def _read(self) -> float:
        """Read the estimates that have changed; the greatest distance from where one was linearised."""
        links, log, first, threshold = self._links, self._log, self._first, self._threshold
        newest, size = links[-1], len(links[-1].began)
        greatest, self._moved = 0.0, []
        if first == size:
            return greatest
        # Not a copy: to read many variables costs no more than to ask for one.
        delta = self._isam.getDelta()
        for end in range(len(links), 0, -_AT_ONCE):
            block = links[max(0, end - _AT_ONCE) : end]
            numbers = delta.vector([key for link in block for key in link.keys]).tolist()
            for i in range(len(block) - 1, -1, -1):
                link, now = block[i], numbers[i * size : (i + 1) * size]
                if link.serial not in log:
                    log[link.serial] = link, link.kept()
                before, link.moved = link.moved, now
                if (far := _distance(now, link.point, first)) > threshold:
                    self._moved.append(link)
                    greatest = max(greatest, far)
                    if any(abs(turn) > _FAR for turn in now[4:]):
                        self._far.append(link)
                if (
                    link.serial <= self._changed
                    and link is not newest
                    and _distance(now, before, first) <= self._small
                ):
                    return greatest
        return greatest

    # -- iSAM2 ---------------------------------------------------------------------------------------------

    def _linearised(self) -> list[tuple[Link, int]]:
        """Linearise what has moved where it is now; the Gaussians that are to be exchanged."""
        links, exchanged = self._links, []
        moved = {link.serial - links[0].serial for link in self._moved}
        if self._couplings is not None:
            last = range(max(0, len(links) - self.renewed), len(links))
            moved.update(i for i in last if links[i].is_recoupled(_RECOUPLED))
        for i in moved:
            self._log.setdefault(links[i].serial, (links[i], links[i].kept()))
            links[i].move(self._isam.getDelta())
        for i in sorted(moved | {i + 1 for i in moved if i + 1 < len(links)}):
            link = links[i]
            self._log.setdefault(link.serial, (link, link.kept()))
            link.linearise(links[i - 1] if i else None, own=i in moved)
            for part in (0, 1) if i in moved else (1,):
                if link.gaussians[part] is not None:
                    exchanged.append((link, part))
        self._moved = []
        return exchanged

    def _update(self, exchanged: list[tuple[Link, int]], new: Link | None = None) -> None:
        """Exchange Gaussians that stand in the links already, and add the newest link if it is ``new``."""
        links, newest = self._links, self._links[-1]
        self._changed = min([newest.serial - 1, *(link.serial - part for link, part in exchanged)])
        if self._far and self._lag < math.inf:
            self._build()
            return
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        removed = [link.slots[part] for link, part in exchanged]
        if new is not None:
            values = new.values
            exchanged = [*exchanged, *((new, part) for part in (0, 1) if new.gaussians[part] is not None)]
            self._first = min(self._first, new.first)
        for link, part in exchanged:
            graph.push_back(link.gaussians[part])
        if new is not None:
            graph.push_back(new.linear)
            graph.push_back(new.linear_back)
        order = self._order(self._changed - links[0].serial)
        result = self._isam.update(graph, values, removed, order, None, None, bool(self._far))
        for (link, part), slot in zip(exchanged, result.getNewFactorsIndices(), strict=False):
            link.slots[part] = slot
        for link in self._far:
            link.turn(_FAR)
        self._far = []

    def _order(self, changed: int) -> gtsam.KeyGroupMap:
        """In the order of time, for an update that changes the steps from a place on."""
        links = self._links
        first = changed - 1 if changed - 1 > (1.0 - _BATCH_SHARE) * len(links) else 0
        # GTSAM takes no group of a greater number than there are variables to eliminate.
        least = len(links[-1].keys) * (len(links) - max(changed, 0))
        shift = max(0, len(links) - first - least)
        order = gtsam.KeyGroupMap()
        for group, link in enumerate(links[first:]):
            for key in link.keys:
                order.insert2(key, max(0, group - shift))
        return order

    def _slide(self) -> None:
        links = self._links
        horizon = links[-1].step.observation.t - self._lag
        while links[0].step.observation.t < horizon:
            gone = gtsam.KeyList()
            for key in links[0].keys:
                gone.push_back(key)
            made, absorbed = self._isam.marginalizeLeavesWithIndices(gone)
            if links[0] in self._moved:
                self._moved.remove(links[0])
            del links[0], self.steps[0]
            links[0].cut()
            self.steps[0] = links[0].step
            self._marginal_slots = (self._marginal_slots - {*absorbed}) | {*made}
            factors: Any = self._isam.getFactorsUnsafe()
            # GTSAM leaves out where they were linearised.
            self._marginals = [
                gtsam.LinearContainerFactor(factors.at(slot).factor(), links[0].begun)
                for slot in sorted(self._marginal_slots)
            ]

    def _build(self) -> None:
        """Eliminate all Gaussians at once, in a new Bayes tree."""
        self._isam, self._far, self._first = self._empty(), [], len(self._rows[0])
        self._marginal_slots = set(range(len(self._marginals)))
        if not self._links:
            return
        graph, values, order = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.KeyGroupMap()
        for factor in self._marginals:
            graph.push_back(factor)
        for group, link in enumerate(self._links):
            link.begin()
            self._first = min(self._first, link.first)
            values.insert(link.values)
            for part in (0, 1):
                if link.gaussians[part] is not None:
                    link.slots[part] = graph.size()
                    graph.push_back(link.gaussians[part])
            graph.push_back(link.linear)
            graph.push_back(link.linear_back)
            for key in link.keys:
                order.insert2(key, group)
        self._isam.update(graph, values, [], order)
        self._changed = self._links[0].serial

    def _hold(self, link: Link) -> None:
        if self._anchor is not None:
            for factor in anchors(link.step, self._model, *self._anchor, _ANCHOR_KAPPA):
                link.own.push_back(factor)

    def _empty(self) -> gtsam.ISAM2:
        thresholds = gtsam.ISAM2ThresholdMap()
        for name, size, threshold in (("x", 2, _NEVER), ("v", 2, _NEVER), ("b", 1, _FAR), ("h", 1, _FAR)):
            thresholds.insert((name, np.full(size, float(threshold))))
        steps = gtsam.ISAM2GaussNewtonParams()
        steps.setWildfireThreshold(_WILDFIRE)
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(thresholds)
        parameters.relinearizeSkip = _NEVER  # but for updates that ask for it
        parameters.setOptimizationParams(steps)
        parameters.findUnusedFactorSlots = self._lag < math.inf
        return gtsam.ISAM2(parameters)

    # -- saved states --------------------------------------------------------------------------------------

    def restore(self, window: Window) -> None:
        """Take over a history as it stands."""
        links: list[Link] = []
        self._anchor = window.anchor
        for serial, step in enumerate(window.steps):
            link = Link(step, self._model, window.values[step.index], serial, self._couplings)
            if not links and window.prior is None:
                self._hold(link)
            link.linearise(links[-1] if links else None)
            links.append(link)
        self._marginals = [] if window.prior is None else [window.prior.factor()]
        self._links, self.steps, self._moved = links, list(window.steps), []
        self._build()
        if links:
            self._read()

    def window(self) -> Window:
        """What another smoother needs to go on from here."""
        points = {link.step.index: link.state(self._model) for link in self._links}
        return Window(tuple(self.steps), points, self._prior(), self._anchor)

    def _prior(self) -> MarginalPrior | None:
        if not self._marginals:
            return None
        values, graph = self._links[0].values, gtsam.NonlinearFactorGraph()
        for factor in self._marginals:
            graph.push_back(factor)
        whole = gtsam.LinearContainerFactor(gtsam.HessianFactor(graph.linearize(values)), values)
        return marginal_prior(whole, values)

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
        rows = arrays["moved"].reshape(len(self._links), len(self._rows[0])).tolist()
        self._moved, self._far = [], []
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
