"""Context: couplings that hold less where a shop window or a conversation is, told by an input of each frame.

Baxter et al. (2014, §V) leave to the future a choice between priors by the context.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from graphtrack.evaluation.metrics import angular_error
from graphtrack.experiments.behaviour.parties import members
from graphtrack.experiments.harness import (
    SALSA,
    Cell,
    Experiment,
    Panel,
    Parts,
    Row,
    Settings,
    Table,
    paired,
    unit_of,
)
from graphtrack.experiments.strangers import GROUPS
from graphtrack.geometry.angles import BoolArray, FloatArray, difference, wrap
from graphtrack.interaction.group_files import read_groups
from graphtrack.model import Model
from graphtrack.model.terms.couplings import BODY_FREE, HEAD_FREE
from graphtrack.simulation.degrade import add_noise
from graphtrack.smoothing import smooth
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track, TrackSet

PRESET = "joint"
NOISE = {"position_std": 0.1, "body_kappa": 3.6, "head_kappa": 8.2}
"""Noise of the observations: metres, and concentrations of 30° and 20°."""
WINDOW = np.array([0.0, 2.5])
"""Middle of the shop window, metres; people pass it along y = 0."""
NEAR, LOOK = 3.0, 0.7
"""Metres on either side of the window along the path where people look at it, and the share who do."""
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares to which couplings may be free where the context is, among which half of the people choose."""
EVERY = 5  # observed heads of which one is hidden, to be predicted


@dataclass(frozen=True, eq=False)
class Context:
    """Noisy people, and where the couplings named by ``inputs`` may hold less, (n,) of each."""

    name: str
    people: TrackSet
    free: list[BoolArray]
    inputs: tuple[str, ...]


def window_shoppers(settings: Settings) -> Context:
    """People who walk past a shop window; some turn their heads to it, which the model is told of all."""
    rng, people, fps = settings.rng(1), settings.few(40, 4), 10.0
    tracks, free = [], []
    for k in range(people):
        speed, side = rng.normal(1.3, 0.15), rng.choice([-1.0, 1.0])
        t = np.arange(round(16.0 / speed * fps)) / fps
        x = side * (speed * t - 8.0)
        path = np.column_stack([x, 0.1 * np.sin(0.8 * t + rng.uniform(0.0, 6.0))])
        course = np.arctan2(np.gradient(path[:, 1]), np.gradient(path[:, 0]))
        bearing = np.arctan2(WINDOW[1] - path[:, 1], WINDOW[0] - x)
        turn = np.clip((NEAR - np.abs(x)) / 0.8, 0.0, 1.0) * (rng.random() < LOOK)
        head = wrap(course + turn * difference(bearing, course))
        tracks.append(Track(k, np.arange(len(t)), t, path, body=course, head=head))
        free.append(np.abs(x) < NEAR)
    plain = add_noise(TrackSet(tuple(tracks)), **NOISE, rng=settings.rng(2))
    return Context("shop window, simulated", plain, free, (HEAD_FREE,))


def party(settings: Settings) -> Context | None:
    """SALSA's people: couplings hold less while somebody is in a conversation, as it is labelled."""
    recording, path = settings.tracks(*SALSA), settings.recording(*GROUPS)
    if recording is None or path is None:
        return None
    steps = settings.few(300, 20)
    recording = recording.map(lambda track: track[:steps])
    free = [together for together, _ in members(recording, read_groups(path))]
    plain = add_noise(recording, **NOISE, rng=settings.rng(3))
    return Context("conversations, SALSA", plain, free, (HEAD_FREE, BODY_FREE))


def informed(tracks: TrackSet, free: Sequence[BoolArray], names: tuple[str, ...], share: float) -> TrackSet:
    """Return tracks with these inputs: the share where couplings may hold less, else 0."""
    return tracks.with_tracks(
        replace(track, inputs={**track.inputs, **dict.fromkeys(names, np.where(some, share, 0.0))})
        for track, some in zip(tracks, free, strict=True)
    )


