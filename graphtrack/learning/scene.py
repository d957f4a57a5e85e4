"""`fit_scene`: birth, death and detection parameters of a scene, from detections or labelled tracks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.associate import detections_of, rows_of
from graphtrack.association.likelihood import Chains, chains_of, learn_orientation, link_by
from graphtrack.association.offline import associate_detections
from graphtrack.association.scene import (
    first_guess,
    gaps_of,
    learn_duplicates,
    learn_scene,
    scene_log_density,
)
from graphtrack.errors import InputError
from graphtrack.io.options import FileReading
from graphtrack.model import Model
from graphtrack.simulation.detector import FALSE
from graphtrack.tracks.detections import Detections
from graphtrack.tracks.scene import SceneParameters
from graphtrack.tracks.table import Rows, check_rows
from graphtrack.tracks.validation import check_within

if TYPE_CHECKING:
    from graphtrack.association.associate import Detected

ROUNDS = 6
"""Times that people are found and parameters learned from them, or from given tracks."""

_ANGLES = {
    "body": ("body_std", "body_turn", "body_outliers", "heading_std"),
    "head": ("head_std", "head_turn", "head_outliers", "gaze_std"),
}
SET = ("speed_std", "longest_gap", "longest_filled", "look_ahead")
"""Parameters that are set, and never learned."""


@dataclass(frozen=True)
class LearnedOfScene:
    """One parameter: its unit, where it started, and its value; ``note``: reason if not learned."""

    name: str
    unit: str
    start: float
    value: float
    note: str = ""


@dataclass(frozen=True)
class Part:
    """Numbers of a part of a recording, and its log density."""

    seconds: float
    detections: int
    people: int
    false: int
    before: float  # log density a detection with the parameters at the start
    after: float  # and with those learned


@dataclass(frozen=True, eq=False)
class SceneFit:
    """Learned parameters of a scene.

    Attributes
    ----------
    model : the given one, with what was learned
    start : where it began
    labelled : whether the identities were given; else people were found
    learned : every parameter that can be learned
    parts : "learned from" and, where something was held out, "held out"
    """

    model: Model
    start: SceneParameters
    labelled: bool
    learned: tuple[LearnedOfScene, ...]
    parts: dict[str, Part]

    def to_dict(self) -> dict[str, Any]:
        """Everything in plain types, ready for JSON."""
        return {
            "labelled": self.labelled,
            "model": self.model.to_dict(),
            "start": asdict(self.start),
            "learned": [asdict(one) for one in self.learned],
            "parts": {name: asdict(part) for name, part in self.parts.items()},
        }


def fit_scene(
    detections: Detected | Rows,
    model: Model | str | Path | None = None,
    *,
    labelled: bool | None = None,
    hold_out: float = 0.25,
    progress: Callable[[int, int], None] = lambda done, total: None,
    **options: Unpack[FileReading],
) -> SceneFit:
    """Learn the parameters of a scene.

    From detections alone: people are found, the parameters under which they are most probable are learned
    from them, and so on (expectation and maximisation, the former by the most probable explanation). From
    labelled tracks: the same parameters, of the people who are given. Raise InputError if the input cannot be
    read, no people are found, or requested labels are missing.

    Parameters
    ----------
    detections : one recording, in any form that `associate` takes. Where identities are given, rows with the
        identity −1 and tracks with the label "false" are false detections
    model : what the scene is learned for; its own scene is where learning begins. By default "joint"
    labelled : True to use the existing identities; None: if there are any
    hold_out : share of the recording, at its end, held out for validation, in [0, 0.9]
    progress : called with sweeps done and sweeps in all
    **options : of reading, as in `associate`

    Returns
    -------
    SceneFit
        Its model has the identified parameters of the scene; the others, such as the noise of detections that
        all declare their own, are left out, to be learned where the model is used.
    """
    model = Model.named(model)
    check_within(0.0, 0.9, hold_out=hold_out)
    rows = detections if isinstance(detections, Rows) else rows_of(detections, **options)
    labelled = rows.has_identity if labelled is None else labelled
    if labelled and not rows.has_identity:
        expected = "track_id in some rows at least, to learn a scene from labelled tracks"
        raise InputError("rows without identities", expected, path=rows.path)
    recording, given = _recording(rows, labelled)
    used, judging = _split(recording, hold_out)
    training = recording.taken(used)
    start = replace(first_guess(training), **model.scene)
    if labelled:
        explained = _Explained.of(training, given[used])
        found = _climbed(explained, start)
    else:
        association = associate_detections(training, progress=progress, start=start, rounds=ROUNDS)
        explained, found = _Explained.of(training, association.identity), association.scene
    if explained.identity.max() < 0:
        raise InputError("no people in the training detections", "people", path=rows.path)
    learned = tuple(_learned_rows(explained, labelled, start, found))
    shown: dict[str, Any] = {one.name: one.value for one in learned if not one.note}
    best = model.with_scene({**model.scene, **shown})
    found = replace(start, **shown)
    parts = {"learned from": explained.part(explained, start, found)}
    if len(judging):
        held = recording.taken(judging)
        before, after = (
            _Explained.of(held, given[judging] if labelled else associate_detections(held, scene).identity)
            for scene in (start, found)
        )
        parts["held out"] = before.part(after, start, found)
    return SceneFit(best, start, labelled, learned, parts)


@dataclass(frozen=True, eq=False)
class _Explained:
    """Detections and their identities (n,) from 0; −1: false."""

    detections: Detections
    identity: NDArray[np.int64]

    @classmethod
    def of(cls, detections: Detections, identity: NDArray[np.int64]) -> _Explained:
        """Return a copy with consecutive identities."""
        known = identity >= 0
        numbers = np.full(len(identity), -1)
        numbers[known] = np.unique(identity[known], return_inverse=True)[1]
        return cls(detections, numbers)

    @property
    def std(self) -> NDArray[np.float64]:
        """(n,) declared 1-σ of detections in metres; NaN: none."""
        return self.detections.channels.get("position_std", np.full(len(self.detections), np.nan))

    def chains(self, scene: SceneParameters) -> Chains:
        """The tracks, linked; not filtered yet."""
        chains = chains_of(self.detections)
        chains.gain[:] = 0.0
        chains.variance[:] = np.where(np.isnan(self.std), scene.position_std, self.std) ** 2
        link_by(chains, self.identity)
        return chains

    def density(self, scene: SceneParameters) -> float:
        """Log density a detection."""
        seconds = self.detections.step_seconds
        found = scene_log_density(self.chains(scene), self.identity, scene, seconds)
        return found / len(self.detections)

    def part(self, after: _Explained, start: SceneParameters, found: SceneParameters) -> Part:
        """This part of a recording, as it was explained before, and as it was after learning."""
        t, identity = self.detections.t, after.identity
        false, people = int((identity < 0).sum()), int(identity.max()) + 1
        seconds = float(t[-1] - t[0])
        return Part(seconds, len(t), people, false, self.density(start), after.density(found))


def _recording(rows: Rows, labelled: bool) -> tuple[Detections, NDArray[np.int64]]:
    """Detections, and the identities (n,) that they were given, −1: none, or false."""
    if labelled:
        check_rows(rows.taken(np.flatnonzero(rows.track_id != -1)))
    usable, detections = detections_of(rows)
    false = [identity for identity, label in usable.labels.items() if label == FALSE]
    nobody = np.isin(usable.track_id, [-1, *false])
    place = np.unique(usable.track_id, return_inverse=True)[1]
    return detections, np.where(nobody, -1, place)[detections.row]


def _split(recording: Detections, hold_out: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the training detections, and those held out at the end, if there are enough frames."""
    step = recording.step
    first = round((1.0 - hold_out) * (int(step[-1]) + 1))
    before, after = np.flatnonzero(step < first), np.flatnonzero(step >= first)
    enough = all(len(np.unique(step[part])) >= _FEWEST for part in (before, after))
    return (before, after) if enough else (np.arange(len(step)), after[:0])


