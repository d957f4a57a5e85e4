"""A term's kernels evaluated one by one, from tracks packed whole."""

from typing import Any

import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.layout import BODY, HEAD, Sums
from graphtrack.model import States, Term
from graphtrack.model.kernel import Kernel
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import filled, types_of
from graphtrack.tracks.track import Track


def packed_alone(term: Term, track: Track, camera: GroundCamera | None = None) -> PackedTracks:
    """A track packed by one term."""
    return filled(PackedTracks.of([track], camera, types_of([term])), [term])


def rows_of(states: States) -> np.ndarray:
    """States (n, 6)."""
    return np.column_stack([states.position, states.velocity, states.body, states.head])


def called(term: Term, packed: PackedTracks, k: int) -> list[Kernel]:
    """The kernels that are called at a frame."""
    return [kernel for kernel in term.kernels if kernel.acts(packed.records[k : k + 1])[0]]


def empty_sums() -> tuple[Sums, np.ndarray, np.ndarray]:
    """Sums of zero, and their gradients (2, 6) and Hessians (3, 6, 6)."""
    gradients, hessians = np.zeros((2, 6)), np.zeros((3, 6, 6))
    return Sums(gradients[0], gradients[1], *hessians), gradients, hessians


def evaluate(
    term: Term, packed: PackedTracks, k: int, before: np.ndarray, state: np.ndarray, exact: bool = True
) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost, gradient (12,) and Hessian (12, 12) by the frame before and the frame k, of all kernels."""
    origin = packed.origin[0]
    local = [np.concatenate([row[:2] - origin, row[2:]]) for row in (before, state)]
    sums, gradients, hessians = empty_sums()
    given: dict[str, Any] = {
        **{"at_body": BODY, "at_head": HEAD, "exact": exact, "origin_x": origin[0], "origin_y": origin[1]},
        **{"before": local[0], "state": local[1], "sums": sums},
    }
    for row, suffix in ((local[0], "_before"), (local[1], "")):
        for name, place in (("body", BODY), ("head", HEAD)):
            given[f"{name}_cos{suffix}"] = np.cos(row[place])
            given[f"{name}_sin{suffix}"] = np.sin(row[place])
    for name in ("body", "head"):
        heights = getattr(packed, f"{name}_heights")
        given[f"{name}_heights"] = heights[k] if len(heights) else None
    for record in (packed.records[k], packed.shared[0]):
        given |= {name: record[name] for name in record.dtype.names or ()}
    cost = sum(
        kernel.compiled(*[given[name] for name in kernel.arguments(kernel.compiled)])
        for kernel in called(term, packed, k)
    )
    then, here = (np.tril(half) + np.tril(half, -1).T for half in hessians[:2])
    return cost, gradients.ravel(), np.block([[then, hessians[2]], [hessians[2].T, here]])
