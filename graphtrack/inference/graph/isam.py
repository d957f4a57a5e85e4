"""iSAM2 of one person, over the full history or in a window, on the model's variables and factors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.graph.batch import anchors, joint_covariance, variable_keys
from graphtrack.inference.graph.chain_view import is_ambiguous
from graphtrack.inference.prior import MarginalPrior, marginal_prior
from graphtrack.inference.state import Angles, Newest, Window, finite, insert_step, present, read_step
from graphtrack.later import gtsam
from graphtrack.model import Model, Step
from graphtrack.model.factors.custom import variable_dimension
from graphtrack.model.factors.derived import Couplings
from graphtrack.model.kernels.layout import TIME_TOLERANCE

ANCHOR_KAPPA = 1e-4
"""Concentration at which first orientations are held. GTSAM's Bayes tree refuses a clique whose last pivot is
less than 2⁻²⁴ of the one before, as between turning and a weaker anchor in the frames of a video."""

_WILDFIRE = 1e-6
"""Metres, m/s or radians, below which GTSAM does not go on substituting into the past."""
_OF_CLASSES = 0.1
"""Share of the threshold at which orientations are linearised again once class likelihoods have been seen:
their peaks are sharper than what an observed angle says."""
_WATCHED = 50
"""Newest steps of which some has to be beyond the threshold for a further update."""


class Isam2:
    """An iSAM2 smoother of one person.

    Each step adds `X(k)`, `V(k)`, `B(k)` and `H(k)` and the nonlinear factors of its terms to one
    `gtsam.ISAM2`, which relinearises a variable where its estimate is farther from its linearisation point
    than the threshold of its kind.

    With a lag, the variables of steps that leave the window are marginalised by `ISAM2.marginalizeLeaves`:
    what they say about the step after them stays as a Gaussian. For that they have to be leaves of the Bayes
    tree, so that the window's variables are eliminated again, beginning with them. Time and memory are
    bounded by the window then. Without a lag the tree is GTSAM's own, and memory grows with the track.

    Whatever a method raises, it leaves the smoother with the steps of before, at their linearisation points.

    Parameters
    ----------
    model : the terms
    lag : seconds that the window reaches back from its newest step; infinite: all history
    relinearize_threshold : change of a variable beyond which it is linearised again (metres, m/s, radians)
    step_tolerance : the updates for an observation end when no variable is farther than this, or than the
        threshold, from where it was linearised
    max_iterations : or after so many
    couplings : what the modes of the couplings set, of each step; see `recoupled`
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
        self._model, self._lag, self._couplings = model, lag, couplings
        self._threshold, self._max_iterations = relinearize_threshold, max_iterations
        self._tolerance = max(relinearize_threshold, step_tolerance)
        self._classified = False
        self._steps: list[Step] = []
        self._anchor: Angles | None = None
        self._custom: dict[int, dict[int, gtsam.CustomFactor]] = {}
        self._marginals: set[int] = set()
        self._keys: dict[int, list[int]] = {}
        self._waiting: Window | None = Window((), {}, None, None)
        self._build_waiting()

    @property
    def steps(self) -> Sequence[Step]:
        """The steps of the window, oldest first."""
        return self._steps

    @property
    def isam(self) -> gtsam.ISAM2:
        """GTSAM's smoother; to look at, not to be changed."""
        return self._isam

    def state(self, step: Step) -> tuple[float, ...]:
        """x, y, vx, vy, body, head of a step; NaN for what the model does not have."""
        if self._waiting is not None:
            return self._waiting.values[step.index]
        isam, nan = self._isam, math.nan
        return (
            *isam.calculateEstimatePoint2(step.position_key).tolist(),
            *isam.calculateEstimateVector(step.velocity_key).tolist(),
            isam.calculateEstimateRot2(step.body_key).theta() if self._model.has_body else nan,
            isam.calculateEstimateRot2(step.head_key).theta() if self._model.has_head else nan,
        )

    # -- observations --------------------------------------------------------------------------------------

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; what is known about it then."""
        if is_ambiguous(step) and not self._classified:
            self._waiting, self._classified = self.window(), True
        self._build_waiting()
        before = self._anchor
        try:
            self._anchor = before if self._steps else (state[4], state[5])
            values = gtsam.Values()
            insert_step(values, step, self._model, state)
            factors = self._factors_of(step)
            self._steps.append(step)
            self._keys[step.index] = variable_keys(step, self._model)
            self._note(step, factors, self._update(factors, values))
            self._slide()
            return self._settled()
        except BaseException:
            if self._steps and self._steps[-1] is step:
                self._steps.pop()
            self._anchor = before
            self._waiting = self.window()
            raise

    def recoupled(self, steps: Sequence[Step]) -> Newest:
        """Evaluate the couplings of some steps anew; what is known about the newest step then."""
        self._build_waiting()
        exchanged = [entry for step in steps for entry in self._custom[step.index].items()]
        graph = [factor for _, factor in exchanged]
        try:
            indices = self._update(graph, removed=[slot for slot, _ in exchanged])
            places = iter(zip(indices, graph, strict=True))
            for step in steps:
                self._custom[step.index] = dict(next(places) for _ in self._custom[step.index])
            return self._settled()
        except BaseException:
            self._waiting = self.window()
            raise

    def rework(self, window: Window) -> Newest:
        """Take over a window that was changed; what is known about its newest step then."""
        before = dict(vars(self))
        try:
            self.restore(window)
            self._build_waiting()
            return self._settled()
        except BaseException:
            vars(self).update(before)
            raise

    # -- iSAM2 ---------------------------------------------------------------------------------------------

    def _factors_of(self, step: Step) -> list[gtsam.NonlinearFactor]:
        """The factors that arrive with a step; with those that hold the orientations of the first."""
        factors = self._model.factors(step, self._couplings)
        if step.dt is None and self._anchor is not None:
            body, head = self._anchor
            factors += anchors(step, self._model, body, head, ANCHOR_KAPPA)
        return factors

    def _note(self, step: Step, factors: Sequence[gtsam.NonlinearFactor], indices: Sequence[int]) -> None:
        """Remember at which indices of iSAM2's factors those of a step are that may read couplings."""
        pairs = zip(indices, factors, strict=True)
        self._custom[step.index] = {
            index: factor for index, factor in pairs if isinstance(factor, gtsam.CustomFactor)
        }

    def _update(
        self,
        factors: Sequence[gtsam.NonlinearFactor] = (),
        values: gtsam.Values | None = None,
        removed: Sequence[int] = (),
    ) -> list[int]:
        """One update of iSAM2; the indices of the new factors."""
        values = gtsam.Values() if values is None else values
        # The newest variables last: the root of the tree is where the next observation comes in.
        order, again, leaving = gtsam.KeyGroupMap(), gtsam.KeyList(), self._n_leaving()
        for key in self._keys[self._steps[-1].index]:
            order.insert2(key, 2 if leaving else 1)
        if leaving:
            for i, step in enumerate(self._steps[:-1]):
                for key in self._keys[step.index]:
                    order.insert2(key, 0 if i < leaving else 1)
                    again.push_back(key)
        graph = gtsam.NonlinearFactorGraph()
        for factor in factors:
            graph.push_back(factor)
        result = self._isam.update(graph, values, list(removed), order, None, again, True)
        return list(result.getNewFactorsIndices())

    def _settled(self) -> Newest:
        """What is known about the newest step, once none is too far from where it was linearised."""
        for _ in range(self._max_iterations - 1):
            if not self._farthest() * self._threshold > self._tolerance:
                break
            self._update()
        newest = self._steps[-1]
        state, keys = finite(self.state(newest)), self._keys[newest.index]
        return state, joint_covariance(self._isam.jointMarginalCovariance(keys), keys, self._model)

    def _farthest(self) -> float:
        """Greatest distance of the newest steps from their linearisation points, in thresholds.

        The first step of a window does not count: what has left it holds its linearisation point. Without a
        lag `_WATCHED` steps count.
        """
        begin = 1 if self._marginals else 0
        if self._lag == math.inf:
            begin = max(begin, len(self._steps) - _WATCHED)
        steps = self._steps[begin:]
        keys = [key for step in steps for key in self._keys[step.index]]
        far = np.abs(self._isam.getDelta().vector(keys)).reshape(len(steps), len(self._limits)) / self._limits
        if not np.isfinite(far).all():
            raise ArithmeticError("a step of the solver is not finite")
        return float(far.max(initial=0.0))

    def _n_leaving(self) -> int:
        """How many steps leave the window now that the newest one is there."""
        if not self._steps:
            return 0
        horizon = self._steps[-1].observation.t - self._lag - TIME_TOLERANCE
        return next(i for i, step in enumerate(self._steps) if step.observation.t >= horizon)

    def _slide(self) -> None:
        """Marginalise the steps that leave the window."""
        gone = self._steps[: self._n_leaving()]
        if not gone:
            return
        keys = gtsam.KeyList()
        for step in gone:
            for key in self._keys[step.index]:
                keys.push_back(key)
        made, absorbed = self._isam.marginalizeLeavesWithIndices(keys)
        for step in gone:
            del self._custom[step.index], self._keys[step.index]
        self._marginals = self._marginals - {*absorbed} | {*made}
        del self._steps[: len(gone)]
        # Its links to the step before are part of the marginals now.
        self._steps[0] = first = self._steps[0].alone()
        there = self._isam.getFactorsUnsafe()
        own = self._custom[first.index]
        self._custom[first.index] = {i: factor for i, factor in own.items() if there.exists(i)}

    def _build_waiting(self) -> None:
        """Begin anew with a window that waits for it; if its factors raise, it goes on waiting."""
        window = self._waiting
        if window is None:
            return
        angle = self._threshold * (_OF_CLASSES if self._classified else 1.0)
        thresholds = np.array([self._threshold] * 4 + [angle] * 2)
        isam, values = gtsam.ISAM2(_parameters(thresholds)), gtsam.Values()
        self._steps, self._anchor = list(window.steps), window.anchor
        marginals = [] if window.prior is None else [_firm(window.prior).factor()]
        factors = [self._factors_of(step) for step in window.steps]
        graph = gtsam.NonlinearFactorGraph()
        for factor in (*marginals, *(factor for own in factors for factor in own)):
            graph.push_back(factor)
        for step in window.steps:
            insert_step(values, step, self._model, window.values[step.index])
        indices = iter(isam.update(graph, values).getNewFactorsIndices() if window.steps else ())
        self._isam, self._waiting = isam, None
        self._limits = thresholds[present(self._model)]
        # As long as somebody holds GTSAM's values, it hands custom factors these and not a copy of all.
        self._held = isam.getLinearizationPoint()
        self._marginals, self._custom = {next(indices) for _ in marginals}, {}
        self._keys = {step.index: variable_keys(step, self._model) for step in window.steps}
        for step, own in zip(window.steps, factors, strict=True):
            self._note(step, own, [next(indices) for _ in own])

    # -- saved states --------------------------------------------------------------------------------------

    def restore(self, window: Window) -> None:
        """Take over a history as it stands."""
        self._classified = any(map(is_ambiguous, window.steps))
        self._steps, self._anchor, self._waiting = list(window.steps), window.anchor, window

    def window(self) -> Window:
        """What another smoother needs to go on from here: the linearisation points are its values."""
        if self._waiting is not None:
            return self._waiting
        points = self._isam.getLinearizationPoint()
        values = {step.index: read_step(points, step, self._model) for step in self._steps}
        return Window(tuple(self._steps), values, self.prior(), self._anchor)

    def prior(self) -> MarginalPrior | None:
        """What has left the window says about its first step, about where that is linearised."""
        if self._waiting is not None:
            return self._waiting.prior
        if not self._marginals:
            return None
        points, factors = self._isam.getLinearizationPoint(), self._isam.getFactorsUnsafe()
        graph = gtsam.GaussianFactorGraph()
        for index in self._marginals:
            graph.push_back(factors.at(index).linearize(points))
        return marginal_prior(gtsam.LinearContainerFactor(gtsam.HessianFactor(graph), points), points)

    def arrays(self) -> dict[str, FloatArray]:
        """Nothing: GTSAM keeps its Bayes tree; what is built again is the same but for rounding."""
        return {}

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Go on where `window` was taken."""
        del arrays
        self.restore(window)


def _parameters(thresholds: FloatArray) -> gtsam.ISAM2Params:
    """What GTSAM is told; ``thresholds`` (6,) are those of a state's coordinates."""
    by_kind = gtsam.ISAM2ThresholdMap()
    for letter, part in (("x", slice(0, 2)), ("v", slice(2, 4)), ("b", slice(4, 5)), ("h", slice(5, 6))):
        by_kind.insert((letter, thresholds[part]))
    optimisation = gtsam.ISAM2GaussNewtonParams()
    optimisation.setWildfireThreshold(_WILDFIRE)
    parameters = gtsam.ISAM2Params()
    parameters.relinearizeSkip = 1
    parameters.setRelinearizeThreshold(by_kind)
    parameters.setOptimizationParams(optimisation)
    parameters.findUnusedFactorSlots = True
    return parameters


def _firm(prior: MarginalPrior) -> MarginalPrior:
    """A prior that holds orientations by no less than `ANCHOR_KAPPA`: other engines may."""
    information, place = prior.information.copy(), 0
    for key in prior.keys:
        size = variable_dimension(key)
        if size == 1:
            information[place, place] = max(information[place, place], ANCHOR_KAPPA)
        place += size
    return MarginalPrior(prior.keys, prior.point, information, prior.linear, prior.constant)
