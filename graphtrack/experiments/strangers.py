"""Groups that are found among people who are independent of each other, and true groups that are kept."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from graphtrack.errors import InputWarning
from graphtrack.evaluation.groups import average_linkage
from graphtrack.experiments.harness import (
    SALSA,
    Cell,
    Experiment,
    Panel,
    Parts,
    Progress,
    Settings,
    Table,
)
from graphtrack.geometry.angles import FloatArray, direction, wrap
from graphtrack.interaction.group_files import UNLABELLED, read_groups
from graphtrack.interaction.groups import Groups, groups
from graphtrack.interaction.parameters import DEFAULT, GroupParameters
from graphtrack.interaction.people import people_of
from graphtrack.interaction.scores import score_groups
from graphtrack.model import Model
from graphtrack.simulation.crowd import CrossedArea, crowd
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.scenario import party
from graphtrack.smoothing import smooth
from graphtrack.tracks.track import Track, TrackSet

SIDES = (8.0, 12.0, 18.0)
"""Metres of the squares that walkers cross."""
PEOPLE = 20
"""People in a square at a time, about."""
STOPPING = (0.0, 0.5)
"""Shares of walkers who stop on their way, for 4 s on average."""
SEEDS, PARTIES = 6, 4
POSITION_STD, HEAD_KAPPA = 0.1, 4.0
"""Metres and concentration of the noise."""
SPLIT = 1000.0
"""Seconds at which SALSA's rows are split; the values of the parameters were compared on the rows before."""
RECORDINGS: Mapping[str, tuple[str, ...]] = {
    "ucy/zara01": ("ucy", "zara01", "annotation.vsp"),
    "eth/seq_hotel": ("eth", "seq_hotel", "obsmat.txt"),
}
"""Recordings of pedestrians, whose people are shown at random times."""
GROUPS = ("salsa", "groups.txt")

_STOP_SECONDS, _FPS, _SECONDS = 4.0, 5.0, 60.0
_GLANCE, _GLANCE_SECONDS, _SLOW = 0.4, 3.0, 0.3
_HZ = 2.5

BEFORE = replace(DEFAULT, encounter_odds=0.0)
PARAMETERS: Mapping[str, GroupParameters] = {"without": BEFORE, "with": DEFAULT}
"""Without the odds against groups of people who just met, and with them."""
EVIDENCE: Mapping[str, str] = {"positions": "position", "positions and heads": "joint"}
"""Observations → the model that smooths them."""
WAYS = {"offline": False, "online": True}


def independent_walkers(
    rng: np.random.Generator, side: float, stops: float, seconds: float = _SECONDS
) -> TrackSet:
    """People who cross a square alone, each without regard to the others.

    Bodies point along the way, or in the last walking direction when standing; heads glance aside (0.4 rad).

    Parameters
    ----------
    side : of the square, m
    stops : share of the people who stop once, for 4 s on average
    """
    crossing = 0.75 * side / 1.3 + stops * _STOP_SECONDS
    place = CrossedArea(side, side, PEOPLE / crossing, pairs=0.0, stops=stops, stop_seconds=_STOP_SECONDS)
    people = crowd(rng, place=place, seconds=seconds, fps=_FPS)
    return people.with_tracks(_faced(track, rng) for track in people if len(track) > 1)


def _faced(track: Track, rng: np.random.Generator) -> Track:
    velocity = np.gradient(track.position, track.t, axis=0)
    slow = np.hypot(*velocity.T) < _SLOW
    last = np.maximum.accumulate(np.where(slow, 0, np.arange(len(track))))
    body = direction(velocity)[last]
    keep = np.exp(-1.0 / (_FPS * _GLANCE_SECONDS))
    glance: FloatArray = _GLANCE * rng.standard_normal(len(track))
    for k in range(1, len(track)):
        glance[k] = keep * glance[k - 1] + np.sqrt(1.0 - keep**2) * glance[k]
    return replace(track, body=body, head=wrap(body + glance))


