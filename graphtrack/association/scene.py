"""Parameters of a scene, learned from detections and their tracks (expectation maximisation).

Rates of misses, occlusions, duplicates, births, deaths and clutter, and the motion. Births, deaths and
clutter also have maps over the ground plane: events are counted on a grid, blurred, and divided by the counts
expected under uniform rates. The grid lies as the detections do, whatever the axes of the coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.likelihood import (
    ANY_VELOCITY,
    VELOCITY,
    Chains,
    IntArray,
    count_misses,
    innovations,
    scene_of,
)
from graphtrack.association.motion import noise_of, velocities_of
from graphtrack.association.sensors import Views
from graphtrack.geometry.angles import FloatArray
from graphtrack.packages import ndimage, optimize, spatial
from graphtrack.tracks.detections import Detections
from graphtrack.tracks.scene import NOTHING, Known, SceneParameters

_DUPLICATE_REACH = 3.0  # spreads within which a detection may be a duplicate

Pairs: TypeAlias = tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]
"""Two detections per pair, and their squared distances (m²)."""


def duplicate_density(
    frame: NDArray[np.int64],
    position: FloatArray,
    identity: NDArray[np.int64],
    scene: SceneParameters,
) -> FloatArray:
    """Return the expected density of duplicates of other people at each detection, (n,) 1/m².

    Of two tracks that coincide, the track with more detections is the person. ``identity``: (n,), −1: false.
    """
    times = np.bincount(identity[identity >= 0], minlength=1)
    return duplicate_density_of(duplicate_pairs(frame, position, scene), identity, scene, times)


def duplicate_pairs(frame: NDArray[np.int64], position: FloatArray, scene: SceneParameters) -> Pairs:
    """Pairs in which one detection can be a duplicate of the other, in the order of `pairs_within`."""
    return pairs_within(frame, position, _DUPLICATE_REACH * scene.duplicate_spread)


def duplicate_density_of(
    pairs: Pairs, identity: NDArray[np.int64], scene: SceneParameters, times: NDArray[np.int64]
) -> FloatArray:
    """`duplicate_density` given the pairs; ``times`` has the number of detections of each identity."""
    first, second, square = pairs
    strength = np.where(identity >= 0, times[np.maximum(identity, 0)], 0)
    counts = (identity[second] >= 0) & (identity[first] != identity[second])
    counts &= (strength[second] > strength[first]) | (
        (strength[second] == strength[first]) & (identity[second] < identity[first])
    )
    first, square = first[counts], square[counts]
    variance = scene.duplicate_spread**2
    each = scene.duplicate_rate * np.exp(-0.5 * square / variance) / (2.0 * np.pi * variance)
    return np.bincount(first, each, minlength=len(identity)).astype(float)


def pairs_within(frame: NDArray[np.int64], position: FloatArray, reach: float) -> Pairs:
    """Pairs (both ways) of detections of one frame within reach (m), and their squared distances (m²)."""
    # Frames far apart on a third axis: one tree for all.
    apart = np.column_stack([position, frame * (10.0 * reach)])
    pairs = spatial.cKDTree(apart).query_pairs(reach, output_type="ndarray").reshape(-1, 2)
    first = np.concatenate([pairs[:, 0], pairs[:, 1]]).astype(np.int64)
    second = np.concatenate([pairs[:, 1], pairs[:, 0]]).astype(np.int64)
    return first, second, np.sum((position[first] - position[second]) ** 2, axis=1)


def learn_duplicates(
    frame: NDArray[np.int64],
    position: FloatArray,
    identity: NDArray[np.int64],
    scene: SceneParameters,
    known: Known = NOTHING,
) -> SceneParameters:
    """The scene with rate and spread of duplicates, unless known, from the false detections around people."""
    first, second, square = pairs_within(frame, position, 2.0)
    counts = (identity[first] < 0) & (identity[second] >= 0)
    first, square = first[counts], square[counts]
    people = float((identity >= 0).sum())
    free = [name for name in ("duplicate_rate", "duplicate_spread") if name not in known]
    rate, variance = scene.duplicate_rate, scene.duplicate_spread**2
    for _ in range(20 if free else 0):
        each = rate * np.exp(-0.5 * square / variance) / (2.0 * np.pi * variance)
        around = np.bincount(first, each, minlength=len(frame))
        share = each / (around[first] + scene.clutter_density)
        total = float(share.sum())
        if "duplicate_rate" in free:
            rate = (total + 0.02) / (people + 1.0)
        if "duplicate_spread" in free:
            variance = float(np.clip((0.5 * (share * square).sum() + 0.25) / (total + 1.0), 0.01, 1.0))
    found: dict[str, Any] = {
        "duplicate_rate": float(np.clip(rate, 0.0, 10.0)),
        "duplicate_spread": float(np.sqrt(variance)),
    }
    return replace(scene, **{name: found[name] for name in free})


_EDGE = 3  # frames of a sensor at either end of a recording in which a person may have been missed

_PRIOR_EVENTS = 2.0  # pseudo-count of events at the first guess

_MORE_NOISE = 1.2
"""Initial noise over that of `noise_of`: learning lowers it, but hardly raises it."""

_LEAST_AREA = 25.0  # m² of a scene of which little has been detected so far
_LEAST_STD, _GREATEST_STD = 0.03, 1.0  # metres, of the initial noise


def edge_of(frames: int, chains: Chains) -> int:
    """Frames at either end of a recording that are not counted as births or deaths."""
    return min(_EDGE * max(chains.scans.shape[1], 1), frames // 4)


_TURNS = 9  # directions in each of the two rounds of the search for the smallest box


def smallest_box(position: FloatArray) -> tuple[FloatArray, float]:
    """Axes (2, 2), a unit vector a row, and area in m² of the smallest box around nearly all detections.

    The directions that are tried follow from the detections (n, 2), metres: first from their principal axis
    on, then around the best. Rotations, translations and reflections of the ground change nothing.
    """
    x, y = (position - position.mean(axis=0)).T
    around, step = 0.5 * float(np.arctan2(2.0 * (x @ y), x @ x - y @ y)), 0.5 * np.pi / _TURNS
    tried = around + step * np.arange(_TURNS)
    for _ in range(2):
        boxes = [_box(position, angle) for angle in tried.tolist()]
        axes, square = min(boxes, key=itemgetter(1))
        tried = np.arctan2(axes[0, 1], axes[0, 0]) + step / _TURNS * np.arange(1 - _TURNS, _TURNS)
    return axes, square


def _box(position: FloatArray, angle: float) -> tuple[FloatArray, float]:
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    low, high = np.quantile(position @ axes.T, [0.005, 0.995], axis=0)
    return axes, float(max(np.prod(high - low), 1.0))


def first_guess(detections: Detections) -> SceneParameters:
    """Initial parameters, from the number and the places of detections."""
    start = SceneParameters()
    frames = detections.step[-1] + 1
    each = len(detections) / frames
    _, square = smallest_box(detections.position)
    seconds = detections.step_seconds
    noise = noise_of(detections.step, detections.position, square, seconds)
    square = max(square, _LEAST_AREA)
    # One detection in ten is false; people stay for about ten seconds.
    return replace(
        start,
        position_std=float(np.clip(_MORE_NOISE * noise, _LEAST_STD, _GREATEST_STD)),
        clutter_density=float(np.clip(max(0.1 * each, 0.1) / square, 1e-9, 100.0)),
        birth_density=float(np.clip(max(each / 10.0, 0.01) / square, 1e-9, 100.0)),
        death_rate=0.1,
        occlusion_probability=float(np.clip(0.05 * seconds, 1e-6, 0.5)),
    )


def first_velocities(
    detections: Detections, scene: SceneParameters, known: Known = NOTHING
) -> NDArray[np.void]:
    """The prior of velocities, see `velocities_of`; a Gaussian where its spread is known."""
    if "speed_std" in known:
        return np.array([(1.0, 0.0, 0.0, scene.speed_std**2)], VELOCITY)
    axes, _ = smallest_box(detections.position)
    noise, seconds = scene.position_std, detections.step_seconds
    return velocities_of(detections.step, detections.position, axes, seconds, noise, scene.speed_std)


def learn_scene(
    chains: Chains,
    identity: NDArray[np.int64],
    scene: SceneParameters,
    known_std: FloatArray,
    seconds: float,
    known: Known = NOTHING,
    velocities: NDArray[np.void] = ANY_VELOCITY,
) -> SceneParameters:
    """Maximum a posteriori parameters given the tracks, with the previous parameters as a weak prior.

    Parameters
    ----------
    identity : (n,) of each detection; −1: false
    known_std : (n,) declared noise of detections, metres; NaN: not declared
    """
    if not (identity >= 0).any():
        return scene
    events = _Events.of(chains, identity, seconds)
    frames, misses, detected = events.gaps, events.misses, float(events.detected)
    for _ in range(20):
        chance = (1.0 - scene.detection_probability) ** misses
        occluded = scene.occlusion_probability * np.exp(-frames * seconds / scene.occlusion_seconds)
        share = occluded / (chance + occluded)
        missed = float(((1.0 - share) * misses).sum())
        hidden = ((share * frames).sum() * seconds + 2.0) / (share.sum() + 1.0)
        gap = {
            "detection_probability": np.clip((detected + 9.0) / (detected + missed + 10.0), 0.02, 0.995),
            "occlusion_probability": np.clip(
                (share.sum() + 0.01 * _PRIOR_EVENTS) / (detected + _PRIOR_EVENTS), 1e-6, 0.3
            ),
            "occlusion_seconds": np.clip(hidden, 0.2, 20.0),
        }
        scene = replace(scene, **{name: float(value) for name, value in gap.items()} | dict(known))
    false = len(identity) - events.detected
    rates = {
        "clutter_density": _per_exposure(false, events.exposure, scene.clutter_density, 1e-9, 100.0),
        "birth_density": _per_exposure(events.born, events.open_exposure, scene.birth_density, 1e-9, 100.0),
        "death_rate": _per_exposure(events.left, events.in_view, scene.death_rate, 1e-6, 10.0),
    }
    motion = _motion(chains, scene, seconds, known_std, known, velocities)
    return replace(scene, **motion | rates | dict(known))


def scene_log_density(
    chains: Chains, identity: NDArray[np.int64], scene: SceneParameters, seconds: float
) -> float:
    """Return the log density (1/m² a detection, uniform rates) that `learn_scene` maximises with priors.

    Parameters
    ----------
    chains : the tracks, linked; they are filtered again
    identity : (n,) of each detection; −1: false
    """
    events = _Events.of(chains, identity, seconds)
    gaps, hide = events.gaps, scene.occlusion_probability
    hidden = np.log(hide) - gaps * seconds / scene.occlusion_seconds
    between = np.logaddexp(events.misses * np.log1p(-scene.detection_probability), hidden).sum()
    between += (events.links - len(gaps)) * np.log1p(-hide)
    around = duplicate_density(chains.frame, chains.position, identity, scene)[identity < 0]
    false = np.log(scene.clutter_density + around).sum() - scene.clutter_density * events.exposure
    false -= scene.duplicate_rate * events.detected
    came = events.born * np.log(scene.birth_density) - scene.birth_density * events.open_exposure
    went = events.left * np.log(scene.death_rate) - scene.death_rate * events.in_view
    positions, angles, _ = innovations(chains, scene_of(scene, seconds))
    detected = events.detected * np.log(scene.detection_probability)
    return float(positions + angles + detected + between + false + came + went)


def gaps_of(chains: Chains, identity: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Frames (links,) between each detection of a person and the previous one, and the misses in them."""
    linked = np.flatnonzero((identity >= 0) & (chains.preceding >= 0))
    before = chains.preceding[linked]
    frames = (chains.frame[linked] - chains.frame[before] - 1).astype(float)
    if not chains.scans.shape[1]:
        return frames, frames
    missed = np.zeros(len(linked))
    views = Views.of(chains.position, chains.sensor, chains.scans.shape[1])
    count_misses(chains, before, linked, views.heights, missed)
    return frames, missed


