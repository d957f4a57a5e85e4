"""Chen et al. 2011, Table 2 from pixels: online methods on rendered clips, drawn as in its Figs. 6, 7 and 9.

Also rendered and classified poses of motion capture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib.lines import Line2D

from graphtrack.baselines.particle_filter import ParticleOptions, particle_filter
from graphtrack.evaluation.metrics import bootstrap, mean_difference
from graphtrack.experiments import chen_classes
from graphtrack.experiments.chen_classes import scores
from graphtrack.experiments.chen_joint import (
    ANGLES,
    POSITION_STD,
    PRESETS,
    Scores,
    by_angle,
    detail,
    draw_errors,
    errors_of,
    most_likely_error,
    published_table,
)
from graphtrack.experiments.harness import (
    GAITS,
    MOCAP,
    Cell,
    Experiment,
    Parts,
    Row,
    Settings,
    Table,
    evenly,
    thinned,
)
from graphtrack.geometry.angles import FloatArray, class_centres, difference, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.offline import smooth_track
from graphtrack.model import Model
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.sampling import simulate
from graphtrack.tracking import track_online
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES, Track, TrackSet
from perception.drawing.overlays import Cues, draw_cues
from perception.images.pixels import Image
from perception.models import load_classifier, load_head_localiser
from perception.observation.pipeline import (
    Models,
    PersonObservation,
    by_frame,
    channels_of,
    head_in_image,
    observe_frame,
    why_nowhere,
)
from perception.observation.tables import to_tracks
from perception.pose.classes import PoseClasses, image_likelihood
from perception.pose.classifier import FeatureClassifier
from perception.synthetic import make_heads, make_pedestrians
from perception.synthetic.clips import Clip, walking_clip
from perception.training import FOUND_AS_WALKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


LAG = 2.0
"""Smoothing window of the online graphs in seconds, as in `graphtrack track`."""

LEAST_FRAMES = 5
"""Least number of frames of an evaluated person."""


@dataclass(frozen=True, eq=False)
class ObservedPerson:
    """Observations of a person in a clip, in the three forms that methods take, and the ground truth.

    Attributes
    ----------
    causal : likelihoods in the world, heads chosen from past frames only
    offline : the same with heads chosen offline
    image : as ``causal``, but the likelihoods are in the image
    truth : of the same frames
    camera : over the ground
    boxes, head_boxes : (n, 4) pixels in the image, the heads those of ``causal``
    """

    causal: Track
    offline: Track
    image: Track
    truth: Track
    camera: GroundCamera
    boxes: FloatArray
    head_boxes: FloatArray


Estimate = Callable[[ObservedPerson, Model, int], Track]
"""Maps a person, a model and a seed to estimates at the person's frames."""


@dataclass(frozen=True)
class PixelMethod:
    """Method of estimation.

    Attributes
    ----------
    group : "online" or "offline"
    estimate : runs it
    seeds : number of runs of a random method
    """

    group: str
    estimate: Estimate
    seeds: int = 1


def _particle(person: ObservedPerson, model: Model, seed: int) -> Track:
    return particle_filter(person.causal, model, camera=person.camera, seed=seed).track


def _in_image(person: ObservedPerson, model: Model, seed: int) -> Track:
    """Run eq. 12 in pixels, eq. 13–14 with the closest class in the image, at each particle's position."""
    options = ParticleOptions(pose="closest", image_pose=True)
    return particle_filter(person.image, model, camera=person.camera, options=options, seed=seed).track


def _online(person: ObservedPerson, model: Model, engine: Literal["chain", "isam2"]) -> Track:
    return track_online(
        person.causal, model, engine=engine, lag=LAG, camera=person.camera, constants="default"
    )


METHODS: Mapping[str, PixelMethod] = {
    "particle": PixelMethod("online", _particle, seeds=3),
    "particle, eq. 12–14": PixelMethod("online", _in_image, seeds=3),
    "graph, chain": PixelMethod("online", lambda person, model, seed: _online(person, model, "chain")),
    "graph, isam2": PixelMethod("online", lambda person, model, seed: _online(person, model, "isam2")),
    "smoother": PixelMethod(
        "offline", lambda person, model, seed: smooth_track(person.causal, model, person.camera).track
    ),
    "smoother, heads of the whole track": PixelMethod(
        "offline", lambda person, model, seed: smooth_track(person.offline, model, person.camera).track
    ),
}
"""Online methods and the first smoother share observations; the last smoother has offline heads."""


