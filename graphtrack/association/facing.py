"""What observed angles say of who is who: learned from tracks, and never thought sharper than that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import i0e

from graphtrack.association.kernels import Chains
from graphtrack.association.scene import SceneParameters
from graphtrack.geometry.angles import FloatArray, class_centres

IntArray = NDArray[np.int64]

_LEAST = 20
"""Pairs of detections below which angles say nothing."""
_OUTLIERS = (0.02, 0.9)
"""Shares of outliers that can be learned; beyond the last one angles say nothing."""


def observed(channels: Mapping[str, FloatArray], n: int) -> FloatArray:
    """Observed body and head of each detection, (n, 2) radians; NaN where there is none.

    Parameters
    ----------
    channels : by the names of a track's attributes; where there is no angle, class likelihoods are taken by
        their circular mean
    n : detections
    """
    found = np.full((n, 2), np.nan)
    for column, name in enumerate(("body", "head")):
        if name in channels:
            found[:, column] = channels[name]
        classes = channels.get(f"{name}_likelihood")
        if classes is not None:
            centres = class_centres(classes.shape[1])
            mean = np.arctan2(classes @ np.sin(centres), classes @ np.cos(centres))
            found[:, column] = np.where(np.isnan(found[:, column]), mean, found[:, column])
    return found


def learned(chains: Chains, identity: IntArray, scene: SceneParameters) -> SceneParameters:
    """The parameters of angles under which the tracks' are most probable.

    Parameters
    ----------
    chains : the tracks, filtered
    identity : (n,) of each detection; −1: false
    scene : the parameters before
    """
    later = np.flatnonzero((identity >= 0) & (chains.preceding >= 0))
    earlier = chains.preceding[later]
    dt = chains.t[later] - chains.t[earlier]
    changes: dict[str, Any] = {}
    for column, name in enumerate(("body", "head")):
        turned = chains.facing[later, column] - chains.facing[earlier, column]
        known = np.isfinite(turned)
        std, turn, outliers = _fitted(turned[known], dt[known])
        changes |= {f"{name}_std": std, f"{name}_turn": turn, f"{name}_outliers": outliers}
    velocity = chains.state[later, 2:4]
    square = np.maximum(np.sum(velocity**2, axis=1), 1e-6)
    unsure = chains.state[later, 6] / square
    deviation = chains.facing[later, 0] - np.arctan2(velocity[:, 1], velocity[:, 0])
    known = np.isfinite(deviation) & (unsure < 0.5)
    std, _, outliers = _fitted(deviation[known], np.zeros(known.sum()))
    return replace(scene, **changes, heading_std=std, heading_outliers=outliers)


def _fitted(deviation: FloatArray, dt: FloatArray) -> tuple[float, float, float]:
    """Standard deviation (rad), growth (rad/√s) and outliers under which deviations are most probable."""
    if len(deviation) < _LEAST:
        return 0.3, 0.5, 1.0

    def cost(given: FloatArray) -> float:
        std, turn = np.exp(np.clip(given[:2], np.log(0.05), np.log(2.5)))
        outliers = np.clip(given[2], *_OUTLIERS)
        kappa = 1.0 / (std**2 + turn**2 * dt)
        density = np.exp(kappa * (np.cos(deviation) - 1.0)) / i0e(kappa)
        # A few pairs' worth of doubt.
        doubt = 2.0 * np.log(outliers) + 2.0 * np.log1p(-outliers)
        return float(-np.log((1.0 - outliers) * density + outliers).sum() - doubt)

    found = minimize(cost, [np.log(0.3), np.log(0.3), 0.3], method="Nelder-Mead", options={"maxfev": 120})
    std, turn = np.exp(np.clip(found.x[:2], np.log(0.05), np.log(2.5))).tolist()
    outliers = float(np.clip(found.x[2], *_OUTLIERS))
    return std, turn, 1.0 if outliers >= _OUTLIERS[1] else outliers
