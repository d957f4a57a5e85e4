"""Metrics of tracks and identities: HOTA, IDF1 and CLEAR MOT, on the ground or in the image."""

from graphtrack.evaluation.tracking.judge import score
from graphtrack.evaluation.tracking.scores import SequenceScore, TrackingScore

__all__ = ["SequenceScore", "TrackingScore", "score"]
