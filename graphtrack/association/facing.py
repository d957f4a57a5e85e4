"""Evidence of observed body and head angles for data association, with parameters learned from tracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from graphtrack.association.chains import Chains, Scene
from graphtrack.association.kernels import innovations
from graphtrack.geometry.angles import FloatArray, class_centres
from graphtrack.scene import NOTHING, Known, SceneParameters

IntArray = NDArray[np.int64]

_LEAST = 20
"""Neighbours in tracks below which angles say nothing."""
_OUTLIERS = (0.02, 0.9)
"""Shares of outliers that can be learned: angles are never thought sure."""


def observed_angles(channels: Mapping[str, FloatArray], n: int) -> FloatArray:
    """Observed body and head of each detection, (n, 2) radians; NaN where there is none.

    Parameters
    ----------
    channels : by the names of a track's attributes; where there is no angle, class likelihoods are taken by
        their circular mean
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


def learn_orientation(
    chains: Chains, scene: SceneParameters, seconds: float, known: Known = NOTHING
) -> SceneParameters:
    """The parameters of angles under which the tracks' are most probable.

    Parameters
    ----------
    chains : the tracks; their states are filtered anew
    """
    later = np.flatnonzero(chains.preceding >= 0)
    both = np.isfinite(chains.facing[later]) & np.isfinite(chains.facing[chains.preceding[later]])
    neutral: dict[str, Any] = {"body_outliers": 1.0, "head_outliers": 1.0}
    kinds = ("body_std", "body_turn", "heading_std"), ("head_std", "head_turn", "gaze_std")
    for column, names in enumerate(kinds):
        outliers = f"{names[0][:4]}_outliers"
        kept = {name: known[name] for name in (*names, outliers) if name in known}
        if both[:, column].sum() >= _LEAST and len(kept) <= len(names):
            others = replace(scene, **neutral)
            scene = replace(scene, **_fitted(chains, others, names, outliers, seconds, kept))
    return scene


def _fitted(
    chains: Chains,
    scene: SceneParameters,
    names: tuple[str, ...],
    outliers: str,
    seconds: float,
    kept: Known,
) -> dict[str, Any]:
    """Spreads and share of outliers of one kind of angle that make it most probable; some may be kept."""
    ranges = [SceneParameters.__dataclass_fields__[name].metadata["range"] for name in names]
    low, high = np.array(ranges).T

    def parameters(given: FloatArray) -> dict[str, Any]:
        spreads = np.clip(np.exp(given[:-1]), low, high).tolist()
        share = float(np.clip(given[-1], *_OUTLIERS))
        return dict(zip(names, spreads, strict=True)) | {outliers: share} | dict(kept)

    # Angles turn the velocity too, and so say where somebody is seen next.
    before, others, _ = innovations(chains, Scene(*scene.packed(seconds)))

    def cost(given: FloatArray) -> float:
        found = parameters(given)
        share = found[outliers]
        # A few angles' worth of doubt.
        doubt = 0.0 if outliers in kept else 2.0 * np.log(share) + 2.0 * np.log1p(-share)
        places, angles, _ = innovations(chains, Scene(*replace(scene, **found).packed(seconds)))
        return before + others - places - angles - float(doubt)

    start = [*np.log([getattr(SceneParameters(), name) for name in names]), 0.2]
    found = minimize(cost, start, method="Nelder-Mead", options={"maxfev": 40 * len(start), "fatol": 0.1})
    best = parameters(found.x)
    # Nothing is gained where the tracks' angles are no more probable than any.
    return best | ({outliers: 1.0} if found.fun > 0.0 else {}) | dict(kept)
