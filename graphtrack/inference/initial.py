"""Where the optimisers start: the linear solution for positions, a circular running mean for angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.geometry.angles import class_centres, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.linear import linear_part
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.chain.result import Result
from graphtrack.inference.chain.start import Seen, initialise
from graphtrack.model import Model, States
from graphtrack.model.kernels.packing import PackedTracks, RecordTypes
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.observation import require_position, vectors_of
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, Track

WINDOW = 0.5
"""Seconds to either side over which observed angles are averaged for the initial values."""

NO_PRIOR = np.zeros((0, 6))

CREEPING = 0.1
"""m/s up to which a direction of travel does not stand in for an orientation, whatever the threshold."""


def pack(tracks: Sequence[Track], model: Model, camera: GroundCamera | None = None) -> PackedTracks:
    """Tracks end to end, with the records that the model's compiled terms fill in."""
    return PackedTracks.of(tracks, camera, model.compiled_terms, program_of(model).types)


def pack_to_solve(tracks: Sequence[Track], model: Model, camera: GroundCamera | None = None) -> PackedTracks:
    """The same; with the fields of the model's own terms alone where the linear solution is all there is.

    That is a fourth of the memory.
    """
    terms = model.terms  # what holds first orientations has nothing to hold
    if camera is None and not (model.has_body or model.has_head):
        packed = PackedTracks.of(tracks, camera, terms, RecordTypes.of(terms))
        if model.is_linear(packed):
            return packed
    return pack(tracks, model, camera)


def problem_of(packed: PackedTracks) -> Problem:
    """What the kernels read."""
    return Problem(
        packed.records,
        packed.shared,
        packed.body_heights,
        packed.head_heights,
        unit(class_centres(BODY_CLASSES)),
        unit(class_centres(HEAD_CLASSES)),
        packed.origin,
        packed.offsets,
        NO_PRIOR,
    )


def seen_in(packed: PackedTracks, model: Model) -> Seen:
    """What the first orientations are made of."""
    none = np.zeros((0, 2))
    return Seen(
        packed.t,
        vectors_of(packed.directions("body"), packed.channel("body_likelihood"), len(packed.t))
        if model.has_body
        else none,
        vectors_of(packed.directions("head"), packed.channel("head_likelihood"), len(packed.t))
        if model.has_head
        else none,
        max(model.parameters.coupling.speed_threshold, CREEPING),
        WINDOW,
    )


def initial_states(track: Track, model: Model) -> States:
    """Where the optimiser starts; NaN angles for orientations that the model does not have.

    Terms of your own have no part in it: nothing is compiled for them.

    Raises
    ------
    SolveError
        If no position was observed.
    """
    packed = pack([track], Model(model.preset, model.parameters))
    require_position(track)
    states = np.zeros((len(track), 6))
    initialise(linear_part(packed), seen_in(packed, model), np.empty((3, len(track))), states)
    none = np.full(len(track), np.nan)
    return States(
        states[:, :2] + packed.origin[0],
        states[:, 2:4],
        states[:, 4] if model.has_body else none,
        states[:, 5] if model.has_head else none,
    )


def empty_result(packed: PackedTracks) -> Result:
    """Room for the solution of packed tracks."""
    n, m = len(packed.records), len(packed.tracks)
    ended = np.zeros(m, np.int64)
    modes = np.full((n, 3), np.nan)
    covariance = np.empty((n, 6, 6))
    return Result(np.zeros((n, 6)), covariance, np.zeros(m), np.zeros(m), ended.copy(), ended, modes)
