"""The exemplars of the mixed-state tracker, learned from rendered heads and people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp

from graphtrack.geometry.angles import FloatArray, difference
from perception.images.pixels import enlarged, grey, grey_stack
from perception.pose.classes import TILT_EDGE, PoseClasses
from perception.pose.features.gabor import SIDE, gabor_features
from perception.pose.head_pose.exemplars import SMALLEST_DEVIATION, Exemplars
from perception.storage import ModelCard
from perception.synthetic import (
    HeadVariation,
    PedestrianSet,
    PedestrianVariation,
    make_heads,
    make_pedestrians,
)
from perception.synthetic.appearance import random_appearance
from perception.trackers.mixed_state.exemplars import HeadExemplars, combined
from perception.trackers.patches import PATCH_MARGIN, cut, equalised

_HEADS = HeadVariation(size=(16, 40), offset=0.02, scale=0.03)
_SCENES = PedestrianVariation(
    size=(150, 280), head_turn=1.2, tilt=0.25, occluded=0.0, cluttered=0.6, margin=1.5, offset=0.02
)
_BOXES = 40
"""Boxes looked at in each scene: the head's, as many beside it as anywhere."""
_OFFSET, _SCALE = 0.25, 0.2
_BESIDE = 0.3
"""A box that is off by more than this share of the head's size is no head."""
_SEARCH = 120
_FAILS = "heads below 16 pixels, views from above, boxes that start off by a third of the head"


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
    """Learn exemplars, the table of shared people and the weights of the filters.

    Parameters
    ----------
    people : rendered at every pose, and mirrored
    scenes : rendered people with surroundings: half of them give the background's exemplars, a quarter each
        the weights and the figures of the card
    exemplars : K for each pose class
    background : exemplars of what is no head
    as_published : Ba & Odobez 2003 as printed (`Exemplars.as_published`): filters have no weights
    advance : is told how many more heads are rendered
    """
    rng = np.random.default_rng(seed)
    classes = PoseClasses.circle(16, 3)
    mean = not as_published
    features, labels, who = _heads(classes, people, rng, advance, mean)
    model = Exemplars(classes, seed=seed, exemplars=exemplars, plain=as_published)
    model.fit_features(np.asarray(features, float), labels, rng)
    found = _of_scenes(make_pedestrians(scenes, rng, _SCENES), classes, rng, mean)
    half, rest = scenes // 2, scenes // 2 + scenes // 4
    centre, deviation, log_weight = _background(
        found.features[:half][found.off[:half] > _BESIDE], background, rng
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
    trained = replace(trained, shared=_shared(trained, features, labels, who, people))
    figures = _figures(trained, found, slice(rest, scenes))
    card = ModelCard(
        HeadExemplars.kind,
        f"{people} rendered people at all of {len(classes)} poses, {scenes} others with surroundings",
        _FAILS,
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
    """Responses, labels and people of heads: every person at every pose, and mirrored."""
    looks = [random_appearance(rng) for _ in range(people)]
    labels, who = np.tile(np.arange(len(classes)), people), np.repeat(np.arange(people), len(classes))
    n = len(labels)
    pan = classes.pan[labels % classes.n_pan] + rng.uniform(-0.5, 0.5, n) * classes.step
    level = labels // classes.n_pan - 1
    middle = np.clip(rng.normal(0.0, 0.25, n), -TILT_EDGE, TILT_EDGE)
    tilt = np.where(level == 0, middle, level * rng.uniform(TILT_EDGE, TILT_EDGE + 0.33, n))
    heads = make_heads(n, rng, _HEADS, pan=pan, tilt=tilt, people=[looks[i] for i in who], advance=advance)
    images = [*heads.images, *(np.ascontiguousarray(image[:, ::-1]) for image in heads.images)]
    stack = grey_stack(images, SIDE, SIDE, equalise=True)
    features = gabor_features(stack, subtract_mean=subtract_mean).astype(np.float32)
    return features, np.concatenate([labels, classes.reflected(labels)]), np.tile(who, 2)


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
    who: NDArray[np.int64],
    people: int,
) -> NDArray[np.float32]:
    """How many people have images in both of two labels (labels, labels) (Ba & Odobez 2003, §3.3)."""
    k = model.log_weight.shape[1]
    belongs = np.zeros((people, model.labels), np.float32)
    for start in range(0, len(labels), 512):
        part = slice(start, start + 512)
        if model.plain:  # the class of an exemplar is its cluster
            own = -np.square(features[part, None] - model.centre[labels[part]]).sum(axis=2)
        else:
            ratio = model.log_ratio(features[part]).reshape(-1, len(model.classes), k)
            own = ratio[np.arange(len(ratio)), labels[part]]
        belongs[who[part], labels[part] * k + own.argmax(axis=1)] = 1.0
    return belongs.T @ belongs


def _weighed(model: HeadExemplars, scenes: _Scenes, chosen: slice) -> HeadExemplars:
    """With the weights of the filters that make the head's box and pose most likely among all, calibrated."""
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
    slope, intercept = _calibration(of_head[:, 0], of_head[scenes.off[chosen] > _BESIDE])
    return replace(model, exponent=exponent, slope=slope, intercept=intercept)


def _by_filter(
    model: HeadExemplars, features: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    n, boxes, size = features.shape
    head, background = model.by_filter(features.reshape(-1, size))
    return head.reshape(n, boxes, *head.shape[1:]), background.reshape(n, boxes, *background.shape[1:])


def _calibration(heads: FloatArray, others: FloatArray) -> tuple[float, float]:
    """Slope and intercept that make a score the log likelihood ratio, by logistic regression.

    Both kinds weigh the same, whatever their numbers.
    """

    def loss(p: FloatArray) -> float:
        wrong = np.logaddexp(0.0, -(p[0] * heads + p[1])).mean()
        return float(wrong + np.logaddexp(0.0, p[0] * others + p[1]).mean())

    slope, intercept = minimize(loss, np.array([1.0, 0.0])).x
    return float(slope), float(intercept)


def _figures(model: HeadExemplars, scenes: _Scenes, chosen: slice) -> dict[str, float]:
    """Of scenes that nothing was learned from: the best box of 40, and the pan in the head's own box."""
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
