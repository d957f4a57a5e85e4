"""Identity switches of people who meet and turn, with and without body and head."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.likelihood import observed_angles
from graphtrack.association.offline import associate_detections
from graphtrack.association.online import OnlineAssociation
from graphtrack.experiments.harness import (
    BODY_KAPPA,
    HEAD_KAPPA,
    MOCAP,
    NO_MOCAP,
    Cell,
    Experiment,
    Panel,
    Parts,
    Settings,
    Table,
    thinned,
)
from graphtrack.geometry.angles import wrap
from graphtrack.simulation.degrade import add_noise
from graphtrack.tracks.detections import Detections
from graphtrack.tracks.track import Track, TrackSet

PAIRS, FEW = 120, 12
SEEDS = 3
POSITION_STDS = (0.05, 0.1)
"""Metres of noise on the positions."""
MISSED = 0.1
CLOSEST = 0.5
"""Metres between two who meet, at most."""
SECONDS = 3.0
"""Before and after the meeting."""

_TURN, _TURN_SECONDS, _SLOWEST = np.radians(45.0), 1.0, 0.4
"""Somebody turns where the mean directions of a second before and after differ so much, at so many m/s."""
_APART = 25.0
"""Distance in metres between pairs, which excludes confusions between pairs."""

IntArray: TypeAlias = NDArray[np.int64]
Tracker: TypeAlias = Callable[[Detections], IntArray]


def turns(track: Track) -> IntArray:
    """Places in a track at which the direction of travel turns by 45° or more."""
    reach = round(_TURN_SECONDS / float(np.median(np.diff(track.t))))
    if len(track) <= 2 * reach:
        return np.zeros(0, np.int64)
    ways = track.position[reach:] - track.position[:-reach]
    before, after = ways[:-reach], ways[reach:]
    angle = wrap(np.arctan2(after[:, 1], after[:, 0]) - np.arctan2(before[:, 1], before[:, 0]))
    slowest = np.minimum(np.hypot(*before.T), np.hypot(*after.T)) / _TURN_SECONDS
    return reach + np.flatnonzero((np.abs(angle) > _TURN) & (slowest > _SLOWEST))


def meetings(clips: TrackSet, pairs: int, rng: np.random.Generator) -> TrackSet:
    """Pairs of people who turn within half a metre of each other, at the same time, each pair by itself.

    Parameters
    ----------
    clips : people who are never missing, by the frame
    pairs : how many; two people each, whose clips differ, from any side
    """
    known = [(track, turning_points) for track in clips if len(turning_points := turns(track))]
    seconds = float(np.median(np.diff(clips.tracks[0].t)))
    reach, columns = round(SECONDS / seconds), int(np.ceil(np.sqrt(pairs)))
    people = []
    for pair in range(pairs):
        place = _APART * np.array([pair % columns, pair // columns])
        for one, chosen in enumerate(rng.choice(len(known), 2, replace=False)):
            track, turning_points = known[chosen]
            angle, meeting = rng.uniform(-np.pi, np.pi), int(rng.choice(turning_points))
            if one:
                away, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, CLOSEST)
                place = place + far * np.array([np.cos(away), np.sin(away)])
            frames = np.arange(max(0, meeting - reach), min(len(track), meeting + reach + 1))
            course = (track.position[frames] - track.position[meeting]) @ [1.0, 1.0j] * np.exp(1.0j * angle)
            position = np.column_stack([course.real, course.imag]) + place
            frame = frames - meeting + reach
            people.append(
                Track(
                    2 * pair + one,
                    frame,
                    (seconds * frame).astype(np.float64),
                    position,
                    body=wrap(track.body[frames] + angle),
                    head=wrap(track.head[frames] + angle),
                )
            )
    return TrackSet(tuple(people))


def detected(people: TrackSet, position_std: float, rng: np.random.Generator) -> tuple[Detections, IntArray]:
    """Detections of people in random order, and the person of each detection (n,)."""
    noisy = add_noise(
        people, position_std=position_std, body_kappa=BODY_KAPPA, head_kappa=HEAD_KAPPA, rng=rng
    )
    frame, t, position, body, head = (
        np.concatenate([getattr(one, name) for one in noisy])
        for name in ("frame", "t", "position", "body", "head")
    )
    whose = np.repeat([one.track_id for one in noisy], [len(one) for one in noisy])
    kept = rng.permutation(np.flatnonzero(rng.random(len(whose)) >= MISSED))
    detections = Detections(frame[kept], t[kept], position[kept], {"body": body[kept], "head": head[kept]})
    return detections, whose[kept][detections.row]


def offline(detections: Detections) -> IntArray:
    """Return the identity of each detection, from the whole recording; −1: none."""
    return associate_detections(detections).identity


def online(detections: Detections) -> IntArray:
    """Return the identity of each detection as reported online; below 1: none yet."""
    association, identity = OnlineAssociation({}, 2.0), np.zeros(len(detections), np.int64)
    facing = observed_angles(detections.channels, len(detections))
    for frame in np.unique(detections.frame):
        rows = np.flatnonzero(detections.frame == frame)
        nothing = np.full(len(rows), np.nan)
        decision = association.update(
            float(detections.t[rows[0]]), detections.position[rows], nothing, facing[rows], nothing, None
        )
        identity[rows] = decision.identity
    return np.where(identity > 0, identity, -1)


TRACKERS: Mapping[str, Tracker] = {"offline": offline, "online": online}
EVIDENCE: Mapping[str, tuple[str, ...]] = {
    "positions": (),
    "and body": ("body",),
    "and head": ("head",),
    "and both": ("body", "head"),
}
"""Channels that the trackers are given in addition to positions."""


def switches(whose: IntArray, identity: IntArray) -> int:
    """Number of detections with another identity than the person's previous one; −1: none."""
    changed = 0
    for person in np.unique(whose):
        known = identity[(whose == person) & (identity >= 0)]
        changed += int(np.count_nonzero(np.diff(known)))
    return changed


