"""Fitting the parameters of a model: the free ones, on scales without limits, and the search."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Model, Parameters
from graphtrack.model.parameters import range_of, scale_of
from graphtrack.tracks import Track

DECLARED = {"position_scale": "position_std", "body_scale": "body_kappa", "head_scale": "head_kappa"}
"""Multiples of the noise that tracks declare, and the channel of each."""


@dataclass(frozen=True)
class Free:
    """A parameter to be learned: its name, as ``group.key``, and its scale."""

    name: str

    @property
    def is_probability(self) -> bool:
        """Whether it is learned by its log odds; else by its logarithm."""
        return scale_of(*self._place) == "log odds"

    def get(self, model: Model) -> float:
        """Its value in a model."""
        group, key = self.name.split(".")
        return float(getattr(getattr(model.parameters, group), key))

    def to_scale(self, value: float) -> float:
        """Logarithm, or log odds of a probability."""
        value = min(value, self._range[1])
        return math.log(value / (1.0 - value)) if self.is_probability else math.log(value)

    def from_scale(self, x: float) -> float:
        """The inverse of `to_scale`, within what the parameter may be."""
        value = 1.0 / (1.0 + math.exp(-x)) if self.is_probability else math.exp(x)
        low, high = self._range
        return min(max(value, low), high)

    @property
    def _place(self) -> tuple[Any, str]:
        """The group that it is in, and its key there."""
        group, key = self.name.split(".")
        return getattr(Parameters(), group), key

    @property
    def is_learned(self) -> bool:
        """Whether the parameter may be learned."""
        return scale_of(*self._place) is not None

    @cached_property
    def _range(self) -> tuple[float, float]:
        """The least and the greatest value that is tried: it may have both, and neither is out of the way."""
        limits = range_of(*self._place)
        assert limits is not None  # only numbers are learned
        low, high = limits
        return low, min(high, 0.999 if high <= 1.0 else 1e3)


def free_parameters(model: Model, tracks: Sequence[Track]) -> tuple[Free, ...]:
    """Return the parameters to be learned from such tracks; those that are 0 are switched off, and stay so.

    Raise InputError for a term whose parameters cannot be learned.
    """
    for term in model.terms:
        if not term.states("reads"):
            raise InputError(
                f"the term {type(term).__name__}, whose parameters cannot be learned",
                "a preset's terms alone",
            )
    names = dict.fromkeys(name for term in model.terms for name in term.reads or ())
    absent = {
        "likelihood.robust_threshold": model.parameters.likelihood.robust == "none",
        "motion.sway_std": not any(track.has_truth for track in tracks),
        "likelihood.pixel_std": all(track.pixel is None for track in tracks),
        "likelihood.class_outlier_probability": all(
            track.body_likelihood is None and track.head_likelihood is None for track in tracks
        ),
    }
    for name, declared in DECLARED.items():
        absent[f"likelihood.{name}"] = not any(getattr(track, declared) is not None for track in tracks)
    free = (Free(name) for name in names if not absent.get(name, False))
    return tuple(one for one in free if one.is_learned and one.get(model) > 0.0)


def with_values(model: Model, free: Sequence[Free], x: FloatArray) -> Model:
    """The model with the values at ``x`` (p,), on the parameters' scales."""
    parameters = model.parameters
    for one, value in zip(free, x.tolist(), strict=True):
        group, key = one.name.split(".")
        changed = replace(getattr(parameters, group), **{key: one.from_scale(value)})
        parameters = replace(parameters, **{group: changed})
    return model.with_parameters(parameters)
