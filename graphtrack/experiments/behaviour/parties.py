"""Groups, orientations in groups, and gaze: on a recorded party and on simulated ones."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from graphtrack.errors import InputWarning
from graphtrack.evaluation.groups import compare_groups, registry
from graphtrack.experiments.harness import SALSA, Cell, Experiment, Panel, Parts, Settings, Table
from graphtrack.experiments.strangers import GROUPS, SPLIT
from graphtrack.geometry.angles import BoolArray, wrap
from graphtrack.interaction.attention import AttentionParameters, attention
from graphtrack.interaction.group_files import UNLABELLED, GroupLabels, read_groups
from graphtrack.interaction.scores import score_gaze
from graphtrack.interaction.tables import LookLabels
from graphtrack.learning.interaction import fit_attention
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.scenario import Party, party
from graphtrack.smoothing import smooth
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track, TrackSet

HIDDEN: Mapping[str, tuple[str, ...]] = {
    "positions, bodies and heads": (),
    "bodies": ("head",),
    "heads": ("body",),
    "positions": ("body", "head"),
}
"""Evidence for groups → channels that are hidden. Positions are always known."""

EVERY_THIRD = ("heads", "bodies")
"""Evidence for which a third of the people are tried too."""

MODELS: Mapping[str, str] = {"default": "joint", "social": "social"}
"""Name in the table → preset."""

WAYS: Mapping[str, Callable[[TrackSet, str], TrackSet]] = {
    "offline": lambda people, preset: smooth(people, preset),
    "online": lambda people, preset: track_online(people, preset),
}

HEAD_KAPPA, SEEDS = 2.3, 3
"""Concentration of the noise of observed heads, and draws of it; online there is the first alone."""

ANGLES = ("body", "head")

PARTIES, PEOPLE, STEPS, LEARNED_STEPS, FPS = 4, 12, 400, 600, 2.0
"""Simulated parties that are judged, their people and frames, frames of the party that parameters are learned
from, and frames a second."""

GAZE_KAPPA = 4.0
"""Concentration of the noise of heads at simulated parties."""

HEADS: Mapping[str, Callable[[TrackSet, np.random.Generator], TrackSet]] = {
    "exact": lambda people, rng: people,
    "noisy": lambda people, rng: add_noise(people, head_kappa=GAZE_KAPPA, rng=rng),
    "noisy, smoothed": lambda people, rng: smooth(add_noise(people, head_kappa=GAZE_KAPPA, rng=rng)),
}
"""Name in the table → observed or estimated heads of a party."""


def salsa(settings: Settings) -> tuple[TrackSet, GroupLabels] | None:
    """Return SALSA's people after `SPLIT`, and their groups; None if the recording is missing."""
    people, path = settings.tracks(*SALSA), settings.recording(*GROUPS)
    if people is None or path is None:
        return None
    end = SPLIT + 60.0 if settings.quick else np.inf
    people = people.map(lambda track: track[(track.t >= SPLIT) & (track.t < end)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return people, read_groups(path)


def with_evidence(people: TrackSet, hidden: tuple[str, ...]) -> TrackSet:
    """Return people without some of the channels "body" and "head"."""
    return people.map(
        lambda track: replace(
            track,
            body=None if "body" in hidden else track.body,
            head=None if "head" in hidden else track.head,
        )
    )


def among(labels: GroupLabels, people: TrackSet) -> GroupLabels:
    """Return the labelled groups without those who are not among the people."""
    known = {track.track_id for track in people}
    steps = [
        replace(step, groups=tuple(kept for group in step.groups if (kept := group & known)))
        for step in labels.steps
    ]
    return replace(labels, steps=tuple(steps))


def _groups(people: TrackSet, labels: GroupLabels) -> Iterator[dict[str, Cell]]:
    few = people.with_tracks(people.tracks[::3])
    cases = [(evidence, people) for evidence in HIDDEN] + [(evidence, few) for evidence in EVERY_THIRD]
    for evidence, some in cases:
        found = compare_groups(with_evidence(some, HIDDEN[evidence]), among(labels, some))
        for method in registry:
            two_thirds, everyone = found.scores[method].f1
            yield {
                "evidence": evidence,
                "people": len(some),
                "method": method,
                "F1, two thirds": two_thirds,
                "F1, all members": everyone,
            }


def members(people: TrackSet, labels: GroupLabels) -> list[tuple[BoolArray, BoolArray]]:
    """Return for each person the frames (n,) as a labelled member of a group, and alone."""
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        frame, t = (np.concatenate([getattr(track, key) for track in people]) for key in ("frame", "t"))
        person = np.repeat([track.track_id for track in people], [len(track) for track in people])
        label = labels.labels(frame, t, person)
    for track in people:
        own = label[person == track.track_id]
        found.append((own >= 0, (own < 0) & (own != UNLABELLED)))
    return found


def mean_error(estimates: TrackSet, people: TrackSet, angle: str, used: list[BoolArray]) -> float:
    """Return the mean error in degrees of an angle, "body" or "head", over the frames that are used."""
    off = [
        np.abs(wrap(getattr(one, angle) - getattr(true, angle)))[rows]
        for one, true, rows in zip(estimates, people, used, strict=True)
    ]
    return float(np.degrees(np.nanmean(np.concatenate(off))))


def _orientations(people: TrackSet, labels: GroupLabels, settings: Settings) -> Iterator[dict[str, Cell]]:
    """Yield errors of bodies and heads by observation, way and model, of members and of people alone."""
    roles = dict(zip(("members", "alone"), zip(*members(people, labels), strict=True), strict=True))
    for observed, heads in (("positions", False), ("positions and heads", True)):
        for way, name in product(WAYS, MODELS):
            draws = settings.few(SEEDS) if heads and way == "offline" else 1
            found: dict[tuple[str, str], list[float]] = {}
            for seed in range(draws):
                estimates = WAYS[way](_observed(people, heads, settings.rng(seed, 1)), MODELS[name])
                for (role, used), angle in product(roles.items(), ANGLES):
                    error = mean_error(estimates, people, angle, list(used))
                    found.setdefault((role, angle), []).append(error)
            for role in roles:
                row: dict[str, Cell] = {"observed": observed, "way": way, "model": name, "people": role}
                yield row | {f"{angle} (°)": float(np.mean(found[role, angle])) for angle in ANGLES}
            settings.progress(1)


def _observed(people: TrackSet, heads: bool, rng: np.random.Generator) -> TrackSet:
    """Return exact positions, and noisy heads where they are observed."""
    observed = people.map(lambda track: replace(track, body=None, head=track.head if heads else None))
    return add_noise(observed, head_kappa=HEAD_KAPPA, rng=rng) if heads else observed


def look_labels(known: Party) -> LookLabels:
    """Return the true gaze targets of a simulated party."""
    columns = known.look_columns()
    order = np.lexsort((columns["frame"], columns["track_id"]))
    frame, person, target = (columns[name][order] for name in ("frame", "track_id", "target"))
    return LookLabels(frame, person, target, Path("simulated party"))


def _positions_and_heads(known: Party) -> TrackSet:
    def hidden(track: Track) -> Track:
        return replace(track, body=None, true_body=None)

    return known.tracks.map(hidden)


def _attention(settings: Settings) -> Iterator[dict[str, Cell]]:
    """Yield calibration errors of gaze by heads, parameters and way."""
    steps, learned_steps = settings.few(STEPS, 60), settings.few(LEARNED_STEPS, 80)
    learned_from = party(settings.rng(0, 3), people=PEOPLE, steps=learned_steps, fps=FPS)
    judged = [
        party(settings.rng(1 + k, 3), people=PEOPLE, steps=steps, fps=FPS)
        for k in range(settings.few(PARTIES))
    ]
    for heads, observe in HEADS.items():
        observed = observe(_positions_and_heads(learned_from), settings.rng(0, 4))
        learned = fit_attention(observed, look_labels(learned_from), hold_out=0.0).parameters
        scenes = [observe(_positions_and_heads(one), settings.rng(1 + k, 4)) for k, one in enumerate(judged)]
        for name, online in product(("default", "learned"), (False, True)):
            parameters = learned if name == "learned" else AttentionParameters()
            scores = [
                score_gaze(attention(some, parameters=parameters, online=online), look_labels(one))
                for some, one in zip(scenes, judged, strict=True)
            ]
            yield {
                "heads": heads,
                "parameters": name,
                "way": "online" if online else "offline",
                "likeliest target correct (%)": 100.0 * float(np.mean([one.right for one in scores])),
                "calibration error": float(np.mean([one.calibration_error for one in scores])),
                "calibration error, all targets": float(
                    np.mean([one.target_calibration_error for one in scores])
                ),
            }
        settings.progress(1)


def _parts(settings: Settings) -> Parts:
    recorded = salsa(settings)
    settings.expect(len(HEADS) + (0 if recorded is None else 1 + 2 * len(WAYS) * len(MODELS)))
    if recorded is not None:
        found = Table.of("Groups at a recorded party", _groups(*recorded))
        settings.progress(1)
        yield found
        errors = Table.of("Bodies and heads at a recorded party", _orientations(*recorded, settings))
        yield errors
        everyone_of = [row for row in found.records() if row["people"] == len(recorded[0])]
        yield Panel("groups: F1, two thirds", everyone_of, "evidence", "F1, two thirds", "method")
        own = [row for row in errors.records() if row["people"] == "members"]
        for angle in ANGLES:
            rows = [{**row, "by": f"{row['model']}, {row['way']}"} for row in own]
            yield Panel(f"members: {angle} (°)", rows, "observed", f"{angle} (°)", "by")
    yield Table.of("Gaze at simulated parties", _attention(settings))
    yield (
        f"SALSA from t = {SPLIT:g} s: nothing was compared on these rows. F1 of groups of which two thirds, "
        "or all, of the members are found; the table of a third of the people has every third of them."
    )
    yield (
        f"Bodies and heads: positions as annotated, heads with κ = {HEAD_KAPPA}, means of {SEEDS} draws "
        "(online one). Members and alone: as labelled."
    )
    yield (
        f"Gaze: {PARTIES} simulated parties of {PEOPLE} people, parameters learned from another one; noisy: "
        f"κ = {GAZE_KAPPA:g}; calibration errors in 15 bins."
    )


EXPERIMENT = Experiment(
    "parties",
    "no paper's: groups, orientations in groups and gaze, on a recorded party and simulated ones",
    "a minute of the recorded party, one simulated party",
    _parts,
)