@dataclass(frozen=True, eq=False)
class _Events:
    """Counts of births, deaths, gaps and exposure in a recording."""

    gaps: FloatArray  # frames of each gap within a track in which the person was missed
    misses: FloatArray  # of them, of sensors that see the places around the gap
    detected: int  # detections of people
    links: int  # pairs of consecutive detections
    born: int  # people who came into view
    left: int  # people who left
    in_view: float  # seconds that people were there
    exposure: float  # m² · frames in which detections can be false
    open_exposure: float  # m² · s in which people can come

    @classmethod
    def of(cls, chains: Chains, identity: NDArray[np.int64], seconds: float) -> _Events:
        """Count them in linked chains, with the identities (n,); −1: false."""
        person = identity >= 0
        gaps, misses = gaps_of(chains, identity)
        frames, (_, square) = int(chains.frame[-1]) + 1, smallest_box(chains.position)
        people, detected = int(identity.max()) + 1, int(person.sum())
        first, last = np.full(people, frames), np.zeros(people, np.int64)
        np.minimum.at(first, identity[person], chains.frame[person])
        np.maximum.at(last, identity[person], chains.frame[person])
        # A person present at the start or at the end is no birth or death.
        edge = edge_of(frames, chains)
        return cls(
            gaps[misses > 0],
            misses[misses > 0],
            detected,
            len(gaps),
            int((first > edge).sum()),
            int((last < frames - 1 - edge).sum()),
            (detected + float(gaps.sum())) * seconds,
            square * frames,
            square * ((frames - edge) * seconds),
        )


