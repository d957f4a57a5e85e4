"""Chen et al. 2011, §3, on its own observations: class likelihoods of body and head, many of them wrong.

A camera answers in the image; the likelihoods are turned to the world once. All engines
use the preset ``joint``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from graphtrack.baselines.particle_filter import ParticleOptions, particle_filter
from graphtrack.experiments.chen_joint import (
    ANGLES,
    POSITION_STD,
    PRESETS,
    Methods,
    Scores,
    by_angle,
    default_models,
    detail,
    draw_errors,
    errors_of,
    estimated_errors,
    most_likely_error,
    published_table,
)
from graphtrack.experiments.harness import (
    GAITS,
    MOCAP,
    Experiment,
    Parts,
    Progress,
    Settings,
    Table,
    evenly,
    unit_of,
)
from graphtrack.geometry.angles import FloatArray, class_centres, likelihood_at
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import smooth_track
from graphtrack.model import Model
from graphtrack.report.style import new_figure
from graphtrack.simulation.degrade import add_class_likelihoods, add_noise, confusion_matrix
from graphtrack.simulation.sampling import simulate
from graphtrack.smoothing import smooth
from graphtrack.tracking import track_online
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES, Track, TrackSet

OPTIONS = {
    "particle, turned once": (False, ParticleOptions()),
    "particle, closest class, turned once": (False, ParticleOptions(pose="closest")),
    "particle, closest class, in the image": (True, ParticleOptions(pose="closest", image_pose=True)),
}
"""Filter → True if it uses the image's likelihoods, and its options; the last is eq. 13–14 as printed."""

IMAGE_GROUPS = dict.fromkeys(OPTIONS, "online")

_FOCAL, _SIZE = 760.0, (640.0, 480.0)
_HEIGHT, _BEHIND = 3.0, 6.0
"""Metres of the camera above the ground, and from the nearest of where people are."""


def image_scores(data: str, tracks: TrackSet, classify: Callable[[TrackSet], TrackSet]) -> Scores:
    """Errors of Chen et al.'s filter with likelihoods that were answered in the image of a camera.

    Parameters
    ----------
    data : name of the source
    tracks : people with truth, and positions in metres
    classify : gives tracks the likelihoods of classes of their true angles
    """
    camera = camera_before(tracks)
    answered = classify(tracks.map(lambda track: in_image(track, camera)))
    turned = [turned_to_world(observed_errors, camera) for observed_errors in answered]
    pairs = list(zip(turned, tracks, strict=True))
    observed_errors = [[most_likely_error(one, truth, angle) for angle in ANGLES] for one, truth in pairs]
    found = by_angle(("observation", ""), observed_errors)
    for method, (by_image, options) in OPTIONS.items():
        given = answered.tracks if by_image else turned
        for preset in PRESETS:
            estimates = [particle_filter(one, preset, camera=camera, options=options).track for one in given]
            errors = [errors_of(*pair) for pair in zip(estimates, tracks, strict=True)]
            found |= by_angle((preset, method), errors)
    return Scores(data, len(tracks), found, [unit_of(track) for track in tracks])


def camera_before(tracks: TrackSet) -> GroundCamera:
    """A camera 3 m above the ground that looks north over all of the tracks."""
    known = np.concatenate([track.position[np.isfinite(track.position).all(axis=1)] for track in tracks])
    centre = np.array([float(known[:, 0].mean()), float(known[:, 1].min()) - _BEHIND, _HEIGHT])
    # Axes of the camera in the world, as rows: right, down, ahead.
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    intrinsics = np.array([[_FOCAL, 0.0, _SIZE[0] / 2.0], [0.0, _FOCAL, _SIZE[1] / 2.0], [0.0, 0.0, 1.0]])
    return GroundCamera.from_calibration(rotation, -rotation @ centre, intrinsics)


