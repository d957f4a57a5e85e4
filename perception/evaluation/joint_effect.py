"""What estimating body and head together makes of what is seen frame by frame (002 Table 2)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.inference import smooth
from graphtrack.tracks import Track, TrackSet
from perception.observe.pipeline import Models, observe_frame, to_tracks
from perception.pose.classes import PoseClasses
from perception.synthetic.clips import Clip


def observed(clip: Clip, models: Models) -> TrackSet:
    """The observations of a clip, as `perception observe` writes them."""
    seen = []
    for k, image in enumerate(clip.images):
        boxes = [item for item in clip.boxes if item.frame == k]
        seen += observe_frame(image, k, boxes, models, lambda reason: None)
    return to_tracks(seen, models.head_pose.classes, clip.camera, clip.fps).tracks


def joint_effect(clips: Iterable[Clip], models: Models) -> list[dict[str, str | float]]:
    """Mean errors in degrees of body and head over all person-frames of clips.

    Returns
    -------
    A row for each way: the most likely class of each frame, then offline smoothing with the presets
    "separate" and "joint".
    """
    errors: dict[str, list[tuple[FloatArray, FloatArray]]] = {}
    for clip in clips:
        seen = observed(clip, models)
        by_frame = TrackSet(tuple(_most_likely(track) for track in seen))
        ways = {"per frame": by_frame, "separate": smooth(seen, "separate"), "joint": smooth(seen, "joint")}
        for way, estimates in ways.items():
            for track in estimates:
                errors.setdefault(way, []).append(_errors(track, clip.truth[track.track_id]))
    rows: list[dict[str, str | float]] = []
    for way, found in errors.items():
        body, head = (np.concatenate([pair[k] for pair in found]) for k in (0, 1))
        rows.append(
            {
                "estimate": way,
                "body_deg": float(np.degrees(body.mean())),
                "head_deg": float(np.degrees(head.mean())),
                "person_frames": len(body),
            }
        )
    return rows


def _most_likely(track: Track) -> Track:
    assert track.body_likelihood is not None and track.head_likelihood is not None
    angles = [
        PoseClasses.circle(found.shape[1]).pan[found.argmax(axis=1)]
        for found in (track.body_likelihood, track.head_likelihood)
    ]
    return Track(track.track_id, track.frame, track.t, track.position, body=angles[0], head=angles[1])


def _errors(estimate: Track, truth: Track) -> tuple[FloatArray, FloatArray]:
    """Absolute errors (n,) in radians of body and head, at the frames of the estimate."""
    assert estimate.body is not None and estimate.head is not None
    assert truth.true_body is not None and truth.true_head is not None
    rows = np.searchsorted(truth.frame, estimate.frame)
    return (
        np.abs(difference(estimate.body, truth.true_body[rows])),
        np.abs(difference(estimate.head, truth.true_head[rows])),
    )