def observed_in_clip(clip: Clip, models: Models) -> list[PersonObservation]:
    """Return the models' outputs for all people in a clip."""
    people_observed: list[PersonObservation] = []
    for k, image in enumerate(clip.images):
        boxes = [item for item in clip.boxes if item.frame == k]
        people_observed += observe_frame(image, k, boxes, models, lambda reason: None)
    return people_observed


def observed(clip: Clip, models: Models, *, causal: bool = False) -> TrackSet:
    """Return the observations of a clip, as `perception observe` writes them."""
    people_observed = observed_in_clip(clip, models)
    return to_tracks(
        by_frame(people_observed), models.head_pose.classes, clip.camera, clip.fps, causal=causal
    ).tracks


def people_of(clip: Clip, models: Models) -> list[ObservedPerson]:
    """Return the people of a clip observed in at least `LEAST_FRAMES` frames."""
    people_observed, classes = observed_in_clip(clip, models), models.head_pose.classes
    if not people_observed:
        return []
    causal = to_tracks(by_frame(people_observed), classes, clip.camera, clip.fps, causal=True)
    offline = to_tracks(by_frame(people_observed), classes, clip.camera, clip.fps).tracks
    found = []
    for track in causal.tracks:
        if len(track) < LEAST_FRAMES:
            continue
        key, truth = track.track_id, clip.truth.by_id(track.track_id)
        heads = causal.heads[key]
        of_track = sorted(
            (item for item in people_observed if item.track_id == key), key=lambda item: item.frame
        )
        items = [item for item in of_track if not why_nowhere(item, clip.camera)]
        found.append(
            ObservedPerson(
                track,
                offline.by_id(key),
                Track(key, **channels_of(items, heads, classes, clip.camera, clip.fps, in_image=True)),
                truth[np.searchsorted(truth.frame, track.frame)],
                clip.camera,
                np.array([item.box for item in items]),
                np.array([head_in_image(item, k) for item, k in zip(items, heads.tolist(), strict=True)]),
            )
        )
    return found


def joint_scores(data: str, people: Sequence[ObservedPerson]) -> Scores:
    """Return mean errors in degrees of each person by each of `METHODS`, and of single frames."""
    found: dict[tuple[str, str, str], FloatArray] = {}
    for name, heads in (("", "causal"), ("whole track", "offline")):
        errors = [
            [most_likely_error(getattr(person, heads), person.truth, angle) for angle in ANGLES]
            for person in people
        ]
        found |= by_angle(("observation", name), errors)
    for name, method in METHODS.items():
        for preset in PRESETS:
            model = Model(preset)
            of_seeds = [
                [errors_of(method.estimate(person, model, seed), person.truth) for person in people]
                for seed in range(method.seeds)
            ]
            found |= by_angle((preset, name), np.mean(of_seeds, axis=0))
    return Scores(data, len(people), found)


ROWS = (
    *(("particle", "joint-body"), ("particle", "joint")),
    *(("graph, chain", "joint"), ("graph, isam2", "joint")),
)
"""Method and preset of the sheet's rows: Chen et al.'s separate and joint filtering, and the online graph."""

_SPEED, _HEAD = "#666666", "#111111"
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def shown_rows(person: ObservedPerson, columns: int = 6) -> list[int]:
    """Return evenly spaced rows of a person's track, without the first."""
    n = len(person.causal)
    first = min(3, n - 1)
    return np.linspace(first, n - 1, min(columns, n - first)).round().astype(int).tolist()


