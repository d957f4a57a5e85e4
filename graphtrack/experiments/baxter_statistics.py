"""Baxter et al. 2014, §II, Fig. 2: deviation of the head from the direction of travel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import circmean

from graphtrack.experiments.harness import (
    CAVIAR,
    GAITS,
    MOCAP,
    SALSA,
    Experiment,
    Parts,
    Row,
    Settings,
    Table,
)
from graphtrack.geometry.angles import FloatArray, difference, direction
from graphtrack.report.style import NEUTRAL_COLOUR, new_figure, tidy
from graphtrack.simulation.corpus import NUMERALS, CorpusParameters, simulate_behaviour
from graphtrack.simulation.degrade import MOVING_SPEED
from graphtrack.tracks.display import HEAD_COLOUR
from graphtrack.tracks.track import Track, TrackSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure


WINDOW_FRAMES = 24
"""Frames over which Baxter et al. (2014) average the velocity."""

HISTOGRAM_EDGES = np.radians(np.arange(-180.0, 181.0, 10.0))
"""Edges (37,) of the histogram's bins in radians."""

FUTURE_LAGS = 20
"""Largest lag in frames of `future_share`."""

FUTURE_TOLERANCE = float(np.radians(0.25))
"""Radians within which a head counts as being a direction to a later position."""

SUSPICIOUS_SHARE = 0.1
"""Beyond this share a head column is taken to be made of the future path; chance gives 1–2 %."""

_LEAST_STEP = 0.05
"""Metres below which a displacement has no direction to speak of."""


@dataclass(frozen=True, eq=False)
class DeviationStatistics:
    """The deviation ε = direction of travel − head of many people.

    Attributes
    ----------
    name : of the data
    people, frames : that had a deviation
    mean : circular mean, radians
    std : root mean square of wrapped deviations from the mean, radians
    density : (36,) histogram over `HISTOGRAM_EDGES`, per radian
    future : share of the heads that are exactly a direction to a later position
    """

    name: str
    people: int
    frames: int
    mean: float
    std: float
    density: FloatArray
    future: float

    @property
    def leaks_the_future(self) -> bool:
        """True if the head column was probably computed from the future path."""
        return self.future > SUSPICIOUS_SHARE


