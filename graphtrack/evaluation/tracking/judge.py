"""`score`: from files or tracks to figures."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial, reduce
from operator import add
from pathlib import Path
from typing import TYPE_CHECKING

from graphtrack.association.reading import tracks_of
from graphtrack.bounds import check_positive
from graphtrack.errors import InputError
from graphtrack.evaluation.tracking.detections import (
    Detections,
    boxes,
    estimated_detections,
    missing_in_words,
    true_detections,
)
from graphtrack.evaluation.tracking.scores import TOGETHER, Threshold, TrackingScore, count, figures
from graphtrack.evaluation.tracking.similarity import (
    Similarity,
    box_similarity,
    ground_similarity,
    share_frames,
)
from graphtrack.io.pairs import paired_files
from graphtrack.io.reading import read_boxes

if TYPE_CHECKING:
    from graphtrack.io.given import Given

METRES = 1.0
"""Within which positions can be the same person's where nothing else is said, as in MOTChallenge 3D."""

Pair = tuple[str, Detections, Detections]
"""Name of a sequence, its estimates and its truth."""


def score(
    estimates: Given, truth: Given, *, metres: float | None = None, iou: float | None = None
) -> TrackingScore:
    """Score tracks and identities: HOTA, IDF1, MOTA and their parts.

    Parameters
    ----------
    estimates, truth : of one sequence, tracks in any form that `smooth` takes; of several, two folders or two
        lists of files, with files of the same names. With ``iou``, files of a format that holds boxes. Of a
        truth with true positions (``true_x``, ``true_y``) these are compared, else its positions.
    metres : how far apart on the ground a match may be; 1 m if ``iou`` is not given either
    iou : how much boxes must overlap to match, as intersection over union

    Raises
    ------
    InputError
        For both demands at once, or one out of range; files that do not pair up or cannot be read; a truth in
        which nobody is anywhere, or that has no frame in common with the estimates.
    """
    threshold = threshold_of(metres, iou)
    files, true_files = _paths(estimates), _paths(truth)
    pairs: Iterable[tuple[str, Given, Given]] = [("", estimates, truth)]
    if files and true_files:
        pairs = [(name, *pair) for name, pair in paired_files(files, true_files).items()]
    detect = _boxes_of if threshold.measure == "iou" else _positions_of
    return judge((detect(*pair) for pair in pairs), threshold)


def threshold_of(metres: float | None = None, iou: float | None = None) -> Threshold:
    """The demand on a match: a distance on the ground, unless an overlap in the image is asked for.

    Raises
    ------
    InputError
        For both, or one out of range.
    """
    if metres is not None and iou is not None:
        raise InputError("metres and iou", "one of them: matches on the ground or in the image")
    check_positive("metres", metres, 1e6)
    check_positive("iou", iou, 1.0)
    if iou is not None:
        return Threshold("iou", iou)
    return Threshold("metres", METRES if metres is None else metres)


def judge(pairs: Iterable[Pair], threshold: Threshold) -> TrackingScore:
    """Compare the sequences one by one, and sum up.

    Raises
    ------
    InputError
        For a sequence without a frame in common.
    """
    similarity = similarity_of(threshold)
    counts, notes = {}, []
    for name, estimates, truth in pairs:
        counts[name] = count(share_frames(truth, estimates, similarity, name), threshold)
        notes += [f"{name}: {note}" if name else note for note in missing_in_words(truth, estimates)]
    return TrackingScore(
        sequences=tuple(figures(name, of_sequence, threshold) for name, of_sequence in counts.items()),
        together=figures(TOGETHER, reduce(add, counts.values()), threshold),
        threshold=threshold,
        notes=tuple(notes),
    )


def similarity_of(threshold: Threshold) -> Similarity:
    """The similarity of two detections for a threshold."""
    if threshold.measure == "iou":
        return box_similarity
    # Zero at twice the distance: then a similarity of one half stands for the distance itself.
    return partial(ground_similarity, zero_distance=2.0 * threshold.value)


def _paths(given: Given) -> list[Path] | None:
    """The paths, where that is what is given."""
    several = given if isinstance(given, list | tuple) else [given]
    found = [Path(one) for one in several if isinstance(one, str | Path)]
    return found if found and len(found) == len(several) else None


def _positions_of(name: str, estimates: Given, truth: Given) -> Pair:
    return name, estimated_detections(tracks_of(estimates)), true_detections(tracks_of(truth))


def _boxes_of(name: str, estimates: Given, truth: Given) -> Pair:
    for given in (estimates, truth):
        if not isinstance(given, str | Path):
            raise InputError(f"a {type(given).__name__}, which has no boxes", "with iou the path of a file")
    return name, boxes(read_boxes(estimates)), boxes(read_boxes(truth))  # type: ignore[arg-type]
