"""Gaussians for iSAM2: a step's terms, linearised by the chain's kernels, or by GTSAM."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.frame_rows import FrameRows
from graphtrack.inference.chain.gaussians import linearise
from graphtrack.inference.graph.batch import anchors, variable_keys
from graphtrack.inference.graph.links import Link
from graphtrack.inference.state import present
from graphtrack.later import gtsam
from graphtrack.model import Model
from graphtrack.model.factors.derived import COUPLED, Couplings
from graphtrack.model.kernels.layout import PLACES, N

ANCHOR_KAPPA = 1e-4
"""Concentration at which first orientations are held. GTSAM's Bayes tree refuses a clique whose last pivot is
less than 2⁻²⁴ of the one before, as between turning and a weaker anchor in the frames of a video."""


@dataclass(frozen=True)
class Beginning:
    """Where a smoother began.

    Attributes
    ----------
    origin : metres, what positions among the coordinates of links are counted from
    turns : radians, what the first orientations are held to
    """

    origin: tuple[float, float] = (0.0, 0.0)
    turns: tuple[float, float] = (0.0, 0.0)

    def coordinates(self, state: Sequence[float], model: Model) -> list[float]:
        """The coordinates of a state of six that a model has."""
        left, bottom = self.origin
        counted = (state[0] - left, state[1] - bottom, *state[2:])
        return [counted[i] for i in present(model)]


class Linearizer(Protocol):
    """What makes a smoother's Gaussians; its links stand one after another in time."""

    def begin(self, links: Sequence[Link], beginning: Beginning) -> None:
        """Take these links, and no others, from now on."""

    def add(self, link: Link, links: Sequence[Link]) -> None:
        """Take one more link, after ``links``."""

    def linearise(self, places: Sequence[int], links: Sequence[Link]) -> None:
        """Make the Gaussians of some of the links anew, at their points."""


class KernelLinearizer:
    """The steps as packed frames in arrays, linearised by one call of compiled code.

    Parameters
    ----------
    model : a chain of the presets' kernels
    couplings : what the modes of the couplings set, of each step
    """

    def __init__(self, model: Model, couplings: Couplings | None) -> None:
        self._model, self._couplings = model, couplings
        self._frames = FrameRows(model)
        if couplings is not None:
            self._coupled = [self._frames.place[name] for name in COUPLED]
        self._present = present(model)
        self._columns = slice(None) if len(self._present) == N else self._present
        self._bent = [
            (term, kernel.gate, kernel.switched and model.has_modes, _first(kernel, self._present))
            for term in model.compiled_terms
            for kernel in term.kernels
        ]
        self.begin((), Beginning())

    def begin(self, links: Sequence[Link], beginning: Beginning) -> None:
        """Take these links, and no others, from now on."""
        self._start = np.array([0.0] * 4 + [a if math.isfinite(a) else 0.0 for a in beginning.turns])
        self._allocate(max(64, 2 * len(links)), np.array(beginning.origin))
        for k, link in enumerate(links):
            self.add(link, links[:k])

    def add(self, link: Link, links: Sequence[Link]) -> None:
        """Take one more link, after ``links``."""
        row = links[-1].terms + 1 if links else 0
        if row == len(self._states):
            self._make_room(links)
            row = len(links)
        link.terms = row
        step = link.step
        packed = self._frames.put(row, step)
        record, place = self._frames.rows[row], self._frames.place
        if step.dt is None:
            for gate, has in (("body_anchor", self._model.has_body), ("head_anchor", self._model.has_head)):
                record[place[gate]] = ANCHOR_KAPPA if has else record[place[gate]]
        link.first = len(link.began)
        for term, gate, switched, first in self._bent:
            if (switched or record[place[gate]] > 0.0) and first < link.first and not term.is_linear(packed):
                link.first = first

    def linearise(self, places: Sequence[int], links: Sequence[Link]) -> None:
        """Make the Gaussians of some of the links anew, at their points."""
        rows = np.array([links[i].terms for i in places])
        for i in {*places, *(i - 1 for i in places if i)}:
            link = links[i]
            self._states[link.terms, self._columns] = link.linearised
            self._zeros[link.terms, self._columns] = link.began
        if self._couplings is not None:
            for i in places:
                link = links[i]
                link.coupled = self._couplings[link.step.index]
                self._frames.rows[link.terms, self._coupled] = link.coupled
        blocks, vectors = np.empty((len(rows), 4, N, N)), np.empty((len(rows), 3, N))
        linearise(self._frames.problem, rows, self._start, self._states, self._zeros, blocks, vectors)
        if len(self._present) < N:
            blocks = blocks[:, :, self._present][..., self._present]
            vectors = vectors[..., self._present]
        for i, block, vector in zip(places, blocks, vectors, strict=True):
            links[i].gaussians = gaussians(block, vector, links[i - 1] if i else None, links[i])

    def _allocate(self, n: int, origin: FloatArray) -> None:
        self._states, self._zeros = np.zeros((n, N)), np.zeros((n, N))
        self._frames.make(n, origin, np.array([0, n]), np.zeros((0, N)))

    def _make_room(self, links: Sequence[Link]) -> None:
        """Move the links to the front of the arrays, or into larger ones."""
        rows = slice(links[0].terms, links[-1].terms + 1)
        old, problem = self._of_frames(), self._frames.problem
        if 2 * len(links) > len(self._states):
            self._allocate(4 * len(links), problem.origin[0])
            self._frames.problem.shared[:] = problem.shared
        for new, previous in zip(self._of_frames(), old, strict=True):
            new[: len(links)] = previous[rows].copy()
        for row, link in enumerate(links):
            link.terms = row

    def _of_frames(self) -> tuple[np.ndarray, ...]:
        problem = self._frames.problem
        return problem.records, problem.body_heights, problem.head_heights


