"""Models of one camera: head localisation, body and head orientation; in one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Model
from perception.adaptation.directions import (
    BODY,
    CLASSES,
    HEAD,
    HEAD_HEIGHT,
    HEAD_WIDTH,
    OUTLIERS,
    DirectionModel,
    HeadTemplates,
    with_outliers,
)
from perception.adaptation.labels import patch_of
from perception.ground.upright import LeaningPose, upright_picture
from perception.images.pixels import Image
from perception.pose.head_detection import HeadCandidates
from perception.storage import ModelCard, Stored

_SCALE = 6.0  # log ratio of a candidate that counts as a score of 1 along a track


@dataclass(eq=False)
class CameraModels(Stored):
    """Models fitted to one camera.

    Attributes
    ----------
    templates : of heads; None: boxes are used unaligned
    body, head : the models of the directions
    size : columns and rows of the frames
    upright : whether training people were rotated upright, by `LeaningView`
    """

    kind: ClassVar[str] = "camera"

    templates: HeadTemplates | None
    place: FloatArray
    body: DirectionModel
    head: DirectionModel
    size: tuple[int, int]
    card: ModelCard
    upright: bool = False

    classes = CLASSES

    def candidates(self, patch: Image) -> HeadCandidates:
        """Return head candidates in a patch, best first, in heights of the box from the middle of its top."""
        if self.templates is not None:
            return self.templates.candidates(patch)
        left, top = self.place - np.array([HEAD_WIDTH, HEAD_HEIGHT]) / 2.0
        return HeadCandidates(np.array([[left, top, HEAD_WIDTH, HEAD_HEIGHT]]), np.zeros(1))

    def look(
        self,
        image: Image,
        boxes: Sequence[tuple[float, float, float, float]],
        standing: Sequence[LeaningPose | None] | None = None,
    ) -> list[tuple[FloatArray, HeadCandidates, FloatArray]]:
        """Return, per box, the body's log likelihoods (8,), heads in its crop, and theirs (k, 8).

        ``standing`` gives the pose of leaning people; their heads are in the crop of the rotated image.

        Raises
        ------
        InputError
            If the size of the frame differs from the training frames.
        """
        size = (image.shape[1], image.shape[0])
        if size != self.size:
            raise InputError(
                f"a frame of {size[0]} × {size[1]} pixels",
                f"{self.size[0]} × {self.size[1]}, as of the camera of --models",
            )
        pictures = [
            upright_picture(image, box, how)
            for box, how in zip(boxes, standing or [None] * len(boxes), strict=True)
        ]
        return self.look_at([patch_of(*one) for one in pictures], [box for _, box in pictures])

    def look_at(
        self, patches: Sequence[Image], boxes: Sequence[tuple[float, float, float, float]]
    ) -> list[tuple[FloatArray, HeadCandidates, FloatArray]]:
        """Apply `look` to boxes and their surroundings, as from `patch_of`."""
        if not patches:
            return []
        found = [self.candidates(patch) for patch in patches]
        middles = [one.boxes[:, :2] + one.boxes[:, 2:] / 2.0 for one in found]
        bodies = BODY.all_features(patches, [heads[0] for heads in middles])
        each = [patch for patch, heads in zip(patches, middles, strict=True) for _ in heads]
        heads = HEAD.all_features(each, np.concatenate(middles))
        body = self.body.log_likelihoods(bodies, BODY.sign)
        head = np.split(
            self.head.log_likelihoods(heads, HEAD.sign), np.cumsum([len(one) for one in middles])[:-1]
        )
        return [
            (of_body, in_crop(one, box), of_head)
            for of_body, one, of_head, box in zip(body, found, head, boxes, strict=True)
        ]

    @property
    def class_outlier_probability(self) -> float | None:
        """Share of uninformative class likelihoods in the graph; None: not known, as in older files."""
        share = self.card.parameters.get(OUTLIERS)
        return None if share is None else float(share)

    def graph(self, model: Model) -> Model:
        """Return the graph with the outlier share that was fitted to held-out people."""
        share = self.class_outlier_probability
        return model if share is None else with_outliers(model, share)

    def parameters(self) -> dict[str, Any]:
        """Size of the frames, and calibrations."""
        of_parts = {
            name: {"temperature": part.temperature, "share": part.share, "seen": part.observed.tolist()}
            for name, part in (("body", self.body), ("head", self.head))
        }
        return {"size": list(self.size), "upright": self.upright, **of_parts}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Templates and weights."""
        found: dict[str, NDArray[Any]] = {"place": self.place}
        for name, part in (("body", self.body), ("head", self.head)):
            found |= {f"{name}_weight": part.weight, f"{name}_bias": part.bias}
        if self.templates is not None:
            found |= {
                "template_weight": self.templates.weight,
                "template_bias": self.templates.bias,
                "template_place": self.templates.place,
            }
        return found

    @classmethod
    def restored(cls, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Self:
        """Load the models of a file."""
        parts = {}
        for name in ("body", "head"):
            given = card.parameters[name]
            parts[name] = DirectionModel(
                arrays[f"{name}_weight"],
                arrays[f"{name}_bias"],
                float(given["temperature"]),
                float(given["share"]),
                np.array(given["seen"], bool),
            )
        templates = None
        if "template_weight" in arrays:
            templates = HeadTemplates(*(arrays[f"template_{name}"] for name in ("weight", "bias", "place")))
        width, height = (int(value) for value in card.parameters["size"])
        upright = bool(card.parameters.get("upright", False))
        return cls(templates, arrays["place"], parts["body"], parts["head"], (width, height), card, upright)


def in_crop(heads: HeadCandidates, box: tuple[float, float, float, float]) -> HeadCandidates:
    """Convert candidates of a patch to pixels of the box's crop."""
    left, top, width, height = box
    start = np.array([left - round(left) + width / 2.0, top - round(top), 0.0, 0.0])
    return HeadCandidates(heads.boxes * height + start, heads.scores / _SCALE)
