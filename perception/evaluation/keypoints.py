"""How good body and head by keypoints are, on rendered people whose skeleton is known."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray, difference
from perception.pose.calibration import reliability
from perception.pose.classes import PoseClasses
from perception.pose.keypoints.model import BODY, HEAD, KeypointPose
from perception.synthetic.joints import make_rendered_skeletons
from perception.synthetic.skeletons import NetworkErrors, Skeletons, make_skeletons, perceived

_SIZES = ((30.0, 50.0), (50.0, 100.0), (100.0, 200.0))
_NETWORKS = {
    "as in training": NetworkErrors(),
    "points half as far off": NetworkErrors(deviation=0.5, pixels=0.5),
    "points 1.5 times as far off": NetworkErrors(deviation=1.5, pixels=1.5),
    "left and right exchanged in a tenth": NetworkErrors(swapped=0.1),
    "without confidences": NetworkErrors(unsaid=1.0),
    "unsure points left out": NetworkErrors(cut=1.0, unsaid=0.0),
}


def keypoint_table(model: KeypointPose, count: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Rows of errors in degrees and calibration errors: sizes of people, and kinds of networks.

    Parameters
    ----------
    count : rendered people of each size
    """
    rows = []
    sets = [make_rendered_skeletons(count, rng, size) for size in _SIZES]
    for (least, most), people in zip(_SIZES, sets, strict=True):
        rows.append(_row(f"rendered, {least:g}-{most:g} pixels", model, people, NetworkErrors(), rng))
    for name, errors in _NETWORKS.items():
        rows.append(_row(f"rendered, all sizes: {name}", model, joined(sets), errors, rng))
    drawn = make_skeletons(3 * count, rng, (_SIZES[0][0], _SIZES[-1][1]))
    rows.append(_row("skeletons as in training", model, drawn, NetworkErrors(), rng))
    return rows


def joined(sets: list[Skeletons]) -> Skeletons:
    """All people together."""
    names = ("points", "visibility", "height", "body", "head")
    return Skeletons(*(np.concatenate([getattr(people, name) for people in sets]) for name in names))


def _row(
    name: str, model: KeypointPose, people: Skeletons, errors: NetworkErrors, rng: np.random.Generator
) -> dict[str, Any]:
    points = perceived(people.points, people.visibility, people.height, rng, errors)
    found: dict[str, Any] = {"people": name}
    parts = (("body", BODY, model.body, people.body), ("head", HEAD, model.head, people.head))
    for part, classes, layers, angle in parts:
        of_part = _figures(classes, layers.log_likelihoods(points), angle)
        found |= {f"{part}_{figure}": value for figure, value in of_part}
    return found


def _figures(
    classes: PoseClasses, log_likelihood: FloatArray, angle: FloatArray
) -> Iterator[tuple[str, float]]:
    error = np.degrees(np.abs(difference(classes.mean_pan(log_likelihood), angle)))
    yield "mean_deg", float(error.mean())
    yield "median_deg", float(np.median(error))
    yield "beyond_90_percent", 100.0 * float((error > 90.0).mean())
    curve = reliability(log_likelihood, classes.index(angle))
    yield "calibration_error", curve.expected_calibration_error
