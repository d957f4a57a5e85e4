"""Chen et al. 2011 with the observations that it has: class likelihoods of body and head, many of them
wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from graphtrack.baselines.particle.filter import ParticleOptions, particle_filter
from graphtrack.evaluation.reproduce.chen_engines import LAG, OTHERS, engine_table
from graphtrack.evaluation.reproduce.chen_image import IMAGE_GROUPS, image_scores
from graphtrack.evaluation.reproduce.chen_tables import (
    ANGLES,
    POSITION_STD,
    Methods,
    Scores,
    beside,
    by_angle,
    default_models,
    detail,
    draw_errors,
    estimated_errors,
    most_likely_error,
)
from graphtrack.evaluation.reproduce.experiment import (
    GAITS,
    MOCAP,
    Experiment,
    Progress,
    Reproduction,
    Settings,
    evenly,
)
from graphtrack.report.style import new_figure
from graphtrack.simulation.classes import add_class_likelihoods, confusion_matrix
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.sampling import simulate
from graphtrack.smoothing.recording import smooth, track_online
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, TrackSet

FLIPPED, AT_RANDOM = 0.2, 0.1
"""Shares of the answers that take front for back, and that are any class."""

BESIDE = "Paper / ours: mean error in degrees (Chen et al.'s classifiers on CHIL, ours as the notes say)"

METHODS: Methods = {
    "particle": ("online", lambda track, model: particle_filter(track, model).track),
    "particle, closest class": (
        "online",
        lambda track, model: particle_filter(track, model, options=ParticleOptions(pose="closest")).track,
    ),
    "graph, chain": ("online", lambda track, model: track_online(track, model, engine="chain", lag=LAG)),
    "graph, isam2": ("online", lambda track, model: track_online(track, model, engine="isam2", lag=LAG)),
    "smoother": ("offline", lambda track, model: smooth(TrackSet((track,)), model).tracks[0]),
}
"""Method → group and estimator."""

GROUPS = {method: group for method, (group, _) in METHODS.items()}

WITH_MODES = ("graph, chain", "graph, isam2", "smoother")
"""Methods that know the preset ``full`` too."""


def people(settings: Settings) -> dict[str, TrackSet]:
    """People by source whose body and head are seen by classifiers with a known confusion."""
    count = 4 if settings.quick else 42
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
    """The tracks as the experiment's classifiers see them."""
    return add_class_likelihoods(
        tracks,
        body=confusion_matrix(BODY_CLASSES, flipped=FLIPPED, at_random=AT_RANDOM),
        head=confusion_matrix(HEAD_CLASSES, flipped=FLIPPED, at_random=AT_RANDOM),
        rng=rng,
    )


def scores(data: str, tracks: TrackSet, progress: Progress) -> Scores:
    """Every method on every person, with each of the presets that it knows."""
    seen = [[most_likely_error(track, track, angle) for angle in ANGLES] for track in tracks]
    estimates = estimated_errors(tracks, METHODS, default_models(METHODS, WITH_MODES), progress)
    return Scores(data, len(tracks), by_angle(("observation", ""), seen) | estimates)


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment."""
    everyone = people(settings)
    found = [scores(name, tracks, progress) for name, tracks in everyone.items()]
    pictured = []
    for i, (name, tracks) in enumerate(everyone.items()):
        few = tracks[: 1 if settings.quick else 12]
        pictured.append(image_scores(name, few, partial(classified, rng=settings.rng(4, i))))
        progress(1)
    rng = settings.rng(99)
    notes = (
        f"Positions with {POSITION_STD} m of noise; in each frame a class of the body (8) and one of the "
        f"head (12), {100 * FLIPPED:.0f} % of them turned by 180°, {100 * AT_RANDOM:.0f} % any, as "
        "likelihoods that are calibrated. Errors are independent from frame to frame; those of a real "
        "classifier are not.",
        "Mean absolute error per person, mean over people, of five or more with its 95 % bootstrap interval. "
        "Every method gets the same frames and default parameters. Online estimates use the past alone; the "
        f"graphs keep {LAG:g} s open.",
        "closest class: eq. 13–14, the score of the class that is closest to a particle; particle is their "
        "smooth mixture, which the graph has. joint-body is what Chen et al. (2011) call separate (κ₂ = 0).",
        "Answers in the image: classes of the angles at which a camera 3 m above the ground sees them, "
        "judged there at each particle's position (eq. 13–14 as printed), or turned to the world once, where "
        "the position was observed; of the first people only.",
        "Every engine: the people of the first source.",
    )
    pictured_table = replace(
        detail(pictured, IMAGE_GROUPS, rng), title="Answers in the image of a camera (eq. 13–14)"
    )
    whole = detail(found, GROUPS, rng)
    figure = new_figure(4.2 * len(found) + 1.0, 7.2)
    grid = figure.subplots(2, len(found), sharex=True, sharey="row", squeeze=False)
    draw_errors(grid, found, GROUPS, rng)
    grid[0, 0].legend(frameon=False, fontsize=8)
    engines = engine_table(found[0], next(iter(everyone.values())), settings.rng(98), progress)
    return Reproduction(
        "chen-classes",
        (whole, pictured_table, engines, beside(found, GROUPS, BESIDE)),
        figure,
        notes,
    )


def work(settings: Settings) -> int:
    """Estimates, and the people of each source who are seen in the image."""
    everyone = people(settings)
    estimates = len(default_models(METHODS, WITH_MODES)) * sum(len(tracks) for tracks in everyone.values())
    return estimates + len(everyone) + len(OTHERS) * len(next(iter(everyone.values())))


EXPERIMENT = Experiment(
    "chen-classes",
    "Chen et al. 2011: class likelihoods of body and head, many of them wrong",
    work,
    run,
    "4 people of each source, 1 in the image",
)
