"""The scene's parameters from the detections alone: expectation and maximisation around the association."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from graphtrack.association.chains import Chains, Scene
from graphtrack.association.detections import Detections
from graphtrack.association.kernels import innovations
from graphtrack.association.scene import SceneParameters
from graphtrack.geometry.angles import FloatArray

_EDGE = 3
"""Frames at either end of a recording in which somebody may have been missed who was there."""

_PRIOR = 2.0
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


def learned(
    chains: Chains,
    identity: NDArray[np.int64],
    scene: SceneParameters,
    known_std: FloatArray,
    seconds: float,
) -> SceneParameters:
    """The parameters that make the tracks found most probable, with a little of those before.

    Parameters
    ----------
    chains : the tracks, filtered
    identity : (n,) of each detection; −1: false
    scene : the parameters before
    known_std : (n,) metres that detections say themselves; NaN: they do not
    seconds : from a frame to the next
    """
    people = int(identity.max()) + 1
    if people < 1:
        return scene
    frames, square = chains.frame[-1] + 1, area(chains.position)
    linked = np.flatnonzero((identity >= 0) & (chains.preceding >= 0))
    gaps = (chains.frame[linked] - chains.frame[chains.preceding[linked]] - 1).astype(float)
    seen = float((identity >= 0).sum())
    miss, hide, hidden = scene.detection_probability, scene.occlusion_probability, scene.occlusion_seconds
    for _ in range(20):
        some = gaps[gaps > 0]
        chance = (1.0 - miss) ** some
        occluded = hide * np.exp(-some * seconds / hidden)
        share = occluded / (chance + occluded)
        missed = float(((1.0 - share) * some).sum())
        miss = float(np.clip((seen + 9.0) / (seen + missed + 10.0), 0.02, 0.995))
        hide = float(np.clip((share.sum() + 0.01 * _PRIOR) / (seen + _PRIOR), 1e-6, 0.3))
        hidden = float(np.clip(((share * some).sum() * seconds + 2.0) / (share.sum() + 1.0), 0.2, 20.0))
    in_view = (seen + gaps.sum()) * seconds
    known = identity >= 0
    first, last = np.full(people, frames), np.zeros(people, np.int64)
    np.minimum.at(first, identity[known], chains.frame[known])
    np.maximum.at(last, identity[known], chains.frame[known])
    # Who is there at the beginning was not born then, and who is there at the end has not left.
    edge = edge_of(int(frames))
    born, left = int((first > edge).sum()), int((last < frames - 1 - edge).sum())
    open_seconds = (frames - edge) * seconds
    density, std = _motion(chains, scene, seconds, known_std)
    return replace(
        scene,
        acceleration_density=density,
        position_std=std,
        detection_probability=miss,
        occlusion_probability=hide,
        occlusion_seconds=hidden,
        clutter_density=_rate((identity < 0).sum(), square * frames, scene.clutter_density, 1e-9, 100.0),
        birth_density=_rate(born, square * open_seconds, scene.birth_density, 1e-9, 100.0),
        death_rate=_rate(left, in_view, scene.death_rate, 1e-6, 10.0),
    )


def _rate(events: int, exposure: float, before: float, low: float, high: float) -> float:
    """Events per exposure, with `_PRIOR` events at the rate of before: none so far does not mean never."""
    return float(np.clip((events + _PRIOR) / (exposure + _PRIOR / before), low, high))


def _motion(
    chains: Chains, scene: SceneParameters, seconds: float, known_std: FloatArray
) -> tuple[float, float]:
    """Acceleration density and noise under which the detections follow each other most probably."""
    unknown = np.isnan(known_std)
    start = [np.log(scene.acceleration_density), np.log(scene.position_std)]

    def cost(logarithms: FloatArray) -> float:
        density, std = np.exp(np.clip(logarithms, _LOWEST, _HIGHEST))
        if unknown.any():
            chains.variance[unknown] = std**2
        packed = replace(scene, acceleration_density=float(density)).packed(seconds)
        total, _, count = innovations(chains, Scene(*packed))
        # Weak priors about the guess, so that a track or two do not decide.
        off = logarithms - start
        return -total / max(count, 1) + 0.5 * float(off @ off) / max(count, 1)

    found = minimize(cost, start, method="Nelder-Mead", options={"maxfev": 60, "xatol": 0.05, "fatol": 1e-4})
    density, std = np.exp(np.clip(found.x, _LOWEST, _HIGHEST)).tolist()
    return density, std if unknown.any() else scene.position_std


_LOWEST, _HIGHEST = np.log([1e-2, 0.03]), np.log([10.0, 3.0])
"""Acceleration density (m²/s³) and standard deviation (m) within which people and detectors are."""