def _parts(settings: Settings) -> Parts:
    clips = settings.tracks(*MOCAP)
    if clips is None:
        yield NO_MOCAP
        return
    clips, pairs, seeds = clips.map(thinned), settings.few(PAIRS, FEW), settings.few(SEEDS)
    settings.expect(seeds * len(POSITION_STDS) * len(TRACKERS) * len(EVIDENCE))
    counts: dict[tuple[float, str, str], list[int]] = {}
    for seed in range(seeds):
        people = meetings(clips, pairs, settings.rng(seed))
        for std in POSITION_STDS:
            detections, whose = detected(people, std, settings.rng(seed, 1))
            for (way, tracker), (evidence, names) in product(TRACKERS.items(), EVIDENCE.items()):
                given = {name: detections.channels[name] for name in names}
                found = tracker(replace(detections, channels=given))
                counts.setdefault((std, way, evidence), []).append(switches(whose, found))
                settings.progress(1)
    table = Table.of("Identity switches, means and extremes of the seeds", _rows(counts))
    yield table
    for way in TRACKERS:
        rows = [row for row in table.records() if row[""] == way]
        yield Panel(f"identity switches, {way}", rows, "of", "switches", "σ (m)", ends=("least", "most"))
    yield (
        f"{pairs} pairs who turn by 45° or more within {CLOSEST} m of each "
        f"other, {SECONDS:g} s before and after, 10 frames a second, {100 * MISSED:.0f} % of the detections "
        f"missing, body κ = {BODY_KAPPA}, head κ = {HEAD_KAPPA} (Chen et al.'s noise), clips of "
        f"motion capture "
        "turned at random."
    )
    yield (
        "All pairs are in one recording, from which the scene's parameters are learned; online is without "
        "revision. A switch is a detection whose identity is not that of the person's one before."
    )


def _rows(counts: Mapping[tuple[float, str, str], list[int]]) -> Iterator[dict[str, Cell]]:
    for (std, way, evidence), found in counts.items():
        plain: Any = np.array(counts[std, way, "positions"], float)
        fewer = 100.0 * (1.0 - np.array(found) / np.maximum(plain, 1.0))
        yield {
            "": way,
            "σ (m)": std,
            "of": evidence,
            "switches": float(np.mean(found)),
            "least": min(found),
            "most": max(found),
            "fewer (%)": float(np.mean(fewer)),
            "fewer, least (%)": float(fewer.min()),
        }


EXPERIMENT = Experiment(
    "meetings",
    "no paper's: identities where people meet and turn, with and without body and head",
    f"{FEW} pairs, one seed",
    _parts,
)