def hidden_density(tracks: TrackSet) -> FloatArray:
    """Return the mean log density of hidden heads, one number a person, in nats.

    Every fifth observed head is hidden; its density is a normal one about the smoothed estimate, with the
    variances of estimate and observation.
    """
    hidden = [np.flatnonzero(np.isfinite(track.head))[2::EVERY] for track in tracks]  # type: ignore[arg-type]
    blind = []
    for track, rows in zip(tracks, hidden, strict=True):
        head = np.array(track.head)
        head[rows] = np.nan
        blind.append(replace(track, head=head))
    found = []
    for estimate, track, rows in zip(
        smooth(tracks.with_tracks(blind), PRESET, constants="default"), tracks, hidden, strict=True
    ):
        assert estimate.head is not None and track.head is not None and track.head_kappa is not None
        variance = estimate.std("head")[rows] ** 2 + 1.0 / track.head_kappa[rows]
        off = difference(track.head[rows], estimate.head[rows])
        found.append(float(np.mean(-0.5 * (off**2 / variance + np.log(2.0 * np.pi * variance)))))
    return np.array(found)


def chosen_share(plain: TrackSet, free: Sequence[BoolArray], names: tuple[str, ...]) -> float:
    """Return the share of `SHARES` with which hidden heads of these people are likeliest."""
    densities = [hidden_density(informed(plain, free, names, share)).mean() for share in SHARES]
    return SHARES[int(np.argmax(densities))]


def _errors(estimates: TrackSet, truth: TrackSet, angle: str) -> FloatArray:
    pairs = zip(estimates, truth, strict=True)
    return np.array([angular_error(*pair, angle) for pair in pairs])  # type: ignore[arg-type]


def _row(one: Context, rng: np.random.Generator, settings: Settings) -> Row:
    """Return the figures of the half of the people who do not choose the share."""
    fitted, judged = ((one.people.with_tracks(one.people.tracks[k::2]), one.free[k::2]) for k in range(2))
    share = chosen_share(*fitted, one.inputs)
    settings.progress(1)
    plain, free = judged
    loosened = informed(plain, free, one.inputs, share)
    units = [unit_of(track) for track in plain]
    gains = hidden_density(loosened), hidden_density(plain)
    row: dict[str, Cell] = {
        "context": one.name,
        "people": len(units),
        "frames with it (%)": 100.0 * float(np.mean(np.concatenate(free))),
        "share": share,
        **paired("gain (nats a hidden head)", *gains, rng, units=units),
    }
    model = Model(PRESET)
    for way, estimator in (("online", track_online), ("offline", smooth)):
        found = [estimator(tracks, model, constants="default") for tracks in (plain, loosened)]
        for angle in ("body", "head"):
            before, after = (_errors(estimates, plain, angle) for estimates in found)
            name = f"{angle}, {way} (°)"
            row |= {f"{name}: without": float(before.mean()), f"{name}: with": float(after.mean())}
            row |= paired(
                f"{name}: difference", after, before, rng, f"{name}: low", f"{name}: high", units=units
            )
        settings.progress(1)
    return row


def _parts(settings: Settings) -> Parts:
    found = [one for one in (window_shoppers(settings), party(settings)) if one is not None]
    settings.expect(3 * len(found))
    rng = settings.rng(99)
    rows = [_row(one, rng, settings) for one in found]
    yield Table.of("Couplings that an input loosens: hidden heads and errors, with and without it", rows)
    gain = "gain (nats a hidden head)"
    yield Panel("Gain of the likelihood", rows, "context", gain, "context", ("low", "high"), level=0.0)
    yield (
        f"The inputs {HEAD_FREE} and {BODY_FREE} have the share where the context is, and 0 elsewhere: by so "
        "much less the couplings hold. Half of the people choose the share, the others are in the table. "
        "Gain: log density of every fifth observed head, which is hidden. Parameters are the package's, "
        "in both; 95 % intervals over people."
    )


EXPERIMENT = Experiment(
    "context",
    "no paper's: couplings that hold less by a shop window, or in a conversation",
    "4 people, and 20 steps of the party",
    _parts,
    columns=1,
)
