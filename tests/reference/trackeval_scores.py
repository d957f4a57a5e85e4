"""TrackEval's figures for identified rows.

It is installed by ``pip install --no-deps trackeval==1.3.0``, as in the Makefile: opencv-python, for which
it asks, would take the place of the opencv-python-headless that the package needs.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from graphtrack.evaluation.matching import IdentifiedRows

COUNTS = {"matches": "CLR_TP", "misses": "CLR_FN", "false_positives": "CLR_FP", "switches": "IDSW"}
COUNTS |= {"fragmentations": "Frag", "mostly_tracked": "MT", "partly_tracked": "PT", "mostly_lost": "ML"}
SHARES = {"mota": "MOTA", "motp": "MOTP", "precision": "CLR_Pr", "recall": "CLR_Re"}
SHARES |= {"idf1": "IDF1", "idp": "IDP", "idr": "IDR"}
MEANS = {"hota": "HOTA", "det_a": "DetA", "ass_a": "AssA", "loc_a": "LocA"}
CURVES = ("HOTA", "DetA", "AssA", "DetRe", "DetPr", "AssRe", "AssPr", "LocA")
"""Ours → theirs; curves have one name."""

Pair = tuple[IdentifiedRows, IdentifiedRows]
"""Estimates and truth."""


def oracle(pairs: Sequence[Pair], *, metres: float | None = None, iou: float | None = None) -> dict[str, Any]:
    """TrackEval's scores of all pairs together, by our names."""
    from trackeval.metrics import CLEAR, HOTA, Identity

    config = {"THRESHOLD": 0.5 if iou is None else iou, "PRINT_CONFIG": False}
    data = {f"{k:03d}": _data(estimates, truth, metres) for k, (estimates, truth) in enumerate(pairs)}
    said: dict[str, Any] = {}
    for metric in (HOTA(), CLEAR(config), Identity(config)):
        of_each = {name: metric.eval_sequence(one) for name, one in data.items()}
        said |= metric.combine_sequences(of_each) if len(data) > 1 else next(iter(of_each.values()))
    found: dict[str, Any] = {name: int(said[theirs]) for name, theirs in COUNTS.items()}
    found |= {name: float(said[theirs]) for name, theirs in SHARES.items()}
    found |= {name: float(np.mean(said[theirs])) for name, theirs in MEANS.items()}
    return found | {"curves": {name: said[name].tolist() for name in CURVES}}


def _data(estimates: IdentifiedRows, truth: IdentifiedRows, metres: float | None) -> dict[str, Any]:
    """One sequence as TrackEval's metrics take it."""
    from trackeval.datasets._base_dataset import _BaseDataset

    true_ids, true_person = np.unique(truth.track_id, return_inverse=True)
    ids, person = np.unique(estimates.track_id, return_inverse=True)
    frames = np.unique(np.concatenate([truth.frame, estimates.frame]))
    similarity = []
    for frame in frames:
        both = truth.place[truth.frame == frame], estimates.place[estimates.frame == frame]
        similarity.append(
            _BaseDataset._calculate_box_ious(*both)
            if metres is None
            else _BaseDataset._calculate_euclidean_similarity(*both, zero_distance=2.0 * metres)
        )
    return {
        "num_timesteps": len(frames),
        "num_gt_ids": len(true_ids),
        "num_tracker_ids": len(ids),
        "num_gt_dets": len(truth),
        "num_tracker_dets": len(estimates),
        "gt_ids": [true_person[truth.frame == frame] for frame in frames],
        "tracker_ids": [person[estimates.frame == frame] for frame in frames],
        "similarity_scores": similarity,
    }


def without_curves(figures: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in figures.items() if name != "curves"}