def _per_exposure(events: int, exposure: float, before: float, low: float, high: float) -> float:
    """Events per exposure, with `_PRIOR_EVENTS` at the previous rate, so that no rate becomes 0."""
    return float(np.clip((events + _PRIOR_EVENTS) / (exposure + _PRIOR_EVENTS / before), low, high))


def _motion(
    chains: Chains,
    scene: SceneParameters,
    seconds: float,
    known_std: FloatArray,
    known: Known,
    velocities: NDArray[np.void],
) -> dict[str, Any]:
    """Acceleration density and noise of maximum likelihood, given the links."""
    unknown = np.isnan(known_std)
    names = [name for name in _MOTION if name not in known]
    if not names:
        return {}
    lowest, highest = np.log([_MOTION[name] for name in names]).T
    start = np.clip(np.log([max(getattr(scene, name), 1e-9) for name in names]), lowest, highest)

    def values(logarithms: FloatArray) -> dict[str, Any]:
        return dict(zip(names, np.exp(np.clip(logarithms, lowest, highest)).tolist(), strict=True))

    def cost(logarithms: FloatArray) -> float:
        tried = replace(scene, **values(logarithms))
        if unknown.any():
            chains.variance[unknown] = tried.position_std**2
        total, _, count = innovations(chains, scene_of(tried, seconds, velocities))
        # Weak priors about the guess, for recordings of few tracks.
        off = logarithms - start
        return -total / max(count, 1) + 0.5 * float(off @ off) / max(count, 1)

    found = optimize.minimize(
        cost, start, method="Nelder-Mead", options={"maxfev": 120, "xatol": 0.05, "fatol": 1e-4}
    )
    best = values(found.x)
    return best if unknown.any() else best | {"position_std": scene.position_std}


