"""People who cross a place, their detections, and the accuracy of their identities."""

from collections.abc import Iterator

import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.association.online import Decision, OnlineAssociation
from graphtrack.tracks.detections import Detections


def frames_of(detections: Detections) -> list[np.ndarray]:
    """The rows of each frame."""
    return [np.flatnonzero(detections.frame == frame) for frame in np.unique(detections.frame)]


def run_online(
    detections: Detections, association: OnlineAssociation | None = None, **shown: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[Decision]]:
    """First and last reported identities of each detection, and all decisions; ``shown``: its evidence."""
    association = OnlineAssociation() if association is None else association
    once = np.full(len(detections), -1)
    last, decisions, frames = once.copy(), [], frames_of(detections)
    for places in frames:
        own = {name: values[places] for name, values in shown.items()}
        found = association.update(float(detections.t[places[0]]), detections.position[places], **own)
        once[places] = last[places] = found.identity
        for one in found.revised:
            place = frames[one.frame][one.detection]
            assert last[place] == one.before != one.after
            last[place] = one.after
        decisions.append(found)
    return once, last, decisions


def street(
    rng: np.random.Generator,
    *,
    people: int = 12,
    frames: int = 60,
    noise: float = 0.1,
    miss: float = 0.0,
    false: float = 0.0,
    step: float = 0.4,
) -> tuple[Detections, np.ndarray]:
    """People who cross a place of 16 m × 16 m, and the person of each detection; −1: false."""
    rows, owners = [], []
    for person in range(people):
        side = rng.integers(4)
        start, end = rng.uniform(-8.0, 8.0, 2), rng.uniform(-8.0, 8.0, 2)
        start[side % 2], end[side % 2] = (-8.0, 8.0) if side < 2 else (8.0, -8.0)
        duration = int(np.hypot(*(end - start)) / (rng.uniform(1.0, 1.6) * step))
        first = rng.integers(max(frames - duration, 1))
        for k in range(first, min(first + duration, frames)):
            if rng.random() >= miss:
                place = start + (end - start) * (k - first) / duration
                rows.append((k, *(place + rng.normal(0.0, noise, 2))))
                owners.append(person)
    for k in range(frames):
        for _ in range(rng.poisson(false)):
            rows.append((k, *rng.uniform(-8.0, 8.0, 2)))
            owners.append(-1)
    order = rng.permutation(len(rows))
    table, whose = np.array(rows)[order], np.array(owners)[order]
    frame = table[:, 0].astype(np.int64)
    detections = Detections(frame, frame * step, table[:, 1:])
    return detections, whose[detections.row]


def crowd(rng: np.random.Generator, *, people: int, frames: int, step: float = 0.04) -> Iterator[np.ndarray]:
    """Each frame's detections (n, 2): people who wander in a square and never leave, 16 m² each."""
    side = 4.0 * np.sqrt(people)
    position, velocity = rng.uniform(0.0, side, (people, 2)), rng.normal(0.0, 1.0, (people, 2))
    for _ in range(frames):
        velocity = velocity + rng.normal(0.0, 0.05, (people, 2))
        position = position + step * velocity
        velocity = np.where((position < 0.0) | (position > side), -velocity, velocity)
        position = np.clip(position, 0.0, side)
        seen = position[rng.random(people) > 0.1]
        false = rng.uniform(0.0, side, (rng.poisson(0.02 * people), 2))
        yield rng.permutation(np.concatenate([seen + rng.normal(0.0, 0.05, seen.shape), false]))


def packed_square(
    rng: np.random.Generator,
    *,
    people: int,
    frames: int,
    step: float = 0.2,
    noise: float = 0.1,
    miss: float = 0.1,
    square_metres: float = 9.0,
) -> tuple[Detections, np.ndarray]:
    """People of 1.3 m/s who wander in a square, and the person of each detection; −1: nobody's.

    There is one false detection a frame for 50 people.
    """
    side = np.sqrt(square_metres * people)
    position, course = rng.uniform(0.0, side, (people, 2)), rng.uniform(-np.pi, np.pi, people)
    seen, owners = [], []
    for _ in range(frames):
        course = course + rng.normal(0.0, 0.3 * np.sqrt(step), people)
        velocity = 1.3 * np.column_stack([np.cos(course), np.sin(course)])
        position = position + step * velocity
        velocity = np.where((position < 0.0) | (position > side), -velocity, velocity)
        course, position = np.arctan2(velocity[:, 1], velocity[:, 0]), np.clip(position, 0.0, side)
        here = np.flatnonzero(rng.random(people) >= miss)
        false = rng.uniform(0.0, side, (rng.poisson(people / 50), 2))
        seen.append(np.concatenate([position[here] + rng.normal(0.0, noise, (len(here), 2)), false]))
        owners.append(np.concatenate([here, np.full(len(false), -1)]))
    frame = np.repeat(np.arange(frames), [len(places) for places in seen])
    detections = Detections(frame, frame * step, np.concatenate(seen))
    return detections, np.concatenate(owners)[detections.row]


def descriptors_of_people(
    rng: np.random.Generator, whose: np.ndarray, size: int = 8, noise: float = 0.3
) -> np.ndarray:
    """(n, size) descriptors of the detections of people (n,), similar within a person; −1: false."""
    people = rng.normal(0.0, 1.0, (whose.max() + 1, size))
    of_nobody = rng.normal(0.0, 1.0, (len(whose), size))
    shown = np.where(whose[:, None] >= 0, people[whose], of_nobody)
    return shown + rng.normal(0.0, noise, shown.shape)


def met_behind_a_pillar(rng: np.random.Generator, people: int = 8) -> tuple[Detections, np.ndarray]:
    """Two people who meet while hidden, and turn back, among others; and the person of each detection.

    Both reappear where the other would have by constant motion, so that motion alone swaps them.
    """
    rows, owners = [], []
    for k in range(50):
        along = abs(0.4 * 1.2 * (k - 35))
        for person in range(people):
            rows.append((k, 0.3 * k, 6.0 + 4.0 * person))
            owners.append(person)
        if along > 1.5:
            rows += [(k, along, 0.0), (k, -along, 0.0)]
            owners += [people, people + 1]
    table = np.array(rows)
    frame = table[:, 0].astype(np.int64)
    detections = Detections(frame, 0.4 * frame, table[:, 1:] + rng.normal(0.0, 0.05, (len(table), 2)))
    return detections, np.array(owners)[detections.row]


def idf1(found: np.ndarray, whose: np.ndarray) -> float:
    """F1 of the detections under the best pairing of tracks with people."""
    both = (found >= 0) & (whose >= 0)
    counts = np.zeros((found.max() + 1, whose.max() + 1))
    np.add.at(counts, (found[both], whose[both]), 1)
    right = counts[linear_sum_assignment(-counts)].sum()
    return float(2.0 * right / ((found >= 0).sum() + (whose >= 0).sum()))