def estimated(people: TrackSet, evidence: str, rng: np.random.Generator) -> TrackSet:
    """Estimates of people from noisy positions, and heads where they are part of the evidence."""
    preset = EVIDENCE[evidence]
    heads = HEAD_KAPPA if preset == "joint" else 0.0
    noisy = add_noise(people, position_std=POSITION_STD, body_kappa=0.0, head_kappa=heads, rng=rng)
    return smooth(noisy, Model(preset))


def at_random_times(people: TrackSet, rng: np.random.Generator) -> TrackSet:
    """Return people of a recording, each shifted to a random time, so that there are no groups.

    A person observed alone for long is placed among people from earlier or later times. Tracks that
    would go on after the end begin earlier.
    """
    begin, end = (f(track.t[k] for track in people) for f, k in ((min, 0), (max, -1)))

    def moved(track: Track) -> Track:
        latest = end - float(track.t[-1] - track.t[0])
        steps = round((float(rng.uniform(begin, latest)) - begin) * _HZ)
        kept = np.unique(np.round((track.t - track.t[0]) * _HZ).astype(np.int64), return_index=True)
        frame = steps + kept[0]
        return Track(track.track_id, frame, frame / _HZ, track.position[kept[1]])

    return people.with_tracks(moved(track) for track in people)


def shares(found: Groups) -> tuple[float, float]:
    """Per cent of person-frames in a conversation, and in a group that walks."""
    conversing, walking = (100.0 * float(np.mean(found.kind == kind)) for kind in (1, 2))
    return conversing, walking


Scene = tuple[dict[str, Cell], TrackSet]
"""Columns that describe a scene, and its people, none of whom is in a group."""


def _walkers(settings: Settings) -> Iterator[Scene]:
    for side, stops, evidence, seed in product(SIDES, STOPPING, EVIDENCE, range(settings.few(SEEDS))):
        rng = settings.rng(seed)
        people = estimated(independent_walkers(rng, side, stops), evidence, rng)
        yield {"side (m)": side, "who stop (%)": 100.0 * stops, "evidence": evidence}, people


def _recorded(settings: Settings) -> Iterator[Scene]:
    for name, parts in RECORDINGS.items():
        known = settings.tracks(*parts)
        for seed in range(settings.few(SEEDS) if known else 0):
            assert known is not None
            yield {"people of": name}, at_random_times(known, settings.rng(seed, 1))


def _false_groups(scenes: Iterator[Scene], progress: Progress) -> list[dict[str, Cell]]:
    """Means of `shares` over the scenes that are alike, without and with the odds, offline and online."""
    names = [f"{kind}, {name} (%)" for name in PARAMETERS for kind in ("conversing", "walking")]
    found: dict[tuple[tuple[str, Cell], ...], list[list[float]]] = {}
    for about, people in scenes:
        for way, online in WAYS.items():
            pairs = (shares(groups(people, one, online=online)) for one in PARAMETERS.values())
            key = (*about.items(), ("way", way))
            found.setdefault(key, []).append([value for pair in pairs for value in pair])
        progress(1)
    return [
        dict(key) | dict(zip(names, np.mean(values, axis=0).tolist(), strict=True))
        for key, values in found.items()
    ]


def _kept(settings: Settings) -> Iterator[dict[str, Cell]]:
    """F1 of true groups, without and with the odds, and of average linkage, which is the same online."""
    for name, scenes in _labelled(settings):
        for way, online in WAYS.items():
            row: dict[str, Cell] = {"people": name, "way": way}
            for label, parameters in PARAMETERS.items():
                found = [groups(people, parameters, online=online) for people, _ in scenes]
                row |= _f1(label, [one.group for one in found], found, scenes)
            linked = [average_linkage(people_of(people)) for people, _ in scenes]
            yield row | _f1("average linkage", linked, found, scenes)
        settings.progress(1)


Truth = Mapping[tuple[int, int], int]
"""Frame and person → group."""


