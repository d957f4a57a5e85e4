"""People of motion capture as classifiers answer for them, of whose poses pictures are rendered."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.evaluation.reproduce.chen_classes import scores
from graphtrack.evaluation.reproduce.chen_tables import POSITION_STD, Scores
from graphtrack.evaluation.reproduce.experiment import (
    ASKANCE,
    MOCAP,
    TURNING,
    WALKING,
    Cell,
    Settings,
    Table,
    evenly,
    quietly,
    thinned,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, Track, TrackSet
from perception.observe.turned import interpolated
from perception.pose.classes import PoseClasses
from perception.pose.classifier import FeatureClassifier
from perception.synthetic import make_heads, make_pedestrians
from perception.training.models import FOUND_AS_WALKING

LEVELS = ("down", "level", "up")
"""Tilt classes, in the order of `PoseClasses`."""


@dataclass(frozen=True, eq=False)
class Answers:
    """What classifiers answered for pictures of known poses, all in the image.

    Attributes
    ----------
    body, said_body : (n,) classes of 45°, true and likeliest
    pan, said_pan : (n,) classes of the head's pan
    tilt, said_tilt : (n,) its tilt classes, `LEVELS`
    """

    body: NDArray[np.int64]
    said_body: NDArray[np.int64]
    pan: NDArray[np.int64]
    said_pan: NDArray[np.int64]
    tilt: NDArray[np.int64]
    said_tilt: NDArray[np.int64]


def captured_people(settings: Settings) -> dict[str, TrackSet]:
    """People by source, with noise on their positions; ten frames a second."""
    count = 2 if settings.quick else 12
    mocap = settings.recording(*MOCAP)
    if mocap is None:
        found = {"drawn from the joint model": simulate("joint", n_tracks=count, rng=settings.rng(20))}
    else:
        clips = quietly(mocap)
        sources = {"walking": (WALKING,), "turning": (TURNING,), "sideways and back": ASKANCE}
        found = {
            f"mocap, {name}": evenly(clips.select(*patterns).map(thinned), count, 2.0)
            for name, patterns in sources.items()
            if name == "walking" or not settings.quick
        }
    return {
        name: add_noise(tracks, position_std=POSITION_STD, rng=settings.rng(21, i))
        for i, (name, tracks) in enumerate(found.items())
    }


def classified(
    track: Track, body: FeatureClassifier, head: FeatureClassifier, rng: np.random.Generator
) -> tuple[Track, Answers]:
    """A person before a distant camera, with the classifiers' likelihoods turned to the world.

    In each frame somebody else stands for them, in the same pose, so that errors are independent; heads are
    boxed as the localiser boxes them, and tilted as those of people who walk.
    """
    assert track.true_body is not None and track.true_head is not None
    ray = rng.uniform(-np.pi, np.pi)
    at_body, at_head = track.true_body - ray, track.true_head - ray
    crops = make_pedestrians(len(track), rng, body=at_body).images
    heads = make_heads(len(track), rng, FOUND_AS_WALKING, pan=at_head)
    of_body, of_head = body.log_likelihoods(crops), head.log_likelihoods(heads.images)
    pans = head.classes.pan_log_likelihood(of_head)
    seen = replace(
        track,
        body=None,
        body_kappa=None,
        head=None,
        head_kappa=None,
        body_likelihood=_turned(body.classes.pan_log_likelihood(of_body), body.classes, BODY_CLASSES, ray),
        head_likelihood=_turned(pans, head.classes, HEAD_CLASSES, ray),
    )
    n_pan, bodies = head.classes.n_pan, body.classes
    true = head.classes.index(at_head, heads.tilt)
    levels = of_head.reshape(len(track), -1, n_pan)
    answers = Answers(
        bodies.index(at_body),
        of_body.argmax(axis=1),
        true % n_pan,
        pans.argmax(axis=1),
        true // n_pan,
        np.logaddexp.reduce(levels, axis=2).argmax(axis=1),
    )
    return seen, answers


def _turned(log_likelihood: FloatArray, classes: PoseClasses, wanted: int, ray: float) -> FloatArray:
    """Likelihoods (n, wanted) in the world of those (n, n_pan) in the image; rows sum to 1."""
    at = np.broadcast_to(PoseClasses.circle(wanted).pan - ray, (len(log_likelihood), wanted))
    found = interpolated(np.exp(log_likelihood), classes, at)
    return np.asarray(found / found.sum(axis=1, keepdims=True), float)


def known_poses(
    everyone: Mapping[str, TrackSet],
    body: FeatureClassifier,
    head: FeatureClassifier,
    rng: np.random.Generator,
    progress: Callable[[int], object],
) -> tuple[list[Scores], list[Answers]]:
    """Errors of every method of `chen-classes`, by source, and the answers that they were made of."""
    found, answers = [], []
    for name, tracks in everyone.items():
        seen = []
        for track in tracks:
            one, of_one = classified(track, body, head, rng)
            seen.append(one)
            answers.append(of_one)
        found.append(scores(name, tracks.with_tracks(seen), lambda count: None))
        progress(1)
    return found, answers


def confusions(answers: list[Answers], head: PoseClasses) -> tuple[Table, Table, Table]:
    """Answers by true class, in per cent of the true class: of the body, the head's pan and its tilt."""

    def joined(name: str) -> NDArray[np.int64]:
        return np.concatenate([getattr(one, name) for one in answers])

    def degrees(count: int) -> list[str]:
        return [f"{360 * k // count}°" for k in range(count)]

    return (
        _confusion("body, by `body_pose`", degrees(BODY_CLASSES), joined("body"), joined("said_body")),
        _confusion("the head's pan", degrees(head.n_pan), joined("pan"), joined("said_pan")),
        _confusion("the head's tilt", list(LEVELS), joined("tilt"), joined("said_tilt")),
    )


def _confusion(of: str, names: list[str], true: NDArray[np.int64], said: NDArray[np.int64]) -> Table:
    records: list[dict[str, Cell]] = []
    for k, name in enumerate(names):
        answered = np.bincount(said[true == k], minlength=len(names))
        pictures = int(answered.sum())
        row: dict[str, Cell] = {"true": name, "pictures": pictures}
        for other, count in zip(names, answered.tolist(), strict=True):
            row[other] = 100.0 * count / pictures if pictures else None
        records.append(row)
    return Table.of(f"Confusion in per cent of the true class: {of}", records)