def draw_sheet(figure: SubFigure, clip: Clip, people: Sequence[ObservedPerson]) -> None:
    """Draw a row of frames for each of `ROWS`, and a view from above of the joint filter's estimates.

    The frames show the first person with the longest track.
    """
    person = max(people, key=lambda one: len(one.causal))
    rows = shown_rows(person)
    grid = figure.subplots(len(ROWS) + 1, len(rows), squeeze=False)
    for line, (method, preset) in enumerate(ROWS):
        estimate = METHODS[method].estimate(person, Model(preset), 0)
        for column, row in enumerate(rows):
            axes = grid[line, column]
            picture, caption = cell(clip, person, estimate, row)
            axes.imshow(picture[:, :, ::-1])
            axes.set_xticks([])
            axes.set_yticks([])
            axes.set_xlabel(caption, fontsize=8)
            if line == 0:
                axes.set_title(f"t = {person.causal.t[row]:.1f} s", fontsize=9)
        grid[line, 0].set_ylabel(f"{method}, {preset}", fontsize=9)
    found = [METHODS["particle"].estimate(one, Model("joint"), 0) for one in people]
    for column, row in enumerate(rows):
        _from_above(grid[-1, column], found, float(person.causal.t[row]))
        grid[-1, column].set_xlabel("x (m)", fontsize=8)
    grid[-1, 0].set_ylabel("from above, y (m):\nparticle, joint", fontsize=9)
    figure.legend(
        handles=[
            Line2D([], [], color=_SPEED, linewidth=1.4, label="velocity"),
            *(
                Line2D([], [], color=colour, linewidth=2.2, label=f"body, person {k}")
                for k, colour in zip(range(1, len(found) + 1), cycle(_COLOURS), strict=False)
            ),
            Line2D([], [], color=_HEAD, linewidth=1.6, label="head"),
        ],
        loc="outside lower center",
        ncols=2 + len(found),
        frameon=False,
        fontsize=9,
    )


def cell(clip: Clip, person: ObservedPerson, estimate: Track, row: int) -> tuple[Image, str]:
    """Return the image of a frame, and a text with the errors of body and head."""
    observed, truth = person.causal, person.truth
    assert observed.body_likelihood is not None and observed.head_likelihood is not None
    assert estimate.body is not None and estimate.head is not None
    assert truth.true_body is not None and truth.true_head is not None
    frame = int(observed.frame[row])
    likely = [
        float(class_centres(found.shape[1])[found[row].argmax()])
        for found in (observed.body_likelihood, observed.head_likelihood)
    ]
    cues = Cues(
        np.array(person.boxes[row]),
        person.head_boxes[row],
        observed.position[row],
        np.array(likely),
        np.array([estimate.body[row], estimate.head[row]]),
        np.array([truth.true_body[row], truth.true_head[row]]),
    )
    assert cues.true is not None
    body, head = np.degrees(np.abs(difference(cues.estimated, cues.true)))
    picture = draw_cues(clip.images[frame], cues, person.camera)
    return picture, f"off by {body:.0f}° body, {head:.0f}° head"


def _from_above(axes: Axes, found: list[Track], t: float) -> None:
    """Draw two circles with three arrows each: speed, body and head (Chen et al. 2011, Fig. 7)."""
    every = np.concatenate([track.position for track in found])
    (left, low), (right, high) = every.min(axis=0) - 2.0, every.max(axis=0) + 2.0
    half = max(right - left, high - low) / 2.0
    size = 0.26 * half
    for k, track in enumerate(found):
        near = int(np.abs(track.t - t).argmin())
        if abs(track.t[near] - t) > 1e-6:
            continue
        assert track.velocity is not None and track.body is not None and track.head is not None
        centre, colour = track.position[near], _COLOURS[k % len(_COLOURS)]
        for radius in (0.6 * size, size):
            circle = centre + radius * unit(np.linspace(-np.pi, np.pi, 49))
            axes.plot(*circle.T, color=colour, linewidth=0.8)
        body, head = unit(float(track.body[near])), unit(float(track.head[near]))
        speed = float(np.linalg.norm(track.velocity[near]))
        if speed > 0.0:
            along = track.velocity[near] / speed
            _arrow(axes, centre + size * along, 0.5 * size * speed * along, _SPEED, 1.4)
        _arrow(axes, centre, size * body, colour, 2.2)
        _arrow(axes, centre, 0.6 * size * head, _HEAD, 1.6)
    axes.set_xlim((left + right) / 2.0 - half, (left + right) / 2.0 + half)
    axes.set_ylim((low + high) / 2.0 - half, (low + high) / 2.0 + half)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)


