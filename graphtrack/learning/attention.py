"""`fit_attention`: how people look, from labelled looks."""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np

from graphtrack.behaviour.attention import Attention, AttentionParameters, attention
from graphtrack.behaviour.groups import groups
from graphtrack.behaviour.tables import LookLabels
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.interaction.scores import LEAST, LookScore, score_looks, true_shares
from graphtrack.table.groups import UNLABELLED
from graphtrack.tracks import TrackSet

_STEP = 0.5
"""Of the first simplex, in logarithms of parameters."""
_WIDE = 2.0
"""1-σ of the logarithm of a parameter about where it started: a look's worth of belief."""
_MOST = 300
"""Evaluations."""


@dataclass(frozen=True)
class AttentionFit:
    """Learned parameters, and their scores on what was learned from and on what was held out."""

    parameters: AttentionParameters
    start: AttentionParameters
    learned_from: LookScore
    held_out: LookScore | None


def fit_attention(
    tracks: TrackSet,
    labels: LookLabels,
    start: AttentionParameters | None = None,
    *,
    hold_out: float = 0.25,
) -> AttentionFit:
    """Learn by the probability of the true targets, given the heads as they are known here.

    So what is learned is calibrated for heads that are seen as well as these. The logarithms of the
    parameters (log odds of ``nothing``) are found by the simplex of Nelder and Mead (1965), with a wide
    Gaussian about the start, beside one term for each labelled look.

    Parameters
    ----------
    tracks : estimates or observations, as `attention` will be given them
    start : where to begin; by default the parameters' own
    hold_out : share of the recording's end that only judges

    Raises
    ------
    InputError
        If no look is labelled, or all are at nobody, or people of the labels are not among the tracks.
    """
    from scipy.optimize import minimize

    start = AttentionParameters() if start is None else start
    _check(tracks, labels)
    found = groups(tracks)
    first = attention(tracks, parameters=start, groups=found)
    labelled = np.concatenate([one.t[rows] for one, rows, _ in true_shares(first, labels)])
    if not len(labelled):
        raise InputError("no frame with labelled looks", "people and frames of the tracks", path=labels.path)
    low, high = float(labelled.min()), float(labelled.max())
    split = high - hold_out * (high - low) if hold_out > 0.0 else np.inf
    begin, looks = _free(start), _looks(first, labels, split)

    def cost(free: FloatArray) -> float:
        told = attention(tracks, parameters=_parameters(free), groups=found)
        belief = 0.5 * float(np.sum(((free - begin) / _WIDE) ** 2)) / max(looks, 1)
        return belief - _log_score(told, labels, split)

    simplex = begin + np.vstack([np.zeros(len(begin)), _STEP * np.eye(len(begin))])
    options = {"maxfev": _MOST, "initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-4}
    parameters = _rounded(_parameters(minimize(cost, begin, method="Nelder-Mead", options=options).x))
    told = attention(tracks, parameters=parameters, groups=found)
    after = (labelled > split).any()
    held = score_looks(told, labels, (split, np.inf)) if after else None
    return AttentionFit(parameters, start, score_looks(told, labels, (-np.inf, split)), held)


def _check(tracks: TrackSet, labels: LookLabels) -> None:
    known = np.array([track.track_id for track in tracks], dtype=np.int64)
    for name, who in (("track", labels.track_id), ("target", labels.target[labels.target >= 0])):
        strange = np.setdiff1d(who, known)
        if len(strange):
            raise InputError(f"{name} {strange[0]}", "people of the tracks", path=labels.path)
    if not (labels.target >= 0).any():
        raise InputError("no look at anybody", "looks at people, too", path=labels.path)


def _looks(found: list[Attention], labels: LookLabels, split: float) -> int:
    """Return the number of labelled looks: consecutive frames of one count once."""
    count = 0
    for one in found:
        target = labels.of(one.track_id, one.frame[one.t <= split])
        target = target[target != UNLABELLED]
        count += int(np.count_nonzero(np.diff(target))) + (len(target) > 0)
    return count


def _log_score(found: list[Attention], labels: LookLabels, split: float) -> float:
    logs = [
        np.log(np.maximum(one.probability[rows][true], LEAST))[one.t[rows] <= split]
        for one, rows, true in true_shares(found, labels)
    ]
    return float(np.concatenate(logs).mean())


def _free(parameters: AttentionParameters) -> FloatArray:
    """(6,) logarithms, and log odds of the share."""
    values = {name: max(value, 1e-6) for name, value in vars(parameters).items()}
    share = min(max(parameters.nothing, 1e-6), 1.0 - 1e-6)
    values["nothing"] = share / (1.0 - share)
    return np.log(list(values.values()))


def _parameters(free: FloatArray) -> AttentionParameters:
    """The inverse of `_free`, within the bounds."""
    values = dict(zip(vars(AttentionParameters()), np.exp(np.clip(free, -14.0, 14.0)).tolist(), strict=True))
    values["nothing"] /= 1.0 + values["nothing"]
    for one in fields(AttentionParameters):
        low, high = one.metadata["range"]
        values[one.name] = min(max(values[one.name], low), high)
    return AttentionParameters(**values)


def _rounded(parameters: AttentionParameters) -> AttentionParameters:
    return AttentionParameters(*(float(f"{value:.3g}") for value in astuple(parameters)))
