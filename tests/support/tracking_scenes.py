"""People and a bad tracker's output: misses, gaps, false positives, swaps and new identities."""

import numpy as np

from graphtrack.evaluation.matching import IdentifiedRows, known_detections
from graphtrack.tracks.track import Track, TrackSet

FRAMES = 40


def random_scene(seed: int, *, boxes: bool = False) -> tuple[IdentifiedRows, IdentifiedRows]:
    """Estimates and truth of a few people who walk in a crowd, on the ground or in the image."""
    rng = np.random.default_rng(seed)
    people = int(rng.integers(1, 7))
    frame, person = (part.ravel() for part in np.mgrid[0:FRAMES, 0:people])
    position = _walks(rng, people)[frame, person]
    present = _in_stretches(rng, people)[frame, person]
    seen = present & (rng.random(len(frame)) > 0.2 * rng.random())
    track = _identities(rng, people)[frame, person]
    noise = (0.1 + 0.5 * rng.random()) * (rng.random(position.shape) * 2.0 - 1.0)
    alarms = _false_alarms(rng)
    estimates = (
        np.concatenate([track[seen], alarms[0]]),
        np.concatenate([frame[seen], alarms[1]]),
        np.concatenate([(position + noise)[seen], alarms[2]]),
    )
    truth = person[present], frame[present], position[present]
    return tuple(_detections(rng, *rows, boxes) for rows in (estimates, truth))  # type: ignore[return-value]


def as_tracks(detections: IdentifiedRows) -> TrackSet:
    """Detections on the ground as tracks, at 10 Hz."""
    tracks = []
    for identity in np.unique(detections.track_id):
        own = detections.track_id == identity
        frame = detections.frame[own]
        tracks.append(Track(int(identity), frame, frame / 10.0, detections.place[own]))
    return TrackSet(tuple(tracks))


def _walks(rng: np.random.Generator, people: int) -> np.ndarray:
    """(FRAMES, people, 2) metres, in a place of some 4 m."""
    start = 4.0 * rng.random((people, 2))
    return start + np.cumsum(0.4 * (rng.random((FRAMES, people, 2)) - 0.5), axis=0)


def _in_stretches(rng: np.random.Generator, people: int) -> np.ndarray:
    """(FRAMES, people) presence: from some frame to another, with a gap."""
    k = np.arange(FRAMES)[:, None]
    begin, end = rng.integers(0, 10, people), rng.integers(25, FRAMES + 1, people)
    away = rng.integers(5, FRAMES, people)
    return (k >= begin) & (k < end) & ~((k >= away) & (k < away + rng.integers(0, 6, people)))


def _identities(rng: np.random.Generator, people: int) -> np.ndarray:
    """(FRAMES, people) the track that follows each; two swap now and then, and new tracks begin."""
    found, now, new = [], np.arange(people) + 50, 100
    for _ in range(FRAMES):
        chance = rng.random()
        if chance < 0.05:
            now = rng.permutation(now)
        elif chance < 0.1:
            now = now.copy()
            now[rng.integers(people)] = new = new + 1
        found.append(now)
    return np.array(found)


def _false_alarms(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Identities, frames and positions of false tracks, which stand still."""
    count, length = int(rng.integers(1, 4)), 8
    begin = rng.integers(0, FRAMES, count)
    frame = (begin[:, None] + np.arange(length)).ravel()
    return (
        np.repeat(np.arange(count) + 900, length),
        frame,
        np.repeat(4.0 * rng.random((count, 2)), length, axis=0),
    )


def _detections(
    rng: np.random.Generator, track_id: np.ndarray, frame: np.ndarray, position: np.ndarray, boxes: bool
) -> IdentifiedRows:
    if not boxes:
        return known_detections(track_id, frame, position)
    size = np.array([60.0, 150.0]) * (0.9 + 0.2 * rng.random((len(frame), 2)))
    return known_detections(track_id, frame, np.column_stack([100.0 * position, size]))