def _f1(
    name: str,
    labels: Sequence[np.ndarray],
    rows: Sequence[Groups],
    scenes: Sequence[tuple[TrackSet, Truth]],
) -> dict[str, Cell]:
    """F1 of labels of the people and frames of ``rows``, means over the scenes."""
    scores = [
        score_groups(row.frame, row.track_id, label, _labels(row, truth)).f1
        for label, row, (_, truth) in zip(labels, rows, scenes, strict=True)
    ]
    shares = zip(("2/3", "all"), np.mean(scores, axis=0).tolist(), strict=True)
    return {f"F1 {share}, {name}": value for share, value in shares}


def _labels(found: Groups, truth: Truth) -> np.ndarray:
    rows = zip(found.frame.tolist(), found.track_id.tolist(), strict=True)
    return np.array([truth.get(row, UNLABELLED) for row in rows], dtype=np.int64)


def _labelled(settings: Settings) -> Iterator[tuple[str, list[tuple[TrackSet, Truth]]]]:
    for evidence in EVIDENCE:
        scenes: list[tuple[TrackSet, Truth]] = []
        for seed in range(settings.few(PARTIES)):
            rng = settings.rng(seed, 2)
            known = party(rng, people=12, steps=300, fps=2.0)
            columns = known.group_columns()
            keys = zip(columns["frame"].tolist(), columns["track_id"].tolist(), strict=True)
            truth = dict(zip(keys, columns["group"].tolist(), strict=True))
            scenes.append((estimated(known.tracks, evidence, rng), truth))
        yield f"simulated parties, {evidence}", scenes
    recorded, labels = settings.tracks(*SALSA), settings.recording(*GROUPS)
    if recorded is None or labels is None:
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        known_groups = read_groups(labels)
        for name, begin, end in (
            ("SALSA to 1000 s", -np.inf, SPLIT),
            ("SALSA from 1000 s", SPLIT, np.inf),
        ):
            people = recorded.map(
                lambda track, b=begin, e=end: track[(track.t >= b) & (track.t < e)]  # type: ignore[misc]
            )
            frame, t = (np.concatenate([getattr(track, key) for track in people]) for key in ("frame", "t"))
            person = np.repeat([track.track_id for track in people], [len(track) for track in people])
            keys = zip(frame.tolist(), person.tolist(), strict=True)
            truth = dict(zip(keys, known_groups.labels(frame, t, person).tolist(), strict=True))
            yield f"{name}, bodies and heads", [(people, truth)]
            yield (
                f"{name}, positions",
                [(people.map(lambda track: replace(track, body=None, head=None)), truth)],
            )


def _parts(settings: Settings) -> Parts:
    seeds = settings.few(SEEDS)
    there = sum(settings.recording(*parts) is not None for parts in RECORDINGS.values())
    salsa = all(settings.recording(*parts) for parts in (SALSA, GROUPS))
    settings.expect(seeds * (len(SIDES) * len(STOPPING) * len(EVIDENCE) + there) + len(EVIDENCE) + 4 * salsa)
    walkers = _false_groups(_walkers(settings), settings.progress)
    yield Table.of("Independent walkers in groups, simulated", walkers)
    if recorded := _false_groups(_recorded(settings), settings.progress):
        yield Table.of("Recorded people at random times in groups", recorded)
    yield Table.of("True groups", _kept(settings))
    for evidence in EVIDENCE:
        rows: list[dict[str, Cell]] = [
            {
                "side (m)": row["side (m)"],
                "share": row[f"conversing, {name} (%)"],
                "by": f"{row['way']}, {name}",
            }
            for row in walkers
            if row["who stop (%)"] and row["evidence"] == evidence
            for name in PARAMETERS
        ]
        yield Panel(f"walkers who stop, {evidence}: “conversing” (%)", rows, "side (m)", "share", "by")
    yield (
        f"Per cent of person-frames, means of {seeds} seeds. Nobody is in a group: "
        f"simulated walkers, {PEOPLE} in a square at a time, each on a course of their own, "
        f"σ = {POSITION_STD} m, head κ = {HEAD_KAPPA:g}; recorded people, each shifted to a random time."
    )
    yield "Without and with the log odds against groups of people who just met (encounter_odds)."


EXPERIMENT = Experiment(
    "strangers",
    "no paper's: groups found among independent people, and true groups kept",
    f"about {PEOPLE} people at a time, one seed",
    _parts,
)
