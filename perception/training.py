"""Training of the package's models on rendered people, and of a user's own on labelled images."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax, logsumexp

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.io.source import Source
from graphtrack.io.text import csv_records, parse_number
from graphtrack.tracks.display import shortened
from perception.images.frames import read_image
from perception.images.pixels import Image, enlarged, grey, grey_stack, intersection_over_union
from perception.models import CLASSIFIERS, NAMES, model_path
from perception.pose.body import BodyPose
from perception.pose.classes import TILT_EDGE, PoseClasses
from perception.pose.classifier import FeatureClassifier, evaluate, reliability
from perception.pose.deep_belief import DeepBelief
from perception.pose.exemplars import SMALLEST_DEVIATION, Exemplars
from perception.pose.features import SIDE, SkinColours, gabor_features
from perception.pose.head_detection import HeadLocaliser
from perception.pose.keypoints import BODY, HEAD, KeypointPose, Layers, features
from perception.pose.templates import Templates
from perception.storage import ModelCard
from perception.synthetic import (
    HeadVariation,
    PedestrianSet,
    PedestrianVariation,
    draw_poses,
    make_heads,
    make_pedestrians,
)
from perception.synthetic.people import random_appearance
from perception.synthetic.skeletons import Skeletons, make_skeletons, perceived
from perception.trackers.head_exemplars import HeadExemplars, combined
from perception.trackers.tracker import PATCH_MARGIN, cut, equalised

_UNITS = (96, 48)
_PASSES = ((8, 2e-3), (4, 5e-4), (3, 1e-4))  # passes over all skeletons and learning rates

_TRAINED_ON = (
    "skeletons of people who walk and stand, 20-400 pixels high, before random cameras up to 60 degrees "
    "above, with points that are displaced, uncertain, hidden or exchanged as a pose network's; a quarter as "
    "of networks whose confidences do not follow occlusion"
)
_FAILS = (
    "evaluated on one real network, MediaPipe's on walkers of Town Centre, which takes 28 % of backs for "
    "fronts; people bent, sitting or lying, views from straight above"
)


def train_keypoints(
    count: int,
    *,
    test_skeletons: int = 20_000,
    seed: int = 0,
    advance: Callable[[int], None] = lambda count: None,
) -> KeypointPose:
    """Train on ``count`` skeletons; a tenth as many choose the calibration, others are for the card."""
    train, rest, other = (np.random.default_rng([seed, k]) for k in range(3))
    people, points = drawn(count, train)
    held_out, held_points = drawn(max(count // 10, 1000), rest)
    parts = []
    step = count // 2
    for classes, name in ((BODY, "body"), (HEAD, "head")):
        labels, of_held = (classes.index(getattr(some, name)) for some in (people, held_out))
        layers = _fitted(features(points), labels, seed)
        parts.append(layers.calibrated(held_points, of_held))
        advance(step if name == "body" else count - step)
    body, head = parts
    model = KeypointPose(body, head, ModelCard(KeypointPose.kind))
    judged, judged_points = drawn(test_skeletons, other)
    figures = keypoint_figures(model, judged_points, judged.body, judged.head)
    model.card = ModelCard(KeypointPose.kind, _TRAINED_ON, _FAILS, count, figures=figures)
    return model


def drawn(count: int, rng: np.random.Generator) -> tuple[Skeletons, FloatArray]:
    """Draw skeletons, and simulated output of a pose network (n, 9, 3)."""
    people = make_skeletons(count, rng)
    return people, perceived(people.points, people.visibility, people.height, rng)


def _fitted(values: NDArray[np.float32], labels: NDArray[np.int64], seed: int) -> Layers:
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPClassifier

    network = MLPClassifier(
        _UNITS, alpha=1e-5, batch_size=500, tol=0.0, n_iter_no_change=1000, warm_start=True, random_state=seed
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the number of passes is fixed
        for passes, rate in _PASSES:
            network.set_params(max_iter=passes, learning_rate_init=rate)
            network.fit(values, labels)
    weights = tuple(np.asarray(weight, np.float32) for weight in network.coefs_)
    return Layers(weights, tuple(np.asarray(bias, np.float32) for bias in network.intercepts_))


def keypoint_figures(
    model: KeypointPose, points: FloatArray, body: FloatArray, head: FloatArray
) -> dict[str, float]:
    """Return errors and calibration errors of body and head, from points (n, 9, 3) and true angles (n,)."""
    found: dict[str, float] = {}
    for name, classes, layers, angle in (("body", BODY, model.body, body), ("head", HEAD, model.head, head)):
        log_likelihood = layers.log_likelihoods(points)
        error = np.degrees(np.abs(difference(classes.mean_pan(log_likelihood), angle)))
        label = classes.index(angle)
        probability = log_softmax(log_likelihood, axis=1)[np.arange(len(label)), label]
        found |= {
            f"{name}_mean_error_deg": float(error.mean()),
            f"{name}_median_error_deg": float(np.median(error)),
            f"{name}_beyond_90_percent": 100.0 * float((error > 90.0).mean()),
            f"{name}_bits": float(-probability.mean() / np.log(2.0)),
            f"{name}_expected_calibration_error": reliability(
                log_likelihood, label
            ).expected_calibration_error,
        }
    return found


_HEADS = HeadVariation(size=(16, 40), offset=0.02, scale=0.03)
_SCENES = PedestrianVariation(
    size=(150, 280), head_turn=1.2, tilt=0.25, occluded=0.0, cluttered=0.6, margin=1.5, offset=0.02
)
_BOXES = 40  # boxes per scene: the head's, and equally many next to it and anywhere
_OFFSET, _SCALE = 0.25, 0.2
_OFF_HEAD = 0.3  # relative offset from which a box is background
_SEARCH = 120
_EXEMPLAR_FAILS = "heads below 16 pixels, views from above, initial boxes off by a third of the head"


@dataclass(frozen=True, eq=False)
class _Scenes:
    """Responses (n, 40, 764) of boxes, how far (n, 40) each is off, pose labels (n,) and pans (n,)."""

    features: NDArray[np.float32]
    off: FloatArray
    label: NDArray[np.int64]
    pan: FloatArray


def train_head_exemplars(
    *,
    people: int = 160,
    scenes: int = 600,
    exemplars: int = 8,
    background: int = 64,
    seed: int = 0,
    as_published: bool = False,
    advance: Callable[[int], None] = lambda count: None,
) -> HeadExemplars:
    """Fit exemplars, the table of shared people and the weights of the filters.

    Parameters
    ----------
    people : rendered at every pose, and mirrored
    scenes : rendered people with surroundings: half for the background's exemplars, a quarter each for the
        weights and the figures of the card
    exemplars : K for each pose class
    background : exemplars of the background
    as_published : form of Ba & Odobez 2003 (`Exemplars.as_published`): filters have no weights
    advance : receives the number of newly rendered heads
    """
    rng = np.random.default_rng(seed)
    classes = PoseClasses.circle(16, 3)
    mean = not as_published
    features, labels, person = _heads(classes, people, rng, advance, mean)
    model = Exemplars(classes, seed=seed, exemplars=exemplars, plain=as_published)
    model.fit_features(np.asarray(features, float), labels, rng)
    found = _of_scenes(make_pedestrians(scenes, rng, _SCENES), classes, rng, mean)
    half, rest = scenes // 2, scenes // 2 + scenes // 4
    centre, deviation, log_weight = _background(
        found.features[:half][found.off[:half] > _OFF_HEAD], background, rng
    )
    bare = HeadExemplars(
        classes=classes,
        centre=model.centre,
        deviation=model.deviation,
        log_weight=model.log_weight.astype(float),
        background_centre=centre,
        background_deviation=deviation,
        background_log_weight=log_weight,
        exponent=np.ones(4),
        shared=np.zeros((0, 0), np.float32),
        plain=as_published,
    )
    trained = bare if as_published else _weighed(bare, found, slice(half, rest))
    trained = replace(trained, shared=_shared(trained, features, labels, person, people))
    figures = _figures(trained, found, slice(rest, scenes))
    card = ModelCard(
        HeadExemplars.kind,
        f"{people} rendered people at all of {len(classes)} poses, {scenes} others with surroundings",
        _EXEMPLAR_FAILS,
        len(labels),
        {"exemplars": exemplars, "background": background, "seed": seed, "plain": as_published},
        figures,
    )
    return replace(trained, card=card)


def _heads(
    classes: PoseClasses,
    people: int,
    rng: np.random.Generator,
    advance: Callable[[int], None],
    subtract_mean: bool,
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
    """Return responses, labels and people of heads: every person at every pose, and mirrored."""
    appearances = [random_appearance(rng) for _ in range(people)]
    labels, person = np.tile(np.arange(len(classes)), people), np.repeat(np.arange(people), len(classes))
    n = len(labels)
    pan = classes.pan[labels % classes.n_pan] + rng.uniform(-0.5, 0.5, n) * classes.step
    level = labels // classes.n_pan - 1
    middle = np.clip(rng.normal(0.0, 0.25, n), -TILT_EDGE, TILT_EDGE)
    tilt = np.where(level == 0, middle, level * rng.uniform(TILT_EDGE, TILT_EDGE + 0.33, n))
    heads = make_heads(
        n, rng, _HEADS, pan=pan, tilt=tilt, people=[appearances[i] for i in person], advance=advance
    )
    images = [*heads.images, *(np.ascontiguousarray(image[:, ::-1]) for image in heads.images)]
    stack = grey_stack(images, SIDE, SIDE, equalise=True)
    features = gabor_features(stack, subtract_mean=subtract_mean).astype(np.float32)
    return features, np.concatenate([labels, classes.reflected(labels)]), np.tile(person, 2)


def _of_scenes(
    people: PedestrianSet, classes: PoseClasses, rng: np.random.Generator, subtract_mean: bool
) -> _Scenes:
    features, off = [], []
    for image, box in zip(people.images, people.head_box, strict=True):
        height, width = image.shape[:2]
        size = box[2:] * np.exp(rng.normal(0.0, _SCALE, (_BOXES, 2)))
        middle = box[:2] + box[2:] / 2.0 + rng.normal(0.0, _OFFSET, (_BOXES, 2)) * box[2:]
        middle[_BOXES // 2 :] = rng.uniform(0.0, 1.0, (_BOXES - _BOXES // 2, 2)) * (width, height)
        size[0], middle[0] = box[2:], box[:2] + box[2:] / 2.0
        boxes = np.hstack([middle - size / 2.0, size])
        patches = cut(grey(image), enlarged(boxes, PATCH_MARGIN), SIDE)
        found = gabor_features(equalised(patches), subtract_mean=subtract_mean)
        features.append(found.astype(np.float32))
        moved = (middle - middle[0]) / box[2:], np.log(size / box[2:])
        off.append(np.abs(np.hstack(moved)).max(axis=1))
    return _Scenes(np.array(features), np.array(off), classes.index(people.head, people.tilt), people.head)


def _background(
    features: NDArray[np.float32], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32], FloatArray]:
    """Centres and deviations (count, 764) and log weights (count,) of clusters."""
    from sklearn.cluster import KMeans

    means = KMeans(count, n_init=1, random_state=int(rng.integers(2**31))).fit(features)
    size = np.bincount(means.labels_, minlength=count)
    deviation = np.array([features[means.labels_ == j].std(axis=0) for j in range(count)])
    deviation[size < 6] = 1.0  # responses are normalised
    log_weight = np.log(size / len(features))
    return (
        means.cluster_centers_.astype(np.float32),
        np.maximum(deviation, SMALLEST_DEVIATION).astype(np.float32),
        log_weight,
    )


def _shared(
    model: HeadExemplars,
    features: NDArray[np.float32],
    labels: NDArray[np.int64],
    person: NDArray[np.int64],
    people: int,
) -> NDArray[np.float32]:
    """Count the people with images in both of two labels (labels, labels) (Ba & Odobez 2003, §3.3)."""
    k = model.log_weight.shape[1]
    belongs = np.zeros((people, model.labels), np.float32)
    for start in range(0, len(labels), 512):
        part = slice(start, start + 512)
        if model.plain:  # the class of an exemplar is its cluster
            own = -np.square(features[part, None] - model.centre[labels[part]]).sum(axis=2)
        else:
            ratio = model.log_ratio(features[part]).reshape(-1, len(model.classes), k)
            own = ratio[np.arange(len(ratio)), labels[part]]
        belongs[person[part], labels[part] * k + own.argmax(axis=1)] = 1.0
    return belongs.T @ belongs


def _weighed(model: HeadExemplars, scenes: _Scenes, chosen: slice) -> HeadExemplars:
    """Fit the weights of the filters by the likelihood of the head's box and pose, and calibrate."""
    head, background = _by_filter(model, scenes.features[chosen])
    label = scenes.label[chosen]
    rows = np.arange(len(label))

    def loss(log_exponent: FloatArray) -> float:
        ratio = combined(head, background, model.background_log_weight, np.exp(log_exponent))
        poses = model.pose_log_likelihood(ratio)
        return -float((poses[rows, 0, label] - logsumexp(poses.reshape(len(rows), -1), axis=1)).mean())

    start = np.log([0.03, 0.003, 0.03, 0.1])
    exponent = np.exp(minimize(loss, start, method="Nelder-Mead", options={"maxfev": _SEARCH}).x)
    ratio = combined(head, background, model.background_log_weight, exponent)
    of_head = logsumexp(model.pose_log_likelihood(ratio), axis=2) - np.log(len(model.classes))
    slope, intercept = _calibration(of_head[:, 0], of_head[scenes.off[chosen] > _OFF_HEAD])
    return replace(model, exponent=exponent, slope=slope, intercept=intercept)


