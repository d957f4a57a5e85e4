"""The models of the package, trained on rendered people and judged on others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from perception.body_pose import BodyPose
from perception.classifier import FeatureClassifier
from perception.evaluation import evaluate
from perception.features.skin import SkinColours
from perception.head_pose import Exemplars, Templates
from perception.heads import HeadLocaliser
from perception.images import intersection_over_union
from perception.labels import read_labelled
from perception.models import NAMES, model_path
from perception.synthetic import HeadVariation, PedestrianSet, make_heads, make_pedestrians

_SKIN_IMAGES = 2000
_HEADS = "rendered heads of 16-32 pixels; every one another person, light and camera"
_PEOPLE = "rendered people of 70-140 pixels; every one another person, light and camera"
_REAL = "not judged on real pictures here; "


def train_on_rendered(
    name: str, *, images: int = 6000, test_images: int = 600, seed: int = 0
) -> FeatureClassifier | HeadLocaliser:
    """Train a model by name on ``images`` rendered crops; its card tells of ``test_images`` other ones.

    Raises
    ------
    InputError
        If there is no model of that name.
    """
    if name not in NAMES:
        raise InputError(f"model {name!r}", f"one of {', '.join(NAMES)}")
    rng, other = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    if name == BodyPose.kind:
        return _body_pose(make_pedestrians(images, rng), make_pedestrians(test_images, other), seed)
    if name == HeadLocaliser.kind:
        return _localiser(make_pedestrians(images, rng), make_pedestrians(test_images, other), seed)
    heads = make_heads(images, rng, HeadVariation(tilt_deviation=None))
    judged = make_heads(test_images, other)
    model: FeatureClassifier
    if name == Templates.kind:
        skin = SkinColours.fit(heads.images[:_SKIN_IMAGES], heads.skin[:_SKIN_IMAGES])
        model = Templates(seed=seed, skin=skin, metric="fisher")
    else:
        model = Exemplars(seed=seed, exemplars=10)
    model.fit(heads.images, model.classes.index(heads.pan, heads.tilt))
    _complete_card(model, _HEADS, evaluate(model, judged.images, judged.pan).figures())
    return model


def train_on_files(
    name: str, folder: str | Path, labels: str | Path, *, seed: int = 0
) -> FeatureClassifier | HeadLocaliser:
    """Train a model by name on a user's images.

    The CSV has the columns ``image`` and: ``pan_deg`` and ``tilt_deg`` for head pose, ``body_deg`` for body
    pose (0 faces the camera, 90 the right of the image), or ``left``, ``top``, ``width`` and ``height`` of
    the head in pixels for the head localiser, whose images are crops of people.

    Raises
    ------
    InputError
        If there is no model of that name, or the files cannot be used.
    """
    if name not in NAMES:
        raise InputError(f"model {name!r}", f"one of {', '.join(NAMES)}")
    model: FeatureClassifier | HeadLocaliser
    if name == HeadLocaliser.kind:
        given = read_labelled(folder, labels, ("left", "top", "width", "height"))
        model = HeadLocaliser(seed=seed).fit(given.images, given.values)
    elif name == BodyPose.kind:
        given = read_labelled(folder, labels, ("body_deg",))
        model = BodyPose(seed=seed)
        model.fit(given.images, model.classes.index(np.deg2rad(given.values[:, 0])))
    else:
        given = read_labelled(folder, labels, ("pan_deg", "tilt_deg"))
        model = Exemplars(seed=seed)
        if name == Templates.kind:
            # Skin is a matter of masks, which these labels lack: the colours of the package's model serve.
            shipped = Templates.load(model_path(Templates.kind))
            model = Templates(seed=seed, skin=shipped.skin, metric="fisher")
        model.fit(given.images, model.classes.index(*np.deg2rad(given.values).T))
    model.card = replace(model.card, trained_on=f"the images that {Path(labels).name} names")
    return model


def _body_pose(people: PedestrianSet, judged: PedestrianSet, seed: int) -> BodyPose:
    model = BodyPose(seed=seed)
    model.fit(people.images, model.classes.index(people.body))
    _complete_card(model, _PEOPLE, evaluate(model, judged.images, judged.body).figures())
    return model


def _localiser(people: PedestrianSet, judged: PedestrianSet, seed: int) -> HeadLocaliser:
    model = HeadLocaliser(seed=seed).fit(people.images, people.head_box)
    _complete_card(model, _PEOPLE, localisation_figures(model, judged))
    return model


def localisation_figures(model: HeadLocaliser, people: PedestrianSet) -> dict[str, float]:
    """The three numbers of 002's Table 1: overlap of the first candidate, best of all, candidates."""
    found = [model.locate(image) for image in people.images]
    first, best = [], []
    for candidates, true in zip(found, people.head_box, strict=True):
        overlap = intersection_over_union(candidates.boxes, true)
        first.append(overlap[0])
        best.append(overlap.max())
    return {
        "overlap_of_first": float(np.mean(first)),
        "best_overlap_of_all": float(np.mean(best)),
        "candidates": float(np.mean([len(candidates.boxes) for candidates in found])),
    }


def _complete_card(
    model: FeatureClassifier | HeadLocaliser, trained_on: str, figures: dict[str, float]
) -> None:
    fails = "views from straight above, people bent or sitting, heads below 12 pixels, boxes off by a quarter"
    model.card = replace(
        model.card,
        trained_on=trained_on,
        fails_when=_REAL + fails,
        figures={**model.card.figures, **figures},
    )
