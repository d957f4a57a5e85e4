"""Which whole tracks are solved side by side, in vector instructions, and which one by one.

What solves them side by side (`lane_engine`) is several times as fast, and takes as long to compile as all
else of an engine: it is imported, and compiled, for large work alone.
"""

from __future__ import annotations

from collections.abc import Sequence

from graphtrack.inference.chain.programs import OF_PRESETS, program_of
from graphtrack.model import Model
from graphtrack.model.terms.pose_classes import add_classes
from graphtrack.tracks import Track

LARGE = 200_000
"""Person-frames from which work is large."""

LONGEST = 5_000
"""Frames of a track that is solved beside others; those of the longest take 15 kB each."""


def is_large(model: Model, n_frames: int) -> bool:
    """Whether work of so many person-frames is large, and the model one whose tracks can be side by side."""
    return n_frames >= LARGE and has_lanes(model)


def has_lanes(model: Model) -> bool:
    """Whether a model's kernels take lanes, but for those of class likelihoods, which no track may have."""
    if not all(term.is_compiled for term in model.terms) or program_of(model) is not OF_PRESETS:
        return False
    kernels = (kernel for term in model.compiled_terms for kernel in term.kernels)
    return all(kernel.lanes or kernel.function is add_classes for kernel in kernels)


def those_beside(tracks: Sequence[Track], model: Model, n_frames: int | None = None) -> list[bool]:
    """Which tracks are solved side by side.

    Parameters
    ----------
    tracks : to be solved
    model : solves them
    n_frames : of all the work that the tracks are a part of; by default there is no other
    """
    n_frames = sum(map(len, tracks)) if n_frames is None else n_frames
    large = is_large(model, n_frames)
    return [large and len(track) <= LONGEST and not _has_classes(track) for track in tracks]


def _has_classes(track: Track) -> bool:
    return track.body_likelihood is not None or track.head_likelihood is not None
