"""Recognition of nine pans as Ba & Odobez (2003) measure it, on rendered heads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.pose.classes import PoseClasses
from perception.pose.head_pose.exemplars import Density, Exemplars
from perception.synthetic.appearance import Appearance, random_appearance
from perception.synthetic.heads import HeadSet, HeadVariation, make_heads

ALIGNED = HeadVariation(size=(64, 64), offset=0.0, scale=0.0, roll=0.0, elevation=(0.0, 0.0), shoulders=0.05)
"""Heads as in a studio: tight boxes at the camera's height, tilt set by the caller."""


@dataclass(frozen=True)
class RecognitionRow:
    """One cell of Ba & Odobez's Tables 1 and 3: recognition rate (mean and 1-σ over the repetitions)."""

    exemplars: int
    density: Density
    rate: float
    deviation: float


def recognition_table(
    people: int,
    exemplars: Sequence[int],
    rng: np.random.Generator,
    *,
    repetitions: int = 1,
    as_published: bool = False,
) -> tuple[list[RecognitionRow], FloatArray]:
    """Ba & Odobez's Table 1 (68 people, 1 or 2 exemplars) and Table 3 (140 people, several splits), rendered.

    With ``as_published`` the exemplars are those of `Exemplars.as_published`.

    Half of the people train, the other half test; each is seen once at the nine pans −90° … 90°.

    Returns
    -------
    The rows, and the confusion matrix (9, 9) in percent (Ba & Odobez's Table 2) of two exemplars (or the
    last number asked for) with the saturated density, over all repetitions.
    """
    classes = PoseClasses.half_circle()
    persons = [random_appearance(rng) for _ in range(people)]
    heads, labels = _one_of_each(persons, classes, rng)
    person = np.arange(len(labels)) // len(classes)
    rates: dict[tuple[int, Density], list[float]] = {}
    confusion = np.zeros((len(classes), len(classes)))
    shown = 2 if 2 in exemplars else exemplars[-1]
    for train, test in _splits(people, repetitions, rng):
        fitted, judged = (np.flatnonzero(np.isin(person, part)) for part in (train, test))
        for count, density in _cells(exemplars):
            model = Exemplars(classes, exemplars=count, density=density, plain=as_published)
            features = model.features([heads.images[i] for i in fitted])
            model.fit_features(features, labels[fitted], np.random.default_rng(0))
            found = model.scores(model.features([heads.images[i] for i in judged])).argmax(axis=1)
            rates.setdefault((count, density), []).append(float(np.mean(found == labels[judged])))
            if (count, density) == (shown, "saturated"):
                np.add.at(confusion, (labels[judged], found), 1.0)
    rows = [RecognitionRow(*cell, float(np.mean(r)), float(np.std(r))) for cell, r in rates.items()]
    return rows, 100.0 * confusion / confusion.sum(axis=1, keepdims=True)


def _cells(exemplars: Sequence[int]) -> Iterator[tuple[int, Density]]:
    for count in exemplars:
        yield count, "gaussian"
        yield count, "saturated"


def _one_of_each(
    persons: list[Appearance], classes: PoseClasses, rng: np.random.Generator
) -> tuple[HeadSet, NDArray[np.int64]]:
    """Every person at every pan, person by person."""
    labels = np.tile(np.arange(len(classes)), len(persons))
    looks = [person for person in persons for _ in range(len(classes))]
    count = len(labels)
    return make_heads(
        count, rng, ALIGNED, pan=classes.pan[labels], tilt=np.zeros(count), people=looks
    ), labels


def _splits(
    people: int, repetitions: int, rng: np.random.Generator
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    for _ in range(repetitions):
        order = rng.permutation(people)
        yield order[: people // 2], order[people // 2 :]
