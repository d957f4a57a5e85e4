"""The models of the package, trained on rendered people and judged on others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from perception.images.pixels import intersection_over_union
from perception.models import CLASSIFIERS, NAMES, model_path
from perception.pose.body import BodyPose
from perception.pose.classes import PoseClasses
from perception.pose.classifier import FeatureClassifier
from perception.pose.features.skin import SkinColours
from perception.pose.head_pose import DeepBelief, Exemplars, Templates
from perception.pose.heads import HeadLocaliser
from perception.pose.keypoints.model import KeypointPose
from perception.pose.scores import evaluate
from perception.synthetic import (
    HeadSet,
    HeadVariation,
    PedestrianSet,
    PedestrianVariation,
    draw_poses,
    make_heads,
    make_pedestrians,
)
from perception.trackers.mixed_state.exemplars import HeadExemplars
from perception.training.head_exemplars import train_head_exemplars
from perception.training.keypoints import train_keypoints
from perception.training.labels import read_labelled

COUNTS = {
    "templates": 8000,
    "exemplars": 20000,
    "deep_belief": 50000,
    "body_pose": 6000,
    "head_localiser": 1000,
    "head_exemplars": 7680,
    "keypoints": 200_000,
}
"""Rendered images, or skeletons, that the models of the package are trained on."""

PUBLISHED = (BodyPose.kind, Templates.kind, HeadLocaliser.kind)
"""Models of Chen et al. 2011, which are there as it has printed them, too."""
AS_PUBLISHED = (*PUBLISHED, Exemplars.kind, HeadExemplars.kind)
"""The same, and those of Ba & Odobez 2003."""

FOUND = HeadVariation(size=(10, 32), offset=0.07, scale=0.12, tilt_deviation=0.45)
"""Heads as the localiser boxes them (its errors were measured), small ones too."""

FOUND_AS_WALKING = replace(FOUND, tilt_deviation=0.35)
"""The same with tilts as of walking people, to judge with."""

FAR = PedestrianVariation(
    size=(24, 80),
    elevation=(0.0, 0.8),
    occluded=0.25,
    floor=0.35,
    offset=0.05,
    scale=0.1,
    blur=0.6,
    cluttered=0.8,
)
"""People in wide-angle views: small, blurred, seen from above, behind things and before a busy background."""

_HEAD_POSE: dict[str, Callable[[], FeatureClassifier]] = {
    kind.kind: kind for kind in (Templates, Exemplars, DeepBelief)
}
_EXACT = HeadVariation(offset=0.03, scale=0.05, tilt_deviation=0.45)
_SKIN_IMAGES = 2000
_CALIBRATION_IMAGES = 1500
_HEADS = "rendered heads of 16-32 pixels; every one another person, light and camera"
_FOUND_TOO = "; half of them of 10-32 pixels, in boxes as the head localiser's"
_PEOPLE = "rendered people of 70-140 pixels; every one another person, light and camera"
_FAR_TOO = "; a third of them of 24-80 pixels, from up to 45 degrees above, before busy backgrounds"
_REAL = "not judged on real pictures here; "


Trained = FeatureClassifier | HeadLocaliser | HeadExemplars | KeypointPose
"""Any model of the package."""


def train_on_rendered(
    name: str,
    *,
    images: int | None = None,
    test_images: int = 1000,
    seed: int = 0,
    as_published: bool = False,
    advance: Callable[[int], None] = lambda count: None,
) -> Trained:
    """Train a model by name on rendered crops; its card tells of ``test_images`` other ones.

    Parameters
    ----------
    images : how many to train on; by default as many as for the package's model
    as_published : the form that their papers have printed, of the models of `AS_PUBLISHED`
    advance : is told how many more images to train on are rendered

    Raises
    ------
    InputError
        If there is no model of that name, or it cannot be trained here.
    """
    if name not in NAMES:
        raise InputError(f"model {name!r}", f"one of {', '.join(NAMES)}")
    check_published(name, as_published)
    if name == DeepBelief.kind:
        DeepBelief.check_trainable()
    count = images or COUNTS[name]
    rng, other = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    if name == HeadLocaliser.kind:
        people, judged = make_pedestrians(count, rng, advance=advance), make_pedestrians(test_images, other)
        return _localiser(people, judged, _head_localiser(seed, as_published))
    if name == BodyPose.kind:
        people = make_pedestrians(count - count // 3, rng, advance=advance)
        people += make_pedestrians(count // 3, rng, FAR, advance=advance)
        body = _untrained(name, seed, as_published)
        return _body_pose(people, make_pedestrians(test_images, other), body)
    if name == KeypointPose.kind:
        return train_keypoints(count, test_skeletons=20 * test_images, seed=seed, advance=advance)
    if name not in CLASSIFIERS:
        return train_head_exemplars(
            people=max(2, count // len(PoseClasses.circle(16, 3))),
            seed=seed,
            as_published=as_published,
            advance=advance,
        )
    # The two that are means and exemplars are best at what they were trained on; the network holds both.
    found = count // 2 if name == DeepBelief.kind else 0
    pan, tilt = draw_poses(count - found, rng, _EXACT, _HEAD_POSE[name]().classes)
    heads = make_heads(count - found, rng, _EXACT, pan=pan, tilt=tilt, advance=advance)
    heads += make_heads(found, rng, FOUND, advance=advance)
    model = _head_pose(name, heads, seed, as_published)
    calibrate_for_use(model, seed)
    figures = head_pose_figures(model, test_images, other)
    _complete_card(model, _HEADS + (_FOUND_TOO if found else ""), figures)
    return model


def check_published(name: str, as_published: bool) -> None:
    """Refuse the form as published of a model that is of neither paper.

    Raises
    ------
    InputError
        As said.
    """
    if as_published and name not in AS_PUBLISHED:
        raise InputError(f"{name} as published", f"one of {', '.join(AS_PUBLISHED)}")


def _head_pose(name: str, heads: HeadSet, seed: int, as_published: bool) -> FeatureClassifier:
    skin = None
    if name == Templates.kind:
        seen, masks = heads.images[:_SKIN_IMAGES], heads.skin[:_SKIN_IMAGES]
        skin = SkinColours.fit(seen, masks, as_published=as_published)
    model = _untrained(name, seed, as_published, skin)
    return model.fit(heads.images, model.classes.index(heads.pan, heads.tilt))


def _head_localiser(seed: int, as_published: bool) -> HeadLocaliser:
    return HeadLocaliser.as_published(seed=seed) if as_published else HeadLocaliser(seed=seed)


def _untrained(
    name: str, seed: int, as_published: bool, skin: SkinColours | None = None
) -> FeatureClassifier:
    """Return a classifier by name, in the package's form or as published."""
    if name == BodyPose.kind:
        return BodyPose.as_published(seed=seed) if as_published else BodyPose(seed=seed)
    if name == Templates.kind:
        if as_published:
            return Templates.as_published(seed=seed, skin=skin)
        return Templates(seed=seed, skin=skin, metric="fisher")
    if name == Exemplars.kind:
        if as_published:
            return Exemplars.as_published(seed=seed)
        return Exemplars(seed=seed, exemplars=40, weigh_filters=True)
    return DeepBelief(seed=seed)