def _arrow(axes: Axes, start: FloatArray, along: FloatArray, colour: str, width: float) -> None:
    axes.annotate(
        "",
        tuple(start + along),
        tuple(start),
        arrowprops={
            "arrowstyle": "-|>",
            "mutation_scale": 8,
            "color": colour,
            "lw": width,
            "shrinkA": 0,
            "shrinkB": 0,
        },
        annotation_clip=False,
    )


def captured_people(settings: Settings) -> dict[str, TrackSet]:
    """Return people by source, with noisy positions, at ten frames a second."""
    count, clips = settings.few(12, 2), settings.tracks(*MOCAP)
    if clips is None:
        found = {"drawn from the joint model": simulate("joint", n_tracks=count, rng=settings.rng(20))}
    else:
        sources = list(GAITS.items())[: settings.few(len(GAITS))]
        found = {name: evenly(clips.select(*of).map(thinned), count, 2.0) for name, of in sources}
    return {
        name: add_noise(tracks, position_std=POSITION_STD, rng=settings.rng(21, i))
        for i, (name, tracks) in enumerate(found.items())
    }


def classified(
    track: Track, body: FeatureClassifier, head: FeatureClassifier, rng: np.random.Generator
) -> Track:
    """Return a person in front of a distant camera, with class likelihoods converted to the world.

    Each frame shows another rendered person in the same pose, so that errors are independent; boxes of heads
    have the localiser's errors, and tilts are those of walking people.
    """
    assert track.true_body is not None and track.true_head is not None
    ray = rng.uniform(-np.pi, np.pi)
    at_body, at_head = track.true_body - ray, track.true_head - ray
    crops = make_pedestrians(len(track), rng, body=at_body).images
    heads = make_heads(len(track), rng, FOUND_AS_WALKING, pan=at_head)
    of_body, of_head = body.log_likelihoods(crops), head.log_likelihoods(heads.images)
    pans = head.classes.pan_log_likelihood(of_head)
    return replace(
        track,
        body=None,
        body_kappa=None,
        head=None,
        head_kappa=None,
        body_likelihood=_turned(body.classes.pan_log_likelihood(of_body), body.classes, BODY_CLASSES, ray),
        head_likelihood=_turned(pans, head.classes, HEAD_CLASSES, ray),
    )


def _turned(log_likelihood: FloatArray, classes: PoseClasses, wanted: int, ray: float) -> FloatArray:
    """Convert likelihoods (n, n_pan) in the image to (n, wanted) in the world; rows sum to 1."""
    return image_likelihood(log_likelihood, classes, replace(PoseClasses.circle(wanted), first=-ray))


def known_poses(
    everyone: Mapping[str, TrackSet],
    body: FeatureClassifier,
    head: FeatureClassifier,
    rng: np.random.Generator,
    progress: Callable[[int], object],
) -> list[Scores]:
    """Compute errors of every method of `chen-classes`, by source."""
    found = []
    for name, tracks in everyone.items():
        observed = tracks.map(lambda track: classified(track, body, head, rng))
        found.append(scores(name, observed, lambda count: None))
        progress(1)
    return found


HEADS = ("deep_belief", "templates")
"""Head pose classifiers: ours, and Chen et al.'s with distances after a Fisher projection."""

PUBLISHED_TITLE = (
    "Paper / ours: mean error in degrees (Chen et al. 2011 on CHIL with its particle filter; "
    "ours on rendered people)"
)

GROUPS = {name: method.group for name, method in METHODS.items()}


def _effort(settings: Settings) -> tuple[int, int, tuple[str, ...]]:
    """Clips, frames of each, and head pose classifiers."""
    return (1, 8, HEADS[:1]) if settings.quick else (10, 30, HEADS)


