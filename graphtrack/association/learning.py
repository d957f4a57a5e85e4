"""The scene's parameters from the detections alone: expectation and maximisation around the association."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from graphtrack.association.chains import Chains, Scene
from graphtrack.association.duplicates import duplicate_density
from graphtrack.association.kernels import innovations
from graphtrack.geometry.angles import FloatArray
from graphtrack.scene import NOTHING, Known, SceneParameters
from graphtrack.table.detections import Detections

_EDGE = 3
"""Frames at either end of a recording in which somebody may have been missed who was there."""

_PRIOR_EVENTS = 2.0
"""Events that the first guess counts for."""

_FIRST_STD = 0.3
"""Metres of noise at first: more than most detectors have. Too little makes people of false detections, which
teach it to stay little; too much is unlearned in a round."""


def edge_of(frames: int) -> int:
    """Frames at either end of a recording of so many that do not tell who came or left."""
    return min(_EDGE, frames // 4)


def area(position: FloatArray) -> float:
    """Square metres in which detections are, (n, 2) metres: of the box around nearly all of them."""
    low, high = np.quantile(position, [0.005, 0.995], axis=0)
    return float(max(np.prod(high - low), 1.0))


def first_guess(detections: Detections) -> SceneParameters:
    """Parameters before anything is known but how many detections there are, and where."""
    start = SceneParameters()
    frames = detections.step[-1] + 1
    each = len(detections) / frames
    square = area(detections.position)
    seconds = detections.step_seconds
    # One in ten is false; people stay for ten seconds or so.
    return replace(
        start,
        position_std=_FIRST_STD,
        clutter_density=float(np.clip(max(0.1 * each, 0.1) / square, 1e-9, 100.0)),
        birth_density=float(np.clip(max(each / 10.0, 0.01) / square, 1e-9, 100.0)),
        death_rate=0.1,
        occlusion_probability=float(np.clip(0.05 * seconds, 1e-6, 0.5)),
    )


def learn_scene(
    chains: Chains,
    identity: NDArray[np.int64],
    scene: SceneParameters,
    known_std: FloatArray,
    seconds: float,
    known: Known = NOTHING,
) -> SceneParameters:
    """The parameters that make the tracks found most probable, with a little of those before.

    Parameters
    ----------
    identity : (n,) of each detection; −1: false
    known_std : (n,) metres that detections say themselves; NaN: they do not
    """
    if not (identity >= 0).any():
        return scene
    events = _Events.of(chains, identity, seconds)
    some, seen = events.gaps, float(events.seen)
    for _ in range(20):
        chance = (1.0 - scene.detection_probability) ** some
        occluded = scene.occlusion_probability * np.exp(-some * seconds / scene.occlusion_seconds)
        share = occluded / (chance + occluded)
        missed = float(((1.0 - share) * some).sum())
        hidden = ((share * some).sum() * seconds + 2.0) / (share.sum() + 1.0)
        gap = {
            "detection_probability": np.clip((seen + 9.0) / (seen + missed + 10.0), 0.02, 0.995),
            "occlusion_probability": np.clip(
                (share.sum() + 0.01 * _PRIOR_EVENTS) / (seen + _PRIOR_EVENTS), 1e-6, 0.3
            ),
            "occlusion_seconds": np.clip(hidden, 0.2, 20.0),
        }
        scene = replace(scene, **{name: float(value) for name, value in gap.items()} | dict(known))
    false = len(identity) - events.seen
    rates = {
        "clutter_density": _per_exposure(false, events.exposure, scene.clutter_density, 1e-9, 100.0),
        "birth_density": _per_exposure(events.born, events.open_exposure, scene.birth_density, 1e-9, 100.0),
        "death_rate": _per_exposure(events.left, events.in_view, scene.death_rate, 1e-6, 10.0),
    }
    return replace(scene, **_motion(chains, scene, seconds, known_std, known) | rates | dict(known))


def scene_log_density(
    chains: Chains, identity: NDArray[np.int64], scene: SceneParameters, seconds: float
) -> float:
    """Return the log density of detections and their tracks, which `learn_scene` maximises with priors.

    Log of a density in 1/m² for each detection, relative to any angle; where people come and go and
    detections are false is taken to be the same everywhere.

    Parameters
    ----------
    chains : the tracks, linked; they are filtered anew
    identity : (n,) of each detection; −1: false
    """
    events = _Events.of(chains, identity, seconds)
    gaps, hide = events.gaps, scene.occlusion_probability
    hidden = np.log(hide) - gaps * seconds / scene.occlusion_seconds
    between = np.logaddexp(gaps * np.log1p(-scene.detection_probability), hidden).sum()
    between += (events.links - len(gaps)) * np.log1p(-hide)
    around = duplicate_density(chains.frame, chains.position, identity, scene)[identity < 0]
    false = np.log(scene.clutter_density + around).sum() - scene.clutter_density * events.exposure
    false -= scene.duplicate_rate * events.seen
    came = events.born * np.log(scene.birth_density) - scene.birth_density * events.open_exposure
    went = events.left * np.log(scene.death_rate) - scene.death_rate * events.in_view
    places, angles, _ = innovations(chains, Scene(*scene.packed(seconds)))
    detected = events.seen * np.log(scene.detection_probability)
    return float(places + angles + detected + between + false + came + went)


def gaps_of(chains: Chains, identity: NDArray[np.int64]) -> FloatArray:
    """Frames (links,) between each detection of a person and the one before it."""
    linked = np.flatnonzero((identity >= 0) & (chains.preceding >= 0))
    return (chains.frame[linked] - chains.frame[chains.preceding[linked]] - 1).astype(float)


@dataclass(frozen=True, eq=False)
class _Events:
    """Counts of births, deaths, gaps and exposure in a recording.

    Attributes
    ----------
    gaps : frames of each gap within a track
    seen, links : detections of people, and pairs of them that follow each other
    born, left : people who came into view and who left
    in_view : seconds that people were there
    exposure, open_exposure : m² and frames in which detections can be false, m² s in which people can come
    """

    gaps: FloatArray
    seen: int
    links: int
    born: int
    left: int
    in_view: float
    exposure: float
    open_exposure: float

    @classmethod
    def of(cls, chains: Chains, identity: NDArray[np.int64], seconds: float) -> _Events:
        """Of the tracks in chains that are linked, with the identities (n,) of them; −1: false."""
        person = identity >= 0
        gaps = gaps_of(chains, identity)
        frames, square = int(chains.frame[-1]) + 1, area(chains.position)
        people, seen = int(identity.max()) + 1, int(person.sum())
        first, last = np.full(people, frames), np.zeros(people, np.int64)
        np.minimum.at(first, identity[person], chains.frame[person])
        np.maximum.at(last, identity[person], chains.frame[person])
        # Who is there at the beginning was not born then, and who is there at the end has not left.
        edge = edge_of(frames)
        return cls(
            gaps[gaps > 0],
            seen,
            len(gaps),
            int((first > edge).sum()),
            int((last < frames - 1 - edge).sum()),
            (seen + float(gaps.sum())) * seconds,
            square * frames,
            square * ((frames - edge) * seconds),
        )


def _per_exposure(events: int, exposure: float, before: float, low: float, high: float) -> float:
    """Events per exposure, with `_PRIOR_EVENTS` at the rate before: none so far does not mean never."""
    return float(np.clip((events + _PRIOR_EVENTS) / (exposure + _PRIOR_EVENTS / before), low, high))


def _motion(
    chains: Chains, scene: SceneParameters, seconds: float, known_std: FloatArray, known: Known
) -> dict[str, Any]:
    """Acceleration density and noise under which the detections follow each other most probably."""
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
        total, _, count = innovations(chains, Scene(*tried.packed(seconds)))
        # Weak priors about the guess, so that a track or two do not decide.
        off = logarithms - start
        return -total / max(count, 1) + 0.5 * float(off @ off) / max(count, 1)

    found = minimize(cost, start, method="Nelder-Mead", options={"maxfev": 120, "xatol": 0.05, "fatol": 1e-4})
    best = values(found.x)
    return best if unknown.any() else best | {"position_std": scene.position_std}


_MOTION = {
    "acceleration_density": (1e-2, 10.0),
    "position_std": (0.03, 3.0),
    "jump_probability": (1e-4, 0.2),
    "jump_std": (0.1, 1.5),
}
"""Least and greatest of what is learned of how people move and how they are seen to, in m²/s³, m, 1 and m."""