_MOTION = {
    "acceleration_density": (1e-2, 10.0),
    "position_std": (0.03, 3.0),
    "jump_probability": (1e-4, 0.2),
    "jump_std": (0.1, 1.5),
}
"""Bounds of the learned motion and noise parameters, in m²/s³, m, 1 and m."""


SPREAD = 2.0
"""Metres, standard deviation of the blur of the places where people enter."""

AHEAD = 2.0
"""Seconds ahead of the last position at which the map of deaths is read: a person entering stays."""

_CELL = 0.5 * SPREAD
_REACH = 4.0 * SPREAD
_LARGEST = 1000  # corners along an axis: a kilometre; events beyond are counted at the edge
_PEAK = 1.0 / (2.0 * np.pi * SPREAD**2)
_PRIOR = 2.0 * _PEAK  # pseudo-count per square metre of the mean rate: two at the peak


@dataclass(frozen=True, eq=False)
class GroundRates:
    """Rates over the ground, on a grid.

    Attributes
    ----------
    axes : (2, 2) unit vectors along the grid, one a row
    origin : (2,) metres along these, of the grid's first corner
    births, deaths, clutter : (2, nx, ny) events per square metre, observed, and expected under uniform
        rates
    ways_out : the deaths, at the positions `AHEAD` seconds after the last detection
    """

    axes: FloatArray
    origin: FloatArray
    births: FloatArray
    deaths: FloatArray
    clutter: FloatArray
    ways_out: FloatArray

    def at(
        self, position: FloatArray, own: tuple[FloatArray, FloatArray, FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return births, deaths and clutter at positions (n, 2), as multiples of their mean rates.

        ``own``: (n,) each, events per square metre to leave out of the counts
        """
        came, left, false = (0.0, 0.0, 0.0) if own is None else own
        cells = self._in_cells(position)
        births, deaths = _rate(self.births, came, cells), _rate(self.deaths, left, cells)
        return births, deaths, _rate(self.clutter, false, cells)

    def leaving_for(self, goal: FloatArray) -> FloatArray:
        """Return the death rate at positions (n, 2) predicted `AHEAD` seconds ahead, in mean rates."""
        return _rate(self.ways_out, 0.0, self._in_cells(goal))

    def _in_cells(self, position: FloatArray) -> FloatArray:
        """(2, n) fractional indices of the grids' corners, of positions (n, 2)."""
        cells: FloatArray = ((position @ self.axes.T - self.origin) / _CELL).T
        return cells


def _rate(grids: FloatArray, own: FloatArray | float, cells: FloatArray) -> FloatArray:
    """Return the rate as a multiple of its mean, without the events (n,) to leave out."""
    events, expected = (ndimage.map_coordinates(grid, cells, order=1, mode="nearest") for grid in grids)
    rate: FloatArray = (np.maximum(events - own, 0.0) + _PRIOR) / (expected + _PRIOR)
    return rate


def learn_ground_rates(chains: Chains, identity: IntArray) -> GroundRates:
    """Learn the maps from the filtered tracks of a recording.

    ``identity`` (n,) is of each detection, from 0; −1: false.
    """
    return _counted(chains, identity >= 0, *_events(chains, identity))


def _counted(chains: Chains, person: NDArray[np.bool_], first: IntArray, last: IntArray) -> GroundRates:
    axes, square = smallest_box(chains.position)
    position, ahead = chains.position @ axes.T, AHEAD * chains.velocity @ axes.T
    goal = position + ahead
    # The same grid from either end of an axis.
    middle, half = 0.5 * (position.min(axis=0) + position.max(axis=0)), 0.5 * np.ptp(position, axis=0)
    cells = np.minimum(np.ceil((half + _REACH) / _CELL).astype(int), _LARGEST // 2)
    low, shape = middle - cells * _CELL, 2 * cells + 1

    def blurred(positions: FloatArray, weight: float = 1.0) -> FloatArray:
        # Shared among the four corners around, so that no position is at the edge of a cell.
        place = np.clip((positions - low) / _CELL, 0.0, shape - 1.0)
        corner = np.minimum(place.astype(int), shape - 2)
        share, counts = place - corner, np.zeros(shape)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            of_corner = np.abs(1 - i - share[:, 0]) * np.abs(1 - j - share[:, 1])
            np.add.at(counts, (corner[:, 0] + i, corner[:, 1] + j), weight * of_corner)
        return ndimage.gaussian_filter(counts, SPREAD / _CELL, mode="constant") / _CELL**2

    # Deaths are exposed where people are; births and clutter everywhere.
    each = len(last) / max(int(person.sum()), 1)
    return GroundRates(
        axes,
        low,
        np.stack([blurred(position[first]), np.full(shape, len(first) / square)]),
        np.stack([blurred(position[last]), blurred(position[person], each)]),
        np.stack([blurred(position[~person]), np.full(shape, (~person).sum() / square)]),
        np.stack([blurred(goal[last]), blurred(goal[person], each)]),
    )


def own_rates(chains: Chains, identity: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rates of `learn_ground_rates` at its own detections, (n,) each, without events of their own tracks."""
    position, person = chains.position, identity >= 0
    first, last = _events(chains, identity)
    came, left = (_of_own(position, identity, events) for events in (first, last))
    false = np.where(person, 0.0, _PEAK)
    return _counted(chains, person, first, last).at(position, (came, left, false))


def _events(chains: Chains, identity: IntArray) -> tuple[IntArray, IntArray]:
    """The detections at births and at deaths within the recording."""
    newest = int(chains.frame[-1])
    edge = edge_of(newest + 1, chains)
    person = identity >= 0
    first = np.flatnonzero(person & (chains.preceding < 0) & (chains.frame > edge))
    last = np.flatnonzero(person & (chains.following < 0) & (chains.frame < newest - edge))
    return first, last


def _of_own(position: FloatArray, identity: IntArray, events: IntArray) -> FloatArray:
    """(n,) per square metre, the contribution of a detection's own track to the count there."""
    event = np.full(max(int(identity.max()), 0) + 1, -1)
    event[identity[events]] = events
    found = np.where(identity >= 0, event[identity], -1)
    square = np.sum((position - position[found]) ** 2, axis=1)
    return np.where(found >= 0, _PEAK * np.exp(-0.5 * square / SPREAD**2), 0.0)
