"""Fit and reliability of the confidence of `perception follow`, on rendered and real sequences.

Sequences of rendered people, of Oxford Town Centre, of CAVIAR's lobby and corridor; a fifth of the runs start
on the background, where nothing is the target. People and sequences that are judged are not fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.experiments.harness import Cell, Progress, Row, Table
from graphtrack.geometry.angles import FloatArray, direction
from perception.evaluation.found_people import calibration_error
from perception.experiments.sigma_pi_runs import LabelledPerson, recordings, run_all
from perception.experiments.street_heads import STEP, head_boxes, labelled_runs
from perception.following.confidence import (
    FEATURES,
    KINDS,
    START_LEAST,
    FollowConfidence,
    FollowEvidence,
    fitted_pan,
    fitted_start,
    fitted_weights,
    kind_of,
    load_confidence,
    relative,
    tempered,
)
from perception.images.frames import FrameSource
from perception.images.pixels import Image, intersection_over_union
from perception.storage import ModelCard
from perception.synthetic.ceiling import ALL_KINDS, CEILING_RATE, ceiling_sequence
from perception.synthetic.clips import draw_walks
from perception.synthetic.head_clips import HeadClipParameters, head_clip
from perception.synthetic.scene import StillScene
from perception.trackers.registry import OF_HEADS, TRACKERS, WITH_BACKGROUND, make_tracker

SEQUENCES, _TOWN, _LOBBY = 8, 10, 3
"""Rendered sequences of each kind that the package's confidence is fitted to, and judged on; people of Town
Centre, and of each recording of CAVIAR."""
_BACKGROUND = ", background"
_NOBODY = np.full(4, np.nan)
_VISIBLE = 0.3
"""Share of a rendered person that must be visible for a box to be on them."""
_HEAD_OF_BODY = np.array([0.29, 0.0, 0.42, 0.16])
"""Box of a head in that of a body on the background, in its widths and heights."""


@dataclass(frozen=True, eq=False)
class TargetSequence:
    """A target in n frames.

    Attributes
    ----------
    name : of the sequence
    images : n images
    fps : frames a second
    body, head : (n, 4) true boxes in pixels, NaN where the target is not visible; None if not known
    pan : (n,) of the head, radians in the image frame; NaN where not known
    start : (2, 4) boxes of body and head to start with, on the background; None: the true ones
    """

    name: str
    images: Sequence[Image]
    fps: float
    body: FloatArray | None
    head: FloatArray | None
    pan: FloatArray
    start: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Samples:
    """Features (n, 6) of a run's frames, whether the box is on the target (n,), raw confidences (n,), and
    likelihoods of pans (n, k) with the true classes (n,), −1 if not known."""

    name: str
    tracker: str
    features: FloatArray
    on: FloatArray
    raw: FloatArray
    pan: FloatArray | None
    label: NDArray[np.int64]

    @property
    def rendered(self) -> bool:
        """Return True for a rendered sequence."""
        return self.name.startswith("rendered")

    @property
    def on_background(self) -> bool:
        """Return True if the run starts on the background."""
        return self.name.endswith(_BACKGROUND)


def is_on(box: Sequence[float], true: FloatArray) -> bool:
    """Return True if the middle of a box is in the true box (4,), which is NaN for a hidden target."""
    middle = np.array(box[:2]) + np.array(box[2:]) / 2.0
    return bool(((middle >= true[:2]) & (middle <= true[:2] + true[2:])).all())


def samples_of(target: TargetSequence) -> list[Samples]:
    """Follow a target with every tracker that can start on it."""
    found = []
    for tracker in TRACKERS:
        for of_head in (True, False) if tracker == "color" else (tracker in OF_HEADS,):
            truth, given = target.head if of_head else target.body, target.start
            if truth is None:
                continue
            first = truth[0] if given is None else given[1 if of_head else 0]
            if np.isfinite(first).all() or tracker in WITH_BACKGROUND:
                found.append(_run(target, tracker, truth, first))
    return found


def _run(target: TargetSequence, name: str, truth: FloatArray, first: FloatArray) -> Samples:
    tracker = make_tracker(name, rate=target.fps)
    later = target.images[min(round(target.fps), len(target.images) - 1)]
    evidence, classes = FollowEvidence(name, later), tracker.pan_classes
    rows: list[FloatArray] = []
    on: list[bool] = []
    raw: list[float] = []
    pans: list[FloatArray] = []
    labels: list[int] = []
    for k, image in enumerate(target.images):
        if k:
            estimate = tracker.step(image)
        else:
            left, top, width, height = first.tolist()
            box = (left, top, width, height) if np.isfinite(first).all() else None
            estimate = tracker.start(image, box)
        if not rows and name in WITH_BACKGROUND and not estimate.found:
            continue
        rows.append(evidence.add(image, k / target.fps, estimate))
        on.append(is_on(estimate.box, truth[k]))
        raw.append(estimate.confidence)
        if classes is not None and estimate.pan_likelihood is not None:
            pans.append(estimate.pan_likelihood)
            known = on[-1] and np.isfinite(target.pan[k])
            labels.append(int(classes.index(target.pan[k : k + 1])[0]) if known else -1)
    return Samples(
        target.name,
        name,
        np.array(rows).reshape(-1, len(FEATURES)),
        np.array(on, float),
        np.array(raw),
        np.array(pans, float) if pans else None,
        np.array(labels, np.int64),
    )


def _absent(images: Sequence[Image], count: int, rng: np.random.Generator) -> list[Image]:
    """Return images of the same place without moving people: the median, with noise."""
    middle = np.median(np.stack(images[::2]), axis=0)
    return [
        np.clip(middle + rng.normal(0.0, 2.0, middle.shape), 0, 255).astype(np.uint8) for _ in range(count)
    ]


def _on_background(
    target: TargetSequence, people: FloatArray, size: FloatArray, rng: np.random.Generator
) -> TargetSequence:
    """Return a run that starts on the background, away from the boxes (n, 4) of all people."""
    height, width = target.images[0].shape[:2]
    people = people[np.isfinite(people).all(axis=1)]
    for _ in range(300):
        corner = rng.random(2) * np.maximum([width, height] - size, 1.0)
        box = np.concatenate([corner, size])
        if not len(people) or intersection_over_union(people, box).max() == 0.0:
            break
    head = np.concatenate([corner + _HEAD_OF_BODY[:2] * size, _HEAD_OF_BODY[2:] * size])
    nobody = np.full((len(target.images), 4), np.nan)
    name = target.name + _BACKGROUND
    return TargetSequence(
        name, target.images, target.fps, nobody, nobody, np.full(len(nobody), np.nan), np.array([box, head])
    )


def head_targets(seed: int) -> list[TargetSequence]:
    """Render a head that stays, walks behind a wall, or disappears."""
    rng, kind = np.random.default_rng([seed, 7]), seed % 4
    occlusion = (30, 12) if kind == 1 else None
    clip = head_clip(
        rng,
        HeadClipParameters(
            frames=60, all_around=seed % 2 == 1, clutter=rng.uniform(0.2, 1.2), occlusion=occlusion
        ),
    )
    images, pan = clip.images, clip.pan.copy()
    boxes = np.where(clip.visible[:, None] < _VISIBLE, np.nan, clip.boxes)
    if kind >= 2:
        first = 30 if kind == 2 else 45
        images = [*images[:first], *_absent(images, 25, rng)]
        boxes = np.vstack([boxes[:first], np.tile(_NOBODY, (25, 1))])
        pan = np.concatenate([pan[:first], np.full(25, np.nan)])
    target = TargetSequence("rendered head", images, clip.fps, None, boxes, pan)
    background = _on_background(target, clip.boxes[:10], np.array([60.0, 150.0]), rng)
    return [target, *([background] if seed % 3 == 0 else [])]


def street_targets(seed: int, fps: float = 10.0, frames: int = 45) -> list[TargetSequence]:
    """Render people in a street; in a third of the clips they disappear."""
    rng = np.random.default_rng([seed, 8])
    walks = draw_walks(rng, people=int(rng.integers(1, 4)), steps=frames, fps=fps)
    place, camera = StillScene(walks.scene), walks.scene.camera.ground_camera()
    boxes = np.full((2, len(walks.truth.tracks), frames, 4), np.nan)
    images = []
    for k in range(frames):
        frame = place.render(walks.people(k), walks.sensor, rng)
        images.append(frame.image)
        for person, label in enumerate(frame.labels):
            if label.body_box is not None and label.visibility > _VISIBLE:
                boxes[0, person, k] = label.body_box
                boxes[1, person, k] = _NOBODY if label.head_box is None else label.head_box
    everybody = boxes[0, :, :10].reshape(-1, 4)
    if seed % 3 == 2:
        images[22:] = _absent(images, frames - 22, rng)
        boxes[:, :, 22:] = np.nan
    shown = np.flatnonzero(np.isfinite(boxes[:, :, 0]).all(axis=(0, 2)))
    found = []
    for person in shown[:1].tolist():
        track = walks.truth.tracks[person]
        assert track.true_head is not None and track.true_position is not None
        pan = camera.image_angle(track.true_head, track.true_position)
        found.append(TargetSequence("rendered street", images, fps, boxes[0, person], boxes[1, person], pan))
    if seed % 3 == 0:
        target = TargetSequence("rendered street", images[:25], fps, None, None, np.empty(0))
        found.append(_on_background(target, everybody, np.array([45.0, 115.0]), rng))
    return found


def ceiling_targets(seed: int) -> list[TargetSequence]:
    """Render a room from above; the person enters, or is given in the frame of entrance."""
    name = list(ALL_KINDS)[seed % len(ALL_KINDS)]
    rng, images, boxes = np.random.default_rng([seed, 9]), [], []
    for frame in ceiling_sequence(ALL_KINDS[name], rng, frames=150, oversampling=1):
        target = frame.target
        box = None if target is None or target.visibility < _VISIBLE else target.body_box
        images.append(frame.image)
        boxes.append(_NOBODY if box is None else np.array(box))
    body, unknown = np.array(boxes), np.full(len(boxes), np.nan)
    first = int(np.flatnonzero(np.isfinite(body[:, 0]))[0]) + 10
    part = slice(first, first + 60)
    return [
        TargetSequence("rendered room", images, CEILING_RATE, body, None, unknown),
        TargetSequence("rendered room", images[part], CEILING_RATE, body[part], None, unknown[part]),
    ]


def town_targets(folder: Path, part: int, people: int) -> list[TargetSequence]:
    """Return walkers of Town Centre's frames, and starts on its background: every second one of each part."""
    frames, camera, runs = labelled_runs(folder, 12)
    pictures = {frame.number: frame.image for frame in frames if frame.image is not None}
    fps, rng, found = 25.0 / STEP, np.random.default_rng(part), []
    everybody = [np.column_stack([number, box]) for _, number, box in runs]
    labels = np.concatenate(everybody)
    for _, numbers, box in runs[part::2][:people]:
        numbers, box = numbers[:20], box[:20]
        after = [k for k in range(numbers[-1] + 1, numbers[-1] + 9) if k in pictures and len(numbers) < 20]
        position = camera.image_to_ground(box[:, :2] + box[:, 2:] * [0.5, 1.0])
        step = np.gradient(position, axis=0)
        pan = camera.image_angle(direction(step), position)
        pan[np.linalg.norm(step, axis=1) * fps < 0.5] = np.nan
        gone = np.full((len(after), 4), np.nan)
        images = [pictures[k] for k in (*numbers.tolist(), *after)]
        body, head = np.vstack([box, gone]), np.vstack([head_boxes(box), gone])
        inside = body[0, 1] + body[0, 3] / 2.0 < images[0].shape[0]
        pan = np.concatenate([pan, np.full(len(after), np.nan)])
        found.append(TargetSequence("Town Centre", images, fps, body if inside else None, head, pan))
    for first in rng.integers(1, 120, people // 4).tolist():
        images = [pictures[k] for k in range(first, first + 15)]
        near = labels[(labels[:, 0] >= first) & (labels[:, 0] < first + 5), 1:]
        target = TargetSequence("Town Centre", images, fps, None, None, np.empty(0))
        found.append(_on_background(target, near, np.array([80.0, 210.0]), rng))
    return found


def labelled_targets(
    name: str, person: LabelledPerson, images: Sequence[Image], rng: np.random.Generator
) -> list[TargetSequence]:
    """Return a labelled person, and a start on the background in the same frames."""
    body = np.array([person.labels.get(k, _NOBODY) for k in person.numbers[: len(images)]])
    target = TargetSequence(name, images, 25.0, body, None, np.full(len(body), np.nan))
    return [target, _on_background(target, body, np.array([26.0, 56.0]), rng)]


def caviar_targets(folder: Path, name: str, people: int) -> list[TargetSequence]:
    """Return the people of a recording of CAVIAR's lobby whose boxes move furthest."""

    def way(person: LabelledPerson) -> float:
        first, last = (np.array(person.labels[person.numbers[k]][:2]) for k in (0, -1))
        return float(np.linalg.norm(last - first))

    rng, found = np.random.default_rng(len(name)), []
    for person in sorted(recordings(folder, [name], 60), key=way, reverse=True)[:people]:
        images = [image for image, _ in zip(person.images(), range(150), strict=False)]
        found += labelled_targets("CAVIAR, lobby", person, images, rng)
    return found


def corridor_targets(folder: Path, people: int) -> list[TargetSequence]:
    """Return people of CAVIAR's corridor, from in front."""
    from perception.detection.boxes import read_boxes

    source = FrameSource.open(folder / "corridor" / "OneLeaveShop1front.mpg")
    images = {frame.number: frame.image for frame in source if frame.image is not None}
    labels: dict[int, dict[int, tuple[float, float, float, float]]] = {}
    for item in read_boxes(folder / "corridor" / "fols1gt.xml"):
        labels.setdefault(item.track_id, {})[item.frame] = item.box
    rng, found = np.random.default_rng(0), []
    for number, of_person in sorted(labels.items(), key=lambda one: -len(one[1]))[:people]:
        first = min(k for k in of_person if k in images)
        numbers = tuple(k for k in range(first, first + 150) if k in images)
        person = LabelledPerson("corridor", number, numbers, folder, of_person)
        found += labelled_targets("CAVIAR, corridor", person, [images[k] for k in numbers], rng)
    return found


Source = Callable[[], list[TargetSequence]]


def sources(part: int, data: Path | None, size: int) -> list[Source]:
    """Return the sequences of a part, 0 to fit and 1 to judge; real ones only with a folder of data.

    ``size``: number of rendered sequences of each kind
    """
    seeds = range(1000 * part, 1000 * part + size)
    rendered = (head_targets, street_targets, ceiling_targets)
    found: list[Source] = [partial(kind, seed) for kind in rendered for seed in seeds]
    if data is not None:
        found.append(partial(town_targets, data / "towncentre", part, _TOWN))
        caviar = data / "caviar"
        lobby = ("wk1gt", "fra2gt") if part == 0 else ("wk2gt", "mws1gt")
        found += [partial(caviar_targets, caviar, name, _LOBBY) for name in lobby]
        found += [partial(corridor_targets, caviar, 2)] if part == 1 else []
    return found


def collected(source: Source) -> list[Samples]:
    """Follow all targets of a source."""
    return [samples for target in source() for samples in samples_of(target)]


def fitted(runs: Iterable[Samples], card: ModelCard) -> FollowConfidence:
    """Fit the confidence to runs; each counts as 30 frames."""
    runs = [run for run in runs if len(run.on)]
    counts = [np.full(len(run.on), 30.0 / len(run.on)) for run in runs]
    start, weights = np.zeros((len(KINDS), 4)), np.zeros((len(KINDS), 1 + len(FEATURES)))
    for kind in range(len(KINDS)):
        mine = [k for k, run in enumerate(runs) if kind_of(run.tracker) == kind]
        given = [k for k in mine if runs[k].on[0] and not runs[k].on_background]
        nobody = [k for k in mine if runs[k].on_background]
        start[kind] = fitted_start(
            np.array([runs[k].features[0] for k in (*given, *nobody)]),
            np.repeat([1.0, 0.0], [len(given), len(nobody)]),
            np.repeat([1.0, len(given) / max(len(nobody), 1)], [len(given), len(nobody)]),
        )
        weights[kind] = fitted_weights(
            np.concatenate([relative(runs[k].features, runs[k].features[0]) for k in given]),
            np.concatenate([runs[k].on for k in given]),
            np.concatenate([counts[k] for k in given]),
        )
    known = [k for k, run in enumerate(runs) if run.pan is not None and (run.label >= 0).any()]
    # Rendered heads resemble those that the exemplars were taught on.
    real = [k for k in known if not runs[k].rendered] or known
    pan, label = (np.concatenate([getattr(runs[k], name) for k in real]) for name in ("pan", "label"))
    count = np.concatenate([counts[k] for k in real])
    labelled = label >= 0
    of_pan = fitted_pan(pan[labelled], label[labelled], count[labelled])
    return FollowConfidence(start, weights, of_pan, card)


def train_confidence(size: int, data: Path | None, progress: Progress) -> FollowConfidence:
    """Fit the confidence, and measure its reliability on the sequences that are not fitted."""
    fit, judged = (
        [run for of in run_all(collected, sources(part, data, size), progress) for run in of]
        for part in (0, 1)
    )
    return trained(fit, judged, f"{size} rendered sequences each of heads, streets and rooms", data)


def trained(
    fit: Sequence[Samples], judged: Sequence[Samples], rendered: str, data: Path | None
) -> FollowConfidence:
    """Fit the confidence to runs; its card has the figures on others."""
    model = fitted(fit, ModelCard(FollowConfidence.kind))
    accepted = [run for run in judged if len(run.on) and _start(model, run) >= START_LEAST]
    figures = {
        f"expected_calibration_error, {name}": calibration_error(
            *_judged(model, [run for run in accepted if run.name == name])
        )
        for name in _names(accepted)
    }
    real = "" if data is None else ", and frames of Town Centre and CAVIAR"
    card = ModelCard(
        FollowConfidence.kind,
        rendered + real,
        "people who stand still in views from above, and other people of the same colours nearby",
        sum(len(run.on) for run in fit),
        figures=figures,
    )
    return replace(model, card=card)


def _judged(model: FollowConfidence, runs: Sequence[Samples]) -> tuple[FloatArray, FloatArray]:
    """Return confidences and truth (n,) of runs."""
    confidence = [model.run(run.tracker, run.features) for run in runs]
    return np.concatenate(confidence), np.concatenate([run.on for run in runs])


def reliability_tables(data: Path, size: int, progress: Progress) -> list[Table]:
    """Compute the reliability of the package's confidence on the sequences that are not fitted."""
    runs = [run for of in run_all(collected, sources(1, data, size), progress) for run in of]
    return tables_of(load_confidence(), [run for run in runs if len(run.on)])


def tables_of(model: FollowConfidence, runs: Sequence[Samples]) -> list[Table]:
    """Tables of reliability: by confidence, before and after, and of pans.

    Parameters
    ----------
    runs : with at least one frame each
    """
    accepted = [run for run in runs if _start(model, run) >= START_LEAST]
    curves: list[Row] = []
    for place in ("rendered", "real"):
        some = [run for run in accepted if run.rendered == (place == "rendered")]
        curves += _curve(place, *_judged(model, some)) if some else ()
    summary = [_summary(model, name, [run for run in runs if run.name == name]) for name in _names(runs)]
    titles = (
        "Confidence of perception follow, sequences and people that were not fitted, starts not refused",
        "Starts that are refused; the frames of the others before and after calibration",
        "Pans of boxes on the target: true pan in the classes that hold 90 % of the probability",
    )
    parts = (curves, summary, _pan_rows(model, accepted))
    return [Table.of(title, rows) for title, rows in zip(titles, parts, strict=True) if rows]


_SURE, _HELD = 0.9, 0.9


def _names(runs: Sequence[Samples]) -> list[str]:
    return sorted({run.name for run in runs})


def _start(model: FollowConfidence, run: Samples) -> float:
    """Return the probability of a person in the first box."""
    return float(model.start_probability(run.tracker, run.features[0]))


def _summary(model: FollowConfidence, name: str, runs: Sequence[Samples]) -> Row:
    accepted = [run for run in runs if _start(model, run) >= START_LEAST]
    row: dict[str, Cell] = {
        "sequences": name,
        "starts": len(runs),
        "refused (%)": 100.0 * (1.0 - len(accepted) / len(runs)),
    }
    if not accepted:
        return row | dict.fromkeys(_COLUMNS)
    after, on = _judged(model, accepted)
    raw = np.concatenate([run.raw for run in accepted])
    row |= {"frames": len(on), "on target (%)": 100.0 * float(on.mean())}
    for when, confidence in (("before", raw), ("after", after)):
        sure = confidence >= _SURE
        row |= {
            f"at least .9 {when} (%)": 100.0 * float(sure.mean()),
            f"of them on target {when} (%)": 100.0 * float(on[sure].mean()) if sure.any() else None,
            f"ECE {when}": calibration_error(confidence, on),
        }
    return row


_COLUMNS = (
    "frames",
    "on target (%)",
    *(
        f"{name} {when}{unit}"
        for when in ("before", "after")
        for name, unit in (("at least .9", " (%)"), ("of them on target", " (%)"), ("ECE", ""))
    ),
)


def _curve(place: str, confidence: FloatArray, on: FloatArray) -> Iterator[Row]:
    bins = np.minimum((10.0 * confidence).astype(int), 9)
    for k in np.unique(bins).tolist():
        some = bins == k
        yield {
            "frames of": place,
            "confidence": f"{k / 10:g}-{(k + 1) / 10:g}",
            "frames": int(some.sum()),
            "mean (%)": 100.0 * float(confidence[some].mean()),
            "on target (%)": 100.0 * float(on[some].mean()),
        }


def _pan_rows(model: FollowConfidence, runs: Sequence[Samples]) -> list[Row]:
    rows: list[Row] = []
    for name in _names(runs):
        mine = [run for run in runs if run.name == name and run.pan is not None and (run.label >= 0).any()]
        if not mine:
            continue
        label = np.concatenate([run.label[run.label >= 0] for run in mine])
        raw = np.concatenate([run.pan[run.label >= 0] for run in mine if run.pan is not None])
        confidence = np.concatenate(
            [model.run(run.tracker, run.features)[run.label >= 0, None] for run in mine]
        )
        after = tempered(raw, model.pan, confidence)
        row: dict[str, Cell] = {"sequences": name, "frames": len(label)}
        for when, pan in (("before", raw), ("after", after)):
            row[f"held {when} (%)"] = 100.0 * float(held(pan / pan.sum(axis=1, keepdims=True), label).mean())
        rows.append(row)
    return rows


def held(pan: FloatArray, label: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return True where the likeliest classes of (n, k) that hold 90 % have the true class (n,)."""
    order = np.argsort(-pan, axis=1)
    before = np.cumsum(np.take_along_axis(pan, order, axis=1), axis=1)
    rank = np.argmax(order == label[:, None], axis=1)
    return np.asarray((rank == 0) | (before[np.arange(len(pan)), np.maximum(rank - 1, 0)] < _HELD))
