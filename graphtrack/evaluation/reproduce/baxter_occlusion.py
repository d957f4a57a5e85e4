"""Baxter et al. 2014, Table I: a window is withheld around each sharp turn, and predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from graphtrack.baselines.intentional import OWN_FILTERS
from graphtrack.evaluation.reproduce.experiment import (
    ISAM2,
    MOCAP,
    TURNING,
    Cell,
    Experiment,
    Panel,
    Progress,
    Records,
    Reproduction,
    Settings,
    Table,
    evenly,
    interval_cells,
    page,
    tabulated,
    thinned,
)
from graphtrack.evaluation.reproduce.occlusion_methods import (
    FITS,
    FULL,
    OFFLINE,
    ONLINE,
    PRESETS,
    QUICK,
    WithheldWindows,
    error_of,
    fitted,
)
from graphtrack.evaluation.resampling import bootstrap, reduction
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.simulation.corpus import CorpusParameters, simulate_behaviour
from graphtrack.simulation.degrade import TURN_SECONDS, add_noise, occlude, turning, withhold
from graphtrack.tracks import Track, TrackSet

PAPER = {7: 64.0, 8: 75.5, 9: 84.5, 10: 12.9, 11: 73.2, 15: 62.0, 22: 68.3}
"""Baxter et al. 2014, Table I: number of the trajectory → reduction of the MSE in %."""

GRAPHS = tuple(f"graph {preset}{engine}" for engine in ("", ISAM2) for preset in PRESETS)
"""The online graphs, by the chain and by iSAM2."""

SHARP = (4, 5, 6)
"""Behaviours v–vii of the corpus."""

BEFORE, AFTER = 40, 20
"""Frames kept before and after the middle of a window: what is further off does not matter to it."""


@dataclass(frozen=True, eq=False)
class Case:
    """Tracks of one source with their windows, some to fit on and others to judge on.

    Attributes
    ----------
    name : in tables
    training, judged : tracks and windows
    reference : the online method that the others are measured against
    """

    name: str
    training: WithheldWindows
    judged: WithheldWindows
    reference: str


@dataclass(frozen=True, eq=False)
class WindowErrors:
    """Mean squared errors (m²) in the windows, method → one number a track."""

    case: Case
    head: str
    by_method: Mapping[str, FloatArray]


def cases(settings: Settings) -> list[Case]:
    """The corpus's sharp behaviours and, where it is there, the turning clips of motion capture."""
    found = []
    count, training = (4, 4) if settings.quick else (30, 8)
    parts: list[list[tuple[Track, BoolArray]]] = [[], []]
    for behaviour in SHARP:
        corpus = simulate_behaviour(
            behaviour, CorpusParameters(tracks=training + count), rng=settings.rng(behaviour)
        )
        # At 4 frames a second 0.1 m of noise on the path would pass for turns within a second.
        windows = _windows(corpus.tracks(), 3.0, turn_seconds=3.0)
        parts[0] += windows[:training]
        parts[1] += windows[training:]
    found.append(Case("corpus, 3 s", parts[0], parts[1], "kf"))
    mocap = settings.tracks(*MOCAP)
    if mocap is not None:
        clips = evenly(mocap.select(TURNING).map(thinned), 20 if settings.quick else 160, least_seconds=3.5)
        noisy = add_noise(clips, position_std=0.05, head_kappa=4.0, rng=settings.rng(0))
        windows = _windows(noisy.map(lambda track: replace(track, body=None, true_body=None)), 1.0)
        found.append(
            Case("mocap turns, 1 s", windows[::4], [w for i, w in enumerate(windows) if i % 4], "kf fitted")
        )
    return found