def _by_filter(
    model: HeadExemplars, features: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    n, boxes, size = features.shape
    head, background = model.by_filter(features.reshape(-1, size))
    return head.reshape(n, boxes, *head.shape[1:]), background.reshape(n, boxes, *background.shape[1:])


def _calibration(heads: FloatArray, negatives: FloatArray) -> tuple[float, float]:
    """Fit slope and intercept of the log likelihood ratio in a score; both classes have equal weight."""

    def loss(p: FloatArray) -> float:
        wrong = np.logaddexp(0.0, -(p[0] * heads + p[1])).mean()
        return float(wrong + np.logaddexp(0.0, p[0] * negatives + p[1]).mean())

    slope, intercept = minimize(loss, np.array([1.0, 0.0])).x
    return float(slope), float(intercept)


def _figures(model: HeadExemplars, scenes: _Scenes, chosen: slice) -> dict[str, float]:
    """Return figures on held-out scenes: the best box of 40, and the pan in the head's box."""
    head, background = _by_filter(model, scenes.features[chosen])
    poses = model.pose_log_likelihood(combined(head, background, model.background_log_weight, model.exponent))
    off = scenes.off[chosen]
    best = logsumexp(poses, axis=2).argmax(axis=1)
    found = off[np.arange(len(off)), best]
    error = np.abs(difference(model.classes.most_likely_pan(poses[:, 0]), scenes.pan[chosen]))
    return {
        "best_of_40_on_the_head": float(np.mean(found < 0.5)),
        "median_offset_of_best_in_head_sizes": float(np.median(found)),
        "pan_mean_error_deg": float(np.degrees(error.mean())),
    }


def read_labelled(
    folder: str | Path, labels: str | Path, columns: tuple[str, ...]
) -> tuple[list[Image], FloatArray]:
    """Read the n images that a CSV names in its column ``image``, and other columns as numbers (n, k).

    Parameters
    ----------
    folder : where the images are
    labels : the CSV, with a heading
    columns : required columns in addition to ``image``

    Raises
    ------
    InputError
        With the line of the first unusable row.
    """
    images, values = [], []
    header, rows = csv_records(Source.open(labels))
    missing = [name for name in ("image", *columns) if name not in header]
    if missing:
        raise InputError("no such column", f"a column {missing[0]}", path=labels, column=missing[0])
    for line, row in rows:
        numbers = [parse_number(row[name]) for name in columns]
        for name, number in zip(columns, numbers, strict=True):
            if number is None:
                raise InputError(shortened(row[name]), "a number", path=labels, line=line, column=name)
        image = read_image(Path(folder) / row["image"])
        if image is None:
            found = f"image {shortened(row['image'])}, which cannot be read"
            raise InputError(found, f"an image in {folder}", path=labels, line=line)
        images.append(image)
        values.append(numbers)
    if not images:
        raise InputError("no rows", "at least one image", path=labels)
    return images, np.array(values, float)


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
"""Models of Chen et al. 2011, also available in the published form."""
AS_PUBLISHED = (*PUBLISHED, Exemplars.kind, HeadExemplars.kind)
"""All models with a published form, including those of Ba & Odobez 2003."""

FOUND = HeadVariation(size=(10, 32), offset=0.07, scale=0.12, tilt_deviation=0.45)
"""Heads in boxes with the measured errors of the localiser, small heads included."""

FOUND_AS_WALKING = replace(FOUND, tilt_deviation=0.35)
"""The same with tilts of walking people, for evaluation."""

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
"""People in wide-angle views: small, blurred, from above, occluded, in front of clutter."""

_HEAD_POSE: dict[str, Callable[[], FeatureClassifier]] = {
    kind.kind: kind for kind in (Templates, Exemplars, DeepBelief)
}
_EXACT = HeadVariation(offset=0.03, scale=0.05, tilt_deviation=0.45)
_SKIN_IMAGES = 2000
_CALIBRATION_IMAGES = 1500
_HEAD_IMAGES = "rendered heads of 16-32 pixels; each with another person, light and camera"
_FOUND_TOO = "; half of them of 10-32 pixels, in boxes with the head localiser's errors"
_PEOPLE = "rendered people of 70-140 pixels; each with another person, light and camera"
_FAR_TOO = "; a third of them of 24-80 pixels, from up to 45 degrees above, in front of clutter"
_REAL = "not evaluated on real images; "


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
    """Train a model by name on rendered crops; its card has figures on ``test_images`` others.

    Parameters
    ----------
    images : number to train on; by default as for the package's model
    as_published : the published form, for the models of `AS_PUBLISHED`
    advance : receives the number of newly rendered training images

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
        localiser = _head_localiser(seed, as_published).fit(people.images, people.head_box)
        _complete_card(localiser, _PEOPLE, localisation_figures(localiser, judged))
        return localiser
    if name == BodyPose.kind:
        people = make_pedestrians(count - count // 3, rng, advance=advance)
        people += make_pedestrians(count // 3, rng, FAR, advance=advance)
        judged, body = make_pedestrians(test_images, other), _untrained(name, seed, as_published)
        body.fit(people.images, body.classes.index(people.body))
        near = make_pedestrians(_CALIBRATION_IMAGES // 2, np.random.default_rng([seed, 2]))
        body.calibrate(near.images, near.body)
        _complete_card(body, _PEOPLE + _FAR_TOO, evaluate(body, judged.images, judged.body).figures())
        return body
    if name == KeypointPose.kind:
        return train_keypoints(count, test_skeletons=20 * test_images, seed=seed, advance=advance)
    if name not in CLASSIFIERS:
        return train_head_exemplars(
            people=max(2, count // len(PoseClasses.circle(16, 3))),
            seed=seed,
            as_published=as_published,
            advance=advance,
        )
    # Templates and exemplars fit one kind of crops best; the network is trained on both.
    found = count // 2 if name == DeepBelief.kind else 0
    pan, tilt = draw_poses(count - found, rng, _EXACT, _HEAD_POSE[name]().classes)
    heads = make_heads(count - found, rng, _EXACT, pan=pan, tilt=tilt, advance=advance)
    heads += make_heads(found, rng, FOUND, advance=advance)
    skin = None
    if name == Templates.kind:
        skin_images, masks = heads.images[:_SKIN_IMAGES], heads.skin[:_SKIN_IMAGES]
        skin = SkinColours.fit(skin_images, masks, as_published=as_published)
    model = _untrained(name, seed, as_published, skin)
    model.fit(heads.images, model.classes.index(heads.pan, heads.tilt))
    calibrate_for_use(model, seed)
    figures = head_pose_figures(model, test_images, other)
    _complete_card(model, _HEAD_IMAGES + (_FOUND_TOO if found else ""), figures)
    return model


def check_published(name: str, as_published: bool) -> None:
    """Refuse the published form for a model of neither paper.

    Raises
    ------
    InputError
        For a model without a published form.
    """
    if as_published and name not in AS_PUBLISHED:
        raise InputError(f"{name} as published", f"one of {', '.join(AS_PUBLISHED)}")


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
    """Refit the temperature on other heads, with tilts of walking people.

    The training set has more heads tilted up or down, so that every class has enough samples.
    """
    rng = np.random.default_rng([seed, 2])
    heads = make_heads(_CALIBRATION_IMAGES, rng)
    if model.kind == DeepBelief.kind:
        heads = heads + make_heads(_CALIBRATION_IMAGES, rng, FOUND_AS_WALKING)
    model.calibrate(heads.images, heads.pan)


def head_pose_figures(model: FeatureClassifier, count: int, rng: np.random.Generator) -> dict[str, float]:
    """Return errors on heads in exact boxes, and in boxes with localiser errors (names with ``_found``)."""
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
    # The labels lack identities, which the tracker's exemplars need, and keypoints.
    known = [known for known in NAMES if known not in (HeadExemplars.kind, KeypointPose.kind)]
    if name not in known:
        raise InputError(f"model {name!r}", f"one of {', '.join(known)}")
    check_published(name, as_published)
    model: FeatureClassifier | HeadLocaliser
    if name == HeadLocaliser.kind:
        images, boxes = read_labelled(folder, labels, ("left", "top", "width", "height"))
        model = _head_localiser(seed, as_published).fit(images, boxes)
    elif name == BodyPose.kind:
        images, angles = read_labelled(folder, labels, ("body_deg",))
        model = _untrained(name, seed, as_published)
        model.fit(images, model.classes.index(np.deg2rad(angles[:, 0])))
    else:
        images, angles = read_labelled(folder, labels, ("pan_deg", "tilt_deg"))
        # These labels lack skin masks, so the colours of the package's model are used.
        skin = Templates.load(model_path(Templates.kind)).skin if name == Templates.kind else None
        model = _untrained(name, seed, as_published, skin)
        if name == Exemplars.kind and not as_published:
            model = Exemplars(seed=seed)  # for fewer images than are rendered
        model.fit(images, model.classes.index(*np.deg2rad(angles).T))
    model.card = replace(model.card, trained_on=f"the images that {Path(labels).name} names")
    return model


def localisation_figures(model: HeadLocaliser, people: PedestrianSet) -> dict[str, float]:
    """Return the numbers of Chen et al.'s Table 1: overlap of the first candidate, of the best, and count."""
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