def travel_velocity(track: Track, window: int = WINDOW_FRAMES) -> FloatArray:
    """Velocity (n, 2) in m/s, the mean over a window of frames, as Baxter et al. (2014, §II) smooth it.

    Differences of neighbouring frames are averaged over ``window`` frames about each; at the ends over what
    there is. NaN where none is known.
    """
    rates = np.diff(track.position, axis=0) / np.diff(track.t)[:, None]
    known = np.asarray(np.isfinite(rates).all(axis=1))
    sums = np.vstack([np.zeros(2), np.cumsum(np.where(known[:, None], rates, 0.0), axis=0)])
    counts = np.concatenate([[0], np.cumsum(known)])
    frame = np.arange(len(track))
    low = np.clip(frame - window // 2, 0, len(rates))
    high = np.clip(frame - window // 2 + window, 0, len(rates))
    number = (counts[high] - counts[low])[:, None]
    return np.where(number > 0, (sums[high] - sums[low]) / np.maximum(number, 1), np.nan)


def head_deviation(track: Track, *, window: int = WINDOW_FRAMES, slow: bool = False) -> FloatArray:
    """ε_t = θ^v_t − θ^g_t (n,) in radians; NaN where the head is unknown or the person hardly moves.

    Parameters
    ----------
    track : positions and head
    window : frames over which the velocity is averaged
    slow : the frames below `MOVING_SPEED` in place of the others
    """
    if track.head is None:
        return np.full(len(track), np.nan)
    velocity = travel_velocity(track, window)
    with np.errstate(invalid="ignore"):
        moves = np.linalg.norm(velocity, axis=1) >= MOVING_SPEED
    moves = np.isfinite(velocity).all(axis=1) & (~moves if slow else moves)
    return np.where(moves, difference(direction(velocity), track.head), np.nan)


def future_share(tracks: Iterable[Track]) -> float:
    """The greatest share, over lags of 1 to `FUTURE_LAGS` frames, of heads that equal the direction ahead.

    A head that was annotated or estimated agrees with the exact direction to a later position by chance only.
    One that was computed from the path agrees nearly always, and would give a tracker the future. 0 without
    heads.
    """
    hits, counts = np.zeros(FUTURE_LAGS), np.zeros(FUTURE_LAGS)
    for track in tracks:
        if track.head is None:
            continue
        for lag in range(1, min(FUTURE_LAGS, len(track) - 1) + 1):
            ahead = track.position[lag:] - track.position[:-lag]
            with np.errstate(invalid="ignore"):
                use = (np.linalg.norm(ahead, axis=1) > _LEAST_STEP) & np.isfinite(track.head[:-lag])
            off = np.abs(difference(track.head[:-lag][use], direction(ahead[use])))
            hits[lag - 1] += np.sum(off < FUTURE_TOLERANCE)
            counts[lag - 1] += len(off)
    return float(np.max(hits / np.maximum(counts, 1)))


def deviation_statistics(
    tracks: Iterable[Track], name: str, *, window: int = WINDOW_FRAMES, slow: bool = False
) -> DeviationStatistics | None:
    """Mean, spread and histogram of the deviations of many people; None if nobody moves with a known head.

    ``slow``: of the frames in which they hardly move, see `head_deviation`.
    """
    tracks = list(tracks)
    deviations = [head_deviation(track, window=window, slow=slow) for track in tracks]
    deviations = [found[np.isfinite(found)] for found in deviations]
    pooled = np.concatenate([np.empty(0), *deviations])
    if not len(pooled):
        return None
    mean = float(circmean(pooled, high=np.pi, low=-np.pi))
    counts = np.histogram(pooled, HISTOGRAM_EDGES)[0]
    return DeviationStatistics(
        name=name,
        people=sum(bool(len(own)) for own in deviations),
        frames=len(pooled),
        mean=mean,
        std=float(np.sqrt(np.mean(difference(pooled, mean) ** 2))),
        density=counts / (counts.sum() * np.diff(HISTOGRAM_EDGES)),
        future=future_share(tracks),
    )


def _sources(settings: Settings) -> Iterator[tuple[str, TrackSet, int]]:
    """Names, people and windows, of the recordings that are there and of the corpus."""
    clips, caviar, salsa = (settings.tracks(*of) for of in (MOCAP, CAVIAR, SALSA))
    if clips is not None:
        yield from ((name, clips.select(*patterns), WINDOW_FRAMES) for name, patterns in GAITS.items())
    if caviar is not None:
        yield "CAVIAR mws1gt", caviar, WINDOW_FRAMES
    if salsa is not None:
        # At one row in three seconds a window of 24 frames would be more than a minute.
        yield "SALSA, party", salsa, 2
    corpus = [
        track
        for b in range(0, len(NUMERALS), settings.few(1, 3))
        for track in simulate_behaviour(b, CorpusParameters(tracks=20), rng=settings.rng(b)).tracks()
    ]
    yield "simulated corpus", TrackSet(tuple(corpus)), WINDOW_FRAMES


def _parts(settings: Settings) -> Parts:
    yield (
        f"ε = direction of the {WINDOW_FRAMES}-frame mean velocity − head, where people move at 0.3 m/s or "
        "more; circular mean, root mean square about it."
    )
    sources, found, slow = list(_sources(settings)), [], []
    settings.expect(len(sources))
    for name, tracks, window in sources:
        one = deviation_statistics(tracks, name, window=window)
        if one is None:
            yield f"{name} is left out: found no person in {name} who moves with a known head"
        else:
            found.append(one)
            standing = deviation_statistics(tracks, name, window=window, slow=True)
            slow += [standing] if standing is not None else []
            if one.leaks_the_future:
                yield (
                    f"{name}: {one.future:.0%} of the heads are exactly the direction to a later position; "
                    "they were computed from the path and reveal its future to a tracker"
                )
        if window != WINDOW_FRAMES:
            yield f"SALSA has a frame every 3 s: its velocity is averaged over {window} frames."
        settings.progress(1)
    yield (
        "The numbers of Baxter et al.'s Fig. 2 stand in the picture only; its people are counted in the text."
    )
    yield (
        "UCY is left out on purpose: most of its gaze is the direction to the next control point, the future."
    )
    yield Table.of("Direction of travel minus head", _rows(found))
    if slow:
        yield Table.of(f"The same of people slower than {MOVING_SPEED:g} m/s", _rows(slow))
    yield Table.of("Paper / ours: the same statistic; only CAVIAR is the same source", _published(found))
    yield _figure(found)


def _rows(found: Iterable[DeviationStatistics]) -> Iterator[Row]:
    for one in found:
        yield {
            "data": one.name,
            "people": one.people,
            "frames": one.frames,
            "mean (°)": float(np.degrees(one.mean)),
            "std (°)": float(np.degrees(one.std)),
            "within 22.5° (%)": 100.0 * _within(one, np.radians(22.5)),
            "heads equal to a later direction (%)": 100.0 * one.future,
        }


def _within(one: DeviationStatistics, reach: float) -> float:
    """Share of the deviations within ± reach, from the histogram; bins that straddle it count in part."""
    low = np.clip(HISTOGRAM_EDGES[:-1], -reach, reach)
    high = np.clip(HISTOGRAM_EDGES[1:], -reach, reach)
    return float(one.density @ (high - low))


def _published(found: list[DeviationStatistics]) -> Iterator[Row]:
    paper: dict[str, tuple[str, int]] = {
        "CAVIAR mws1gt": ("CAVIAR", 37),
        "mocap, walking": ("Benfold", 154),
        "mocap, turning": ("PETS 2007", 34),
    }
    for one in found:
        data, people = paper.get(one.name, ("–", None))
        yield {
            "paper: data": data,
            "paper: people": people,
            "paper: mean, std": "in the picture only" if people else "–",
            "ours: data": one.name,
            "ours: people": one.people,
            "ours: mean (°)": float(np.degrees(one.mean)),
            "ours: std (°)": float(np.degrees(one.std)),
        }


def _figure(found: list[DeviationStatistics]) -> Figure:
    columns = min(len(found), 3)
    lines = -(-len(found) // columns)
    figure = new_figure(max(3.6 * columns, 5.4), 2.7 * lines + 0.3)
    grid = figure.subplots(lines, columns, squeeze=False, sharex=True).ravel()
    edges = np.degrees(HISTOGRAM_EDGES)
    x = np.linspace(-180.0, 180.0, 361)
    for axes, one in zip(grid, found, strict=False):
        mean, std = float(np.degrees(one.mean)), float(np.degrees(one.std))
        axes.stairs(np.radians(one.density), edges, fill=True, color="#C9D4E3", label="histogram")
        # Wrapped, for a wide one reaches around.
        turns = x[:, None] + 360.0 * np.arange(-3, 4) - mean
        normal = np.exp(-0.5 * (turns / std) ** 2).sum(axis=1) / (std * np.sqrt(2.0 * np.pi))
        axes.plot(x, normal, color=HEAD_COLOUR, linewidth=1.4, label="normal density")
        axes.axvline(0.0, color=NEUTRAL_COLOUR, linewidth=0.8)
        title = f"{one.name}: {mean:.1f} ± {std:.1f}°".replace(": -", ": −")
        axes.set_title(title, fontsize=9, loc="left")
        axes.set_xticks(range(-180, 181, 90))
        tidy(axes)
    for axes in grid[len(found) :]:
        axes.remove()
    for axes in grid[max(len(found) - columns, 0) : len(found)]:
        axes.tick_params(labelbottom=True)
    grid[0].legend(frameon=False, fontsize=8)
    figure.supxlabel("direction of travel − head (°)", fontsize=10)
    figure.supylabel("density (per degree)", fontsize=10)
    return figure


EXPERIMENT = Experiment(
    "baxter-statistics",
    "Baxter et al. 2014, Fig. 2: deviation of the head from the direction of travel",
    "60 simulated people; the recordings are whole",
    _parts,
)