def in_image(track: Track, camera: GroundCamera) -> Track:
    """Return the track with its true angles in the camera's view, as input of classifiers."""
    assert track.true_position is not None
    angles = {
        name: camera.image_angle(truth, track.true_position)
        for name, truth in (("body", track.true_body), ("head", track.true_head))
        if truth is not None
    }
    return replace(track, true_body=angles.get("body"), true_head=angles.get("head"))


def turned_to_world(track: Track, camera: GroundCamera) -> Track:
    """The track with its image likelihoods turned to the world, once, at the observed positions."""

    def turned(likelihood: FloatArray | None) -> FloatArray | None:
        if likelihood is None:
            return None
        centres = [np.full(len(track), centre) for centre in class_centres(likelihood.shape[1])]
        angle = np.stack([camera.image_angle(centre, track.position) for centre in centres], axis=1)
        return likelihood_at(likelihood, angle)

    body, head = turned(track.body_likelihood), turned(track.head_likelihood)
    return replace(track, body_likelihood=body, head_likelihood=head)


LAG = 2.0
"""Seconds that the online graphs keep open, as `graphtrack track` does."""

KNOWN = {"chain": "graph, chain", "isam2": "graph, isam2", "chain, offline": "smoother"}
"""Engine → method of the experiment that it is already."""

OTHER_ENGINES: Methods = {
    "isam2, full history": ("online", partial(track_online, engine="isam2", lag=None)),
    "fixed-lag": ("online", partial(track_online, engine="fixed-lag", lag=LAG)),
    "gtsam, offline": ("offline", lambda track, model: smooth_track(track, model, engine="gtsam").track),
}
"""Those that the experiment has only here."""

_PRESET = "joint"


def engine_table(known: Scores, tracks: TrackSet, rng: np.random.Generator, progress: Progress) -> Table:
    """Errors of `KNOWN` and `OTHER_ENGINES` on people of one source.

    Parameters
    ----------
    known : errors of the experiment's methods on these people
    tracks : the people
    rng : source of the intervals' resampling
    """
    errors: dict[tuple[str, str, str], FloatArray] = {}
    for angle in ANGLES:
        errors["observation", "", angle] = known.errors["observation", "", angle]
        for name, method in KNOWN.items():
            errors[_PRESET, name, angle] = known.errors[_PRESET, method, angle]
    models = {(_PRESET, name): Model(_PRESET) for name in OTHER_ENGINES}
    errors |= estimated_errors(tracks, OTHER_ENGINES, models, progress)
    groups = {name: "offline" if name.endswith("offline") else "online" for name in (*KNOWN, *OTHER_ENGINES)}
    return detail("Every engine, with joint", [replace(known, errors=errors)], groups, rng)


FLIPPED, AT_RANDOM = 0.2, 0.1
"""Shares of the answers that take front for back, and that are any class."""

PUBLISHED_TITLE = (
    "Paper / ours: mean error in degrees (Chen et al.'s classifiers on CHIL, ours as the notes say)"
)

METHODS: Methods = {
    "graph, chain": (
        "online",
        lambda track, model: track_online(track, model, engine="chain", lag=LAG, constants="default"),
    ),
    "graph, isam2": (
        "online",
        lambda track, model: track_online(track, model, engine="isam2", lag=LAG, constants="default"),
    ),
    "smoother": (
        "offline",
        lambda track, model: smooth(TrackSet((track,)), model, constants="default").tracks[0],
    ),
}
"""Method → group and estimator."""

GROUPS = {method: group for method, (group, _) in METHODS.items()}


def people(settings: Settings) -> dict[str, TrackSet]:
    """People by source, with body and head observed by classifiers with a known confusion."""
    count = settings.few(42, 4)
    clips = settings.tracks(*MOCAP)
    if clips is not None:
        found = {name: evenly(clips.select(*of), count, 2.0) for name, of in GAITS.items()}
    else:
        drawn = simulate("joint", n_tracks=count, n_steps=120, rng=settings.rng(1))
        found = {"drawn from the joint model": drawn}
    return {
        name: classified(
            add_noise(tracks, position_std=POSITION_STD, rng=settings.rng(2, i)), settings.rng(3, i)
        )
        for i, (name, tracks) in enumerate(found.items())
    }


