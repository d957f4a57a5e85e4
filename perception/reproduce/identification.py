"""004 Tables 1 and 3: how often exemplars name the pan of a still head."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.angles import FloatArray
from perception.classes import PoseClasses
from perception.features.gabor import SIDE, gabor_features
from perception.head_pose.exemplars import Density, Exemplars
from perception.images import grey_stack
from perception.synthetic import HeadVariation, make_heads
from perception.synthetic.appearance import random_appearance

CLASSES = PoseClasses.half_circle()
_STILL = HeadVariation(size=(48, 64), roll=0.03, elevation=(-0.05, 0.1), offset=0.015, scale=0.02)
"""Heads as those of a studio: large, level, in tight boxes."""
_TILT = 0.1


def still_heads(people: int, rng: np.random.Generator) -> FloatArray:
    """Responses (people, 9, 764) of people at the nine pans of the paper."""
    looks = [random_appearance(rng) for _ in range(people)]
    pan = np.tile(CLASSES.pan, people)
    heads = make_heads(
        len(pan),
        rng,
        _STILL,
        pan=pan,
        tilt=rng.normal(0.0, _TILT, len(pan)),
        people=[look for look in looks for _ in range(len(CLASSES))],
    )
    features = gabor_features(grey_stack(heads.images, SIDE, SIDE, equalise=True))
    return features.reshape(people, len(CLASSES), -1)


def rates(
    features: FloatArray, exemplars: int, density: Density, splits: int, rng: np.random.Generator
) -> FloatArray:
    """Share (splits,) of the heads whose pan is named, with a random half of the people to learn from."""
    people = len(features)
    found = []
    for _ in range(splits):
        order = rng.permutation(people)
        known, others = order[: people // 2], order[people // 2 :]
        model = Exemplars(CLASSES, exemplars=exemplars, density=density)
        model.fit_features(*_flat(features[known]), rng)
        heads, labels = _flat(features[others])
        found.append(np.mean(model.scores(heads).argmax(axis=1) == labels))
    return np.array(found)


def _flat(features: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    people, classes, size = features.shape
    return features.reshape(-1, size), np.tile(np.arange(classes), people)
