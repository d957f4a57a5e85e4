"""What looks and scores are worth, as it is learned online and goes with the state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from graphtrack.association import looks
from graphtrack.association.appearance import AppearanceModel
from graphtrack.association.chains import Chains, IntArray, Scene
from graphtrack.association.looks import ScoreRatio
from graphtrack.association.packing import packed, unpacked
from graphtrack.geometry.angles import FloatArray


@dataclass(frozen=True, eq=False)
class Looks:
    """What looks and scores are worth, as it was learned from tracks.

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
        return scene if self.model is None else looks.in_scene(scene, self.model)

    def gain(self, descriptors: FloatArray, score: FloatArray) -> FloatArray:
        """(n,) what detections gain as a person's, beside their places, by what they show.

        Parameters
        ----------
        descriptors, score : (n, d) and (n,), NaN where one is missing
        """
        less = 0.0 if self.model is None else self.constancy
        return self.scores.of(score) - less * looks.known(descriptors)

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


def of_tracks(chains: Chains, identity: IntArray, descriptors: FloatArray, score: FloatArray) -> Looks:
    """What looks and scores are worth in tracks; arguments as in `constancy` and `ScoreRatio`."""
    scores = ScoreRatio.learned(score, identity)
    if not descriptors.shape[1]:
        return Looks(scores=scores)
    model = looks.learned(chains, identity, descriptors)
    return Looks(model, looks.resemblance_of_false_ones(chains, identity, model, descriptors), scores)