def _first(kernel: Any, present: Sequence[int]) -> int:
    """The first coordinate, of those present, that a kernel depends on."""
    places = [PLACES[name].start for name in (*kernel.variables, *kernel.before)]
    return min((present.index(place) for place in places if place in present), default=len(present))


class FactorLinearizer:
    """The steps' terms as GTSAM's factors, which GTSAM linearises: for any list of terms.

    Parameters
    ----------
    model : the terms
    couplings : what the modes of the couplings set, of each step
    """

    def __init__(self, model: Model, couplings: Couplings | None) -> None:
        self._model, self._couplings = model, couplings

    def begin(self, links: Sequence[Link], beginning: Beginning) -> None:
        """Take these links, and no others, from now on."""
        self._beginning = beginning
        for k, link in enumerate(links):
            self.add(link, links[:k])

    def add(self, link: Link, links: Sequence[Link]) -> None:
        """Take one more link, after ``links``."""
        del links
        own, back = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
        keys = variable_keys(link.step, self._model)
        for factor in self._model.factors(link.step, self._couplings):
            (own if all(key in keys for key in factor.keys()) else back).push_back(factor)  # noqa: SIM118
        if link.step.dt is None:
            for factor in anchors(link.step, self._model, *self._beginning.turns, ANCHOR_KAPPA):
                own.push_back(factor)
        link.terms, link.first = (own, back), 0

    def linearise(self, places: Sequence[int], links: Sequence[Link]) -> None:
        """Make the Gaussians of some of the links anew, at their points."""
        for i in places:
            link, previous = links[i], links[i - 1] if i else None
            own, back = link.terms
            if self._couplings is not None:
                link.coupled = self._couplings[link.step.index]
            n = len(link.began)
            blocks, vectors = np.zeros((4, n, n)), np.zeros((3, n))
            blocks[0], vectors[0] = self._dense(own, [link])
            if previous is not None:
                whole, vector = self._dense(back, [previous, link])
                blocks[1], blocks[2], blocks[3] = whole[:n, :n], whole[:n, n:], whole[n:, n:]
                vectors[1], vectors[2] = vector[:n], vector[n:]
            link.gaussians = gaussians(blocks, vectors, previous, link)

    def _dense(
        self, graph: gtsam.NonlinearFactorGraph, links: Sequence[Link]
    ) -> tuple[FloatArray, FloatArray]:
        """Λ and η of factors on the variables of some links, as differences from where these began."""
        values, order = gtsam.Values(), []
        linear = gtsam.GaussianFactorGraph()
        for link in links:
            keys, numbers = variable_keys(link.step, self._model), link.linearised
            values.insert(keys[0], np.add(numbers[:2], self._beginning.origin))
            values.insert(keys[1], np.array(numbers[2:4]))
            for key, angle in zip(keys[2:], numbers[4:], strict=True):
                values.insert(key, gtsam.Rot2(angle))
            for i, key in enumerate(keys):
                size = 2 if i < 2 else 1
                # So that each variable has its place, whether or not a factor is about it.
                linear.push_back(gtsam.HessianFactor(key, np.zeros((size, size)), np.zeros(size), 0.0))
            order += keys
        linear.push_back(graph.linearize(values))
        information, vector = linear.hessian(gtsam.Ordering(order))
        return information, np.ravel(vector) + information @ np.concatenate([link.point for link in links])


def gaussians(
    blocks: FloatArray, vectors: FloatArray, previous: Link | None, link: Link
) -> tuple[gtsam.LinearContainerFactor, gtsam.LinearContainerFactor | None]:
    """GTSAM's factors of what `chain.gaussians.linearise` writes, in the coordinates that there are.

    Without a point of linearisation GTSAM takes them as they are.
    """
    own = gtsam.HessianFactor(link.key, blocks[0], vectors[0], 0.0)
    if previous is None:
        return gtsam.LinearContainerFactor(own), None
    between = gtsam.HessianFactor(
        previous.key, link.key, blocks[1], blocks[2], vectors[1], blocks[3], vectors[2], 0.0
    )
    return gtsam.LinearContainerFactor(own), gtsam.LinearContainerFactor(between)