_FEWEST = 10  # frames that a part of a recording has at least


def _climbed(explained: _Explained, start: SceneParameters) -> SceneParameters:
    """The parameters under which given tracks are most probable."""
    scene, chains = start, explained.chains(start)
    seconds, identity = explained.detections.step_seconds, explained.identity
    for _ in range(ROUNDS):
        scene = learn_duplicates(chains.frame, chains.position, identity, scene)
        scene = learn_orientation(chains, scene, seconds)
        scene = learn_scene(chains, identity, scene, explained.std, seconds)
    return scene


def _learned_rows(
    explained: _Explained, labelled: bool, start: SceneParameters, found: SceneParameters
) -> Iterable[LearnedOfScene]:
    """Return all learnable parameters, with the reasons for those that the recording does not identify."""
    chains = explained.chains(found)
    n_facing = np.isfinite(chains.facing).sum(axis=0)
    absent = {
        "position_std": "all detections declare their own" * bool(np.isfinite(explained.std).all()),
        "occlusion_seconds": "no gap in any track" * (not gaps_of(chains, explained.identity)[0].any()),
    }
    if labelled and (explained.identity >= 0).all():
        none = "no row without an identity or with the label 'false'"
        absent |= dict.fromkeys(("clutter_density", "duplicate_rate", "duplicate_spread"), none)
    for count, (kind, names) in zip(n_facing.tolist(), _ANGLES.items(), strict=True):
        if not count:
            absent |= dict.fromkeys(names, f"no {kind} observed")
    for one in fields(SceneParameters):
        if one.name in SET:
            continue
        before, after, note = getattr(start, one.name), getattr(found, one.name), absent.get(one.name, "")
        yield LearnedOfScene(one.name, one.metadata["unit"], before, before if note else after, note)