def calibrate_for_use(model: FeatureClassifier, seed: int) -> None:
    """Choose the temperature anew on other heads, with tilts as of walking people.

    Training has more heads that look up or down, so that every class has enough of them.
    """
    rng = np.random.default_rng([seed, 2])
    heads = make_heads(_CALIBRATION_IMAGES, rng)
    if model.kind == DeepBelief.kind:
        heads = heads + make_heads(_CALIBRATION_IMAGES, rng, FOUND_AS_WALKING)
    model.calibrate(heads.images, heads.pan)


def head_pose_figures(model: FeatureClassifier, count: int, rng: np.random.Generator) -> dict[str, float]:
    """Errors on heads in exact boxes, and on heads in boxes as the localiser's (names end in ``_found``)."""
    exact, found = make_heads(count, rng), make_heads(count, rng, FOUND_AS_WALKING)
    figures = evaluate(model, exact.images, exact.pan).figures()
    of_found = evaluate(model, found.images, found.pan).figures()
    return figures | {f"{name}_found": value for name, value in of_found.items()}


def train_on_files(
    name: str, folder: str | Path, labels: str | Path, *, seed: int = 0, as_published: bool = False
) -> Trained:
    """Train a model by name on a user's images.

    The CSV has the columns ``image`` and: ``pan_deg`` and ``tilt_deg`` for head pose, ``body_deg`` for body
    pose (0 faces the camera, 90 the right of the image), or ``left``, ``top``, ``width`` and ``height`` of
    the head in pixels for the head localiser, whose images are crops of people.

    Raises
    ------
    InputError
        If there is no model of that name that learns from such files, or they cannot be used.
    """
    # The labels do not say who is who, which the tracker's exemplars need, nor where points of the body are.
    known = [known for known in NAMES if known not in (HeadExemplars.kind, KeypointPose.kind)]
    if name not in known:
        raise InputError(f"model {name!r}", f"one of {', '.join(known)}")
    check_published(name, as_published)
    model: FeatureClassifier | HeadLocaliser
    if name == HeadLocaliser.kind:
        given = read_labelled(folder, labels, ("left", "top", "width", "height"))
        model = _head_localiser(seed, as_published).fit(given.images, given.values)
    elif name == BodyPose.kind:
        given = read_labelled(folder, labels, ("body_deg",))
        model = _untrained(name, seed, as_published)
        model.fit(given.images, model.classes.index(np.deg2rad(given.values[:, 0])))
    else:
        given = read_labelled(folder, labels, ("pan_deg", "tilt_deg"))
        # Skin is a matter of masks, which these labels lack: the colours of the package's model serve.
        skin = Templates.load(model_path(Templates.kind)).skin if name == Templates.kind else None
        model = _untrained(name, seed, as_published, skin)
        if name == Exemplars.kind and not as_published:
            model = Exemplars(seed=seed)  # of fewer images than are rendered
        model.fit(given.images, model.classes.index(*np.deg2rad(given.values).T))
    model.card = replace(model.card, trained_on=f"the images that {Path(labels).name} names")
    return model


def _body_pose(people: PedestrianSet, judged: PedestrianSet, model: FeatureClassifier) -> FeatureClassifier:
    model.fit(people.images, model.classes.index(people.body))
    near = make_pedestrians(_CALIBRATION_IMAGES // 2, np.random.default_rng([model.seed, 2]))
    model.calibrate(near.images, near.body)
    _complete_card(model, _PEOPLE + _FAR_TOO, evaluate(model, judged.images, judged.body).figures())
    return model


def _localiser(people: PedestrianSet, judged: PedestrianSet, model: HeadLocaliser) -> HeadLocaliser:
    model.fit(people.images, people.head_box)
    _complete_card(model, _PEOPLE, localisation_figures(model, judged))
    return model


def localisation_figures(model: HeadLocaliser, people: PedestrianSet) -> dict[str, float]:
    """The three numbers of Chen et al.'s Table 1: overlap of the first candidate, best of all, candidates."""
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