def classified(tracks: TrackSet, rng: np.random.Generator) -> TrackSet:
    """Return the tracks with the observations of the experiment's classifiers."""
    return add_class_likelihoods(
        tracks,
        body=confusion_matrix(BODY_CLASSES, flipped=FLIPPED, at_random=AT_RANDOM),
        head=confusion_matrix(HEAD_CLASSES, flipped=FLIPPED, at_random=AT_RANDOM),
        rng=rng,
    )


def scores(data: str, tracks: TrackSet, progress: Progress) -> Scores:
    """Every method on every person, with each of the presets."""
    observed_errors = [[most_likely_error(track, track, angle) for angle in ANGLES] for track in tracks]
    estimates = estimated_errors(tracks, METHODS, default_models(METHODS), progress)
    errors = by_angle(("observation", ""), observed_errors) | estimates
    return Scores(data, len(tracks), errors, [unit_of(track) for track in tracks])


def _parts(settings: Settings) -> Parts:
    everyone = people(settings)
    first = next(iter(everyone.values()))
    estimates = len(default_models(METHODS)) * sum(len(tracks) for tracks in everyone.values())
    settings.expect(estimates + len(everyone) + len(OTHER_ENGINES) * len(first))
    found = [scores(name, tracks, settings.progress) for name, tracks in everyone.items()]
    pictured = []
    for i, (name, tracks) in enumerate(everyone.items()):
        few = tracks[: settings.few(12)]
        pictured.append(image_scores(name, few, partial(classified, rng=settings.rng(4, i))))
        settings.progress(1)
    rng = settings.rng(99)
    in_image = detail("Answers in the image of a camera (eq. 13–14)", pictured, IMAGE_GROUPS, rng)
    yield detail("Body and head from class likelihoods", found, GROUPS, rng)
    yield in_image
    figure = new_figure(4.2 * len(found) + 1.0, 7.2)
    grid = figure.subplots(2, len(found), sharex=True, sharey="row", squeeze=False)
    draw_errors(grid, found, GROUPS, rng)
    grid[0, 0].legend(frameon=False, fontsize=8)
    yield figure
    yield engine_table(found[0], first, settings.rng(98), settings.progress)
    yield published_table(found, GROUPS, PUBLISHED_TITLE)
    yield (
        f"Positions with {POSITION_STD} m of noise; in each frame a class of the body (8) and one of the "
        f"head (12), {100 * FLIPPED:.0f} % of them turned by 180°, {100 * AT_RANDOM:.0f} % any, as "
        "likelihoods that are calibrated. Errors are independent from frame to frame; those of a real "
        "classifier are not."
    )
    yield (
        "Mean absolute error per person, mean over people, with its 95 % bootstrap interval over styles of "
        "motion capture. Every method gets the same frames and default parameters. Online estimates use the "
        f"past alone; the graphs keep {LAG:g} s open."
    )
    yield (
        "closest class: eq. 13–14, the score of the class that is closest to a particle; turned once: their "
        "smooth mixture, which the graph has. joint-body is what Chen et al. (2011) call separate (κ₂ = 0)."
    )
    yield (
        "Answers in the image: classes of the angles at which a camera 3 m above the ground sees them, "
        "judged there at each particle's position (eq. 13–14 as printed), or turned to the world once, where "
        "the position was observed; of the first people only."
    )
    yield "Every engine: the people of the first source."


EXPERIMENT = Experiment(
    "chen-classes",
    "Chen et al. 2011: class likelihoods of body and head, many of them wrong",
    "4 people of each source, 1 in the image",
    _parts,
)