def _windows(
    tracks: TrackSet, seconds: float, turn_seconds: float = TURN_SECONDS
) -> list[tuple[Track, BoolArray]]:
    hidden = occlude(tracks, seconds, turn_seconds=turn_seconds)
    pairs = []
    for track in hidden.tracks:
        window = hidden.windows[track.track_id]
        middle = int(np.flatnonzero(window).mean())
        near = slice(max(middle - BEFORE, 0), middle + AFTER)
        pairs.append((track[near], window[near]))
    return pairs


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment."""
    effort = QUICK if settings.quick else FULL
    found = []
    for case in cases(settings):
        methods = fitted(case.training, effort, progress)
        hidden = [(withhold(t, w, ("head", "head_kappa")), w) for t, w in case.judged]
        for head, pairs in (("visible", case.judged), ("hidden", hidden)):
            errors = {}
            for name, predictor in methods.items():
                errors[name] = error_of(predictor, pairs)
                progress(1)
            found.append(WindowErrors(case, head, errors))
    rng = settings.rng(99)
    detail = _detail(found, rng)
    return Reproduction(
        "baxter-occlusion",
        (detail, trajectories(found), _beside(found, rng)),
        page(_panels(detail), columns=2),
        (
            "Position and body are withheld in the window, the head as the table says; nobody sees the body.",
            "Reduction: share by which the mean squared error is below a Kalman filter's (Baxter et "
            "al.'s own for "
            "printed, consistent and on the corpus, else the fitted one), offline below that of RTS, with a "
            "95 % bootstrap interval over five tracks or more; below −100 % the error is more than twice as "
            "large.",
            "Baxter et al.'s own filters count frames as steps, 10 a second on mocap and 4 on the corpus.",
            "Every method but Baxter et al.'s own three has the parameters that do best in windows "
            "of other tracks, "
            "the head visible. In joint-intentional the head steers the velocity as in intentional.",
            f"{effort.particles:,} particles online and {effort.smoother_particles:,} in ffbs, the particle "
            "smoother: after a gap few of them can have led to what came next.",
        ),
    )


def reference(errors: WindowErrors, method: str) -> FloatArray:
    """The errors that a method is measured against; Baxter et al.'s trackers against its own Kalman
    filter."""
    if method in OFFLINE:
        return errors.by_method["rts"]
    return errors.by_method["kf" if method in OWN_FILTERS else errors.case.reference]


@tabulated("Error in the withheld window")
def _detail(found: Sequence[WindowErrors], rng: np.random.Generator) -> Records:
    for errors in found:
        for method, own in errors.by_method.items():
            interval = bootstrap(reduction, own, reference(errors, method), rng=rng)
            yield {
                "data": errors.case.name,
                "head": errors.head,
                "group": "offline" if method in OFFLINE else "online",
                "method": method,
                "tracks": len(own),
                "RMSE (m)": float(np.sqrt(own.mean())),
                **interval_cells("reduction %", interval, scale=100.0),
            }


def trajectories(found: Sequence[WindowErrors]) -> Table:
    """Baxter et al.'s seven trajectories beside the seven of ours that turn most in the window, head
    visible."""
    errors = [one for one in found if one.head == "visible"][-1]
    turns = np.array([_turn(track, window) for track, window in errors.case.judged])
    sharpest = np.argsort(-turns, kind="stable")[: len(PAPER)]
    reductions = {
        method: 100.0 * (1.0 - errors.by_method[method] / reference(errors, method))
        for method in (*OWN_FILTERS, "intentional", *GRAPHS)
    }
    records: list[dict[str, Cell]] = []
    for (number, paper), k in zip(PAPER.items(), sharpest, strict=False):
        track = errors.case.judged[k][0]
        head: dict[str, Cell] = {
            "paper: trajectory": str(number),
            "paper: reduction (%)": paper,
            "ours": track.label or f"track {track.track_id}",
            "turn (°)": float(np.degrees(turns[k])),
        }
        records.append(head | {method: float(own[k]) for method, own in reductions.items()})
    mean: dict[str, Cell] = {
        "paper: trajectory": "mean",
        "paper: reduction (%)": float(np.mean(list(PAPER.values()))),
        "ours": f"mean of these {len(records)}",
        "turn (°)": float(np.degrees(turns[sharpest].mean())),
    }
    won: dict[str, Cell] = {
        "paper: trajectory": "improved",
        "paper: reduction (%)": 100.0,
        "ours": f"share of all {len(turns)} that is improved (%)",
        "turn (°)": float(np.degrees(turns.mean())),
    }
    records.append(mean | {method: float(own[sharpest].mean()) for method, own in reductions.items()})
    records.append(won | {method: 100.0 * float(np.mean(own > 0.0)) for method, own in reductions.items()})
    title = f"Reduction of the MSE (%) trajectory by trajectory, {errors.case.name}, head visible"
    return Table.of(title, records)


def _turn(track: Track, window: BoolArray) -> float:
    """Sharpest turn in the window, radians; 0 where nobody moves."""
    found = turning(track)[window]
    return float(np.nanmax(found, initial=0.0))


@tabulated("Paper / ours: reduction of the MSE in the window, head visible")
def _beside(found: Sequence[WindowErrors], rng: np.random.Generator) -> Records:
    """Baxter et al.'s mean over seven trajectories beside our reductions, head visible."""
    for errors in found:
        if errors.head == "hidden":
            continue
        for method in ONLINE:
            if method in ("kf", "kf fitted") or method not in errors.by_method:
                continue
            own, base = errors.by_method[method], reference(errors, method)
            interval = bootstrap(reduction, own, base, rng=rng)
            yield {
                "paper: mean of 7 (%)": float(np.mean(list(PAPER.values()))),
                "paper: from … to (%)": f"{min(PAPER.values())} … {max(PAPER.values())}",
                "ours: data": errors.case.name,
                "ours: method": method,
                **interval_cells("ours: reduction (%)", interval, scale=100.0),
                "median of tracks (%)": 100.0 * float(np.median(1.0 - own / base)),
            }


def _panels(detail: Table) -> list[Panel]:
    panels = []
    for data in dict.fromkeys(row["data"] for row in detail.records()):
        rows = [row for row in detail.records() if row["data"] == data]
        online = [row for row in rows if row["group"] == "online" and row["method"] not in ("kf", "printed")]
        offline = [row for row in rows if row["group"] == "offline"]
        title = f"{data}: MSE below the Kalman filter's (%)"
        panels.append(
            Panel(title, online, "head", "reduction %", "method", ("low", "high"), level=0.0, least=-60.0)
        )
        panels.append(Panel(f"{data}: RMSE (m), offline", offline, "head", "RMSE (m)", "method"))
    return panels


def work(settings: Settings) -> int:
    """Fits, and runs with the head visible and hidden."""
    runs = 2 * (len(ONLINE) + len(OFFLINE))
    return (FITS + runs) * (2 if settings.recording(*MOCAP) else 1)


EXPERIMENT = Experiment(
    "baxter-occlusion",
    "Baxter et al. 2014, Table I: prediction through a window withheld at each sharp turn",
    work,
    run,
    "12 simulated people and 15 clips of motion capture",
)