def _parts(settings: Settings) -> Parts:
    count, frames, heads = _effort(settings)
    everyone = captured_people(settings)
    settings.expect(count + len(heads) * (count + 1) + len(everyone))
    clips: list[Clip] = []
    for k in range(count):
        clips.append(walking_clip(settings.rng(1, k), steps=frames))
        settings.progress(1)
    found, first = [], None
    for name in heads:
        models = Models(load_head_localiser(), load_classifier("body_pose"), load_classifier(name))
        people: list[ObservedPerson] = []
        for clip in clips:
            people += people_of(clip, models)
            if first is None and people:
                first = clip, list(people)
            settings.progress(1)
        found.append(joint_scores(name, people))
        settings.progress(1)
    assert first is not None
    body, head = load_classifier("body_pose"), load_classifier("templates")
    posed = known_poses(everyone, body, head, settings.rng(22), settings.progress)
    rng = settings.rng(99)
    yield detail("Body and head from class likelihoods", found, GROUPS, rng)
    yield Table.of(
        "Paired differences with 95 % intervals over people; below 0 the first is better", _effect(found, rng)
    )
    yield detail(
        "Known poses: body and head of motion capture from the answers of Chen et al.'s classifiers",
        posed,
        chen_classes.GROUPS,
        settings.rng(98),
    )
    yield published_table(found, GROUPS, PUBLISHED_TITLE)
    yield _figure(found, *first, rng)
    yield (
        "Rendered people who walk as the model joint has it, three a clip, boxes off as a detector's are, "
        "heads by the localiser; each column has another classifier of heads, the bodies are the same."
    )
    yield (
        "Mean absolute error per person, mean over people, of five or more with its 95 % bootstrap interval; "
        "of the particle filter the mean of 3 seeds. Every method has the package's parameters and the same "
        "observations, with causal heads, except for the last smoother, with heads "
        f"chosen offline. Online estimates use past frames only, with a window of {LAG:g} s in the graphs."
    )
    yield (
        "joint-body is what Chen et al. (2011) call separate (κ₂ = 0 in eq. 10); in separate the body does "
        "not follow the motion either. eq. 12–14: the closest class in the image, at each particle's own "
        "position."
    )
    yield (
        "The frames show the longest track of the first clip, as Chen et al. 2011, Fig. 5: circles of 50 cm "
        "at feet (red: body) and head (yellow); thin lines: the likeliest class of the frame alone; arrows: "
        "estimates; green ticks: the truth. From above, as Fig. 7, enlarged circles: speed (grey, outside), "
        "body (colour), head (black)."
    )
    yield (
        "Known poses: motion capture at 10 frames a second, each frame another rendered person in that pose, "
        "classified by body_pose (8 classes) and templates (12 pans × 3 tilts, summed out), in heads boxed "
        "as the localiser does; errors are independent from frame to frame."
    )


def _effect(found: Sequence[Scores], rng: np.random.Generator) -> Iterator[Row]:
    """Yield paired differences: joint minus separate, and offline minus causal heads."""
    for one in found:
        pairs = [(name, "joint − joint-body", ("joint", name), ("joint-body", name)) for name in METHODS]
        details = "smoother, heads of the whole track"
        cost = "heads of the whole track − causal heads"
        pairs += [("smoother", f"{cost}, {p}", (p, details), (p, "smoother")) for p in ("separate", "joint")]
        pairs.append(("per frame", cost, ("observation", "whole track"), ("observation", "")))
        for method, what, after, before in pairs:
            row: dict[str, Cell] = {"data": one.data, "method": method, "difference": what}
            for angle in ANGLES:
                interval = bootstrap(
                    mean_difference, one.errors[*after, angle], one.errors[*before, angle], rng=rng
                )
                span = f" ({interval.low:+.1f} … {interval.high:+.1f})" if np.isfinite(interval.low) else ""
                row[f"{angle} (°)"] = f"{interval.value:+.1f}{span}"
            yield row


def _figure(
    found: Sequence[Scores], clip: Clip, people: Sequence[ObservedPerson], rng: np.random.Generator
) -> Figure:
    from graphtrack.report.style import new_figure

    figure = new_figure(13.0, 18.1)
    parts = np.asarray(figure.subfigures(2, 1, height_ratios=[5.0, 13.1]), dtype=object)
    top, bottom = parts[0], parts[1]
    grid = top.subplots(2, len(found), sharex=True, sharey="row", squeeze=False)
    draw_errors(grid, found, GROUPS, rng)
    top.legend(
        *grid[0, 0].get_legend_handles_labels(),
        loc="outside upper center",
        ncols=3,
        frameon=False,
        fontsize=8,
    )
    draw_sheet(bottom, clip, people)
    return figure


EXPERIMENT = Experiment(
    "chen-pixels",
    "Chen et al. 2011, Table 2 and Fig. 6–9, from pixels, online methods",
    "1 clip of 8 frames with at most 3 people",
    _parts,
)
