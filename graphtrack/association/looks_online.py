"""Evidence of appearance and detection scores, as it is learned from tracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from graphtrack.association.appearance import AppearanceModel
from graphtrack.association.chains import Chains, IntArray, Scene
from graphtrack.association.looks import (
    ScoreRatio,
    has_descriptor,
    learn_appearance,
    resemblance_of_false_ones,
)
from graphtrack.association.packing import packed, unpacked
from graphtrack.geometry.angles import FloatArray


@dataclass(frozen=True, eq=False)
class Looks:
    """Evidence of appearance and detection scores, as it was learned from tracks.

    Attributes
    ----------
    model : of descriptors; None: none was seen
    constancy : see `resemblance_of_false_ones`
    scores : of the detector
    """

    model: AppearanceModel | None = None
    constancy: float = 0.0
    scores: ScoreRatio = field(default_factory=ScoreRatio)

    def in_scene(self, scene: Scene) -> Scene:
        """A scene that compares looks as the model does."""
        model = self.model
        if model is None:
            return scene
        return scene._replace(
            looks_offset=model.offset, looks_slope=model.slope, looks_outliers=model.outlier
        )

    def in_chains(self, chains: Chains, descriptors: FloatArray) -> Chains:
        """Chains that have descriptors (n, d) as the model compares them."""
        if self.model is None:
            return chains
        return chains._replace(looks=np.ascontiguousarray(self.model.whitened(descriptors)))

    def gain(self, descriptors: FloatArray, score: FloatArray) -> FloatArray:
        """(n,) what detections gain as a person's, beside their places, by what they show.

        ``descriptors``, ``score``: (n, d) and (n,), NaN where one is missing
        """
        less = 0.0 if self.model is None else self.constancy
        return self.scores.of(score) - less * has_descriptor(descriptors)

    def state(self) -> dict[str, Any]:
        """As JSON-able data."""
        model = self.model
        return {
            "model": None
            if model is None
            else [packed(model.whitening), model.offset, model.slope, model.outlier],
            "constancy": self.constancy,
            "scores": [packed(self.scores.edges), packed(self.scores.ratio)],
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Looks:
        """The inverse of `state`."""
        model = None
        if state["model"] is not None:
            whitening, *numbers = state["model"]
            model = AppearanceModel(unpacked(whitening), *numbers)
        return cls(model, state["constancy"], ScoreRatio(*map(unpacked, state["scores"])))


def looks_of_tracks(chains: Chains, identity: IntArray, descriptors: FloatArray, score: FloatArray) -> Looks:
    """Learn it from tracks; arguments as in `constancy` and `ScoreRatio`."""
    scores = ScoreRatio.learned(score, identity)
    if not descriptors.shape[1]:
        return Looks(scores=scores)
    model = learn_appearance(chains, identity, descriptors)
    return Looks(model, resemblance_of_false_ones(chains, identity, model, descriptors), scores)
