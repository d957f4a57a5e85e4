"""`fit_groups`: the parameters of conversations, from labelled groups."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from graphtrack.behaviour.evidence import SLOW, pair_evidence, walks, with_bodies
from graphtrack.behaviour.features import pair_features
from graphtrack.behaviour.groups import groups_of
from graphtrack.behaviour.learned import DEFAULT
from graphtrack.behaviour.parameters import ConversationWeights, GroupParameters
from graphtrack.behaviour.people import IntArray, People, people_of
from graphtrack.behaviour.smoothing import averaged
from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.interaction.scores import GroupScore, score_groups
from graphtrack.learning.facing import fit_facing
from graphtrack.learning.walking import fit_walking
from graphtrack.table.groups import UNLABELLED, GroupLabels
from graphtrack.tracks import Track, TrackSet

_APART = 12.0
"""Seconds between the frames that are learned from: those between say the same again."""
_RIDGE = 20.0
_CAUTION = np.arange(-2.0, 2.01, 0.5)
_BLOCKS = 4
_CLEAR = 0.5
"""Length of the expected direction of bodies from which facing is learned."""
_SIGNS = np.array([1.0, -1.0, -1.0, -1.0, 1.0])
"""Which way each feature can only speak: see `ConversationWeights`."""

_HIDDEN: dict[str, Callable[[Track], Track]] = {
    "heads": lambda track: track,
    "bodies": lambda track: replace(track, head=None),
    "places": lambda track: replace(track, head=None, body=None),
}
"""What is learned, each from people of whom no more is known than that."""


@dataclass(frozen=True)
class GroupFit:
    """Learned parameters, and their scores on what was learned from and on what was held out."""

    parameters: GroupParameters
    start: GroupParameters
    learned_from: GroupScore
    held_out: GroupScore | None


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Averaged features of pairs in the frames that are labelled, and whether they share a group."""

    features: FloatArray
    together: BoolArray
    t: FloatArray


def fit_groups(
    tracks: TrackSet, labels: GroupLabels, start: GroupParameters | None = None, *, hold_out: float = 0.25
) -> GroupFit:
    """Learn the weights of conversations by the likelihood of labelled pairs, and the caution by F1.

    Weights are of one sign each, pulled to 0 (ridge), and learned from a frame in `_APART` seconds. The
    caution has the best F1 (mean of T = 2/3 and T = 1) over parts of the time left out in turn. How people
    walk together is learned where enough do.

    Parameters
    ----------
    hold_out : share of the recording's end that only judges

    Raises
    ------
    InputError
        If nobody is labelled, or all are together, or nobody is with anybody.
    """
    start = DEFAULT if start is None else start
    people = people_of(tracks)
    label = labels.labels(*_rows(people))
    t = people.t[people.frame_of]
    labelled = label != UNLABELLED
    low, high = float(t[labelled].min()), float(t[labelled].max())
    split = high - hold_out * (high - low) if hold_out > 0.0 else np.inf
    parameters = walked = fit_walking(people, label, np.asarray(labelled & (t <= split)), start)
    for name, hide in _HIDDEN.items():
        shown = with_bodies(people_of(hide(track) for track in tracks), start.head_spread)
        if (name == "heads" and not shown.head.any()) or (name != "places" and not shown.body.any()):
            continue
        pairs = _pairs(shown, label, parameters)
        used = np.isin(pairs.t, _chosen(pairs.t, split))
        if walked != start and not pairs.together[used].any():  # they all walk
            continue
        weights = _weights(pairs, used)
        caution = _caution(shown, label, pairs, parameters, name, split)
        parameters = parameters.with_weights(name, replace(weights, caution=caution))
    parameters = _faced(tracks, people, parameters, np.asarray(labelled & np.isin(t, _chosen(t, split))))
    before, after = (label.copy() for _ in range(2))
    before[t > split], after[t <= split] = UNLABELLED, UNLABELLED
    held = _scored(people, parameters, after) if (after != UNLABELLED).any() else None
    return GroupFit(parameters, start, _scored(people, parameters, before), held)


def _rows(people: People) -> tuple[IntArray, FloatArray, IntArray]:
    frame_of = people.frame_of
    return people.frame[frame_of], people.t[frame_of], people.ids[people.person]


def _scored(people: People, parameters: GroupParameters, label: IntArray) -> GroupScore:
    found = groups_of(people, parameters, pair_evidence(people, parameters))
    return score_groups(found.frame, found.track_id, found.group, label)


def _pairs(people: People, label: IntArray, parameters: GroupParameters) -> _Pairs:
    left, right, features = pair_features(people, parameters.stride)
    pair = people.person[left] * len(people.ids) + people.person[right]
    t = people.t[people.frame_of[left]]
    means, _ = averaged(pair, t, features, parameters.place_seconds)
    slow, _ = averaged(pair, t, features, parameters.look_seconds)
    means = np.where(SLOW, slow, means)
    walk = walks(people, parameters)
    use = (label[left] != UNLABELLED) & (np.maximum(walk[left], walk[right]) < 0.5)
    together = (label[left] == label[right]) & (label[left] >= 0)
    return _Pairs(means[use], together[use], t[use])


def _faced(tracks: TrackSet, people: People, parameters: GroupParameters, used: BoolArray) -> GroupParameters:
    """With where bodies face learned, if any are known: by places alone, and by all there is."""
    standing = used & (walks(people, parameters) < 0.5) & (np.linalg.norm(people.body, axis=1) > _CLEAR)
    if not standing.any():
        return parameters
    known = [people_of(_HIDDEN["places"](track) for track in tracks), people]
    evidence = [pair_evidence(one, parameters) for one in known]
    companions, others = fit_facing(people, evidence, standing, parameters)
    return replace(parameters, companions=companions, others=others)


def _chosen(t: FloatArray, split: float) -> list[float]:
    """The times that are learned from."""
    chosen, last = [], -np.inf
    for one in np.unique(t[t <= split]).tolist():
        if one - last >= _APART - 1e-6:
            chosen.append(one)
            last = one
    return chosen


def _weights(pairs: _Pairs, used: BoolArray) -> ConversationWeights:
    """Ridge regression of log odds, with weights of given signs."""
    from scipy.optimize import minimize

    features, together = pairs.features[used], pairs.together[used]
    if not together.any() or together.all():
        raise InputError(
            "pairs near each other who are all of one group, or none of whom are"
            if len(together)
            else "no pairs",
            "labelled groups, and people near each other of different ones",
        )
    mean, scale = features.mean(axis=0), features.std(axis=0) + 1e-9
    design = np.column_stack([np.ones(len(features)), _SIGNS * (features - mean) / scale])
    sign = np.where(together, 1.0, -1.0)

    def cost(weights: FloatArray) -> tuple[float, FloatArray]:
        odds = sign * (design @ weights)
        value = np.logaddexp(0.0, -odds).sum() + 0.5 * _RIDGE * weights[1:] @ weights[1:]
        share = 0.5 * (1.0 - np.tanh(0.5 * odds))
        gradient = -(design * (sign * share)[:, None]).sum(axis=0)
        gradient[1:] += _RIDGE * weights[1:]
        return float(value), gradient

    bounds = [(None, None)] + [(0.0, None)] * features.shape[1]
    found = minimize(cost, np.full(len(bounds), 0.1), jac=True, method="L-BFGS-B", bounds=bounds).x
    terms = np.where(features.std(axis=0) > 1e-6, _SIGNS * found[1:] / scale, 0.0)  # or it never varied
    bias = found[0] - terms @ mean
    values = [float(np.clip(round(float(value), 3) + 0.0, -50.0, 50.0)) for value in (bias, *terms)]
    return ConversationWeights(*values)


def _caution(
    people: People, label: IntArray, pairs: _Pairs, parameters: GroupParameters, name: str, split: float
) -> float:
    """The caution with the best F1 in parts of the time, each found by weights from the other parts."""
    used = np.isin(pairs.t, _chosen(pairs.t, split))
    t = people.t[people.frame_of]
    learned_t = t[(label != UNLABELLED) & (t <= split)]
    edges = np.linspace(learned_t.min(), learned_t.max() + 1e-6, _BLOCKS + 1)
    total = np.zeros(len(_CAUTION))
    for low, high in pairwise(edges):
        others = used & ~((pairs.t >= low) & (pairs.t < high))
        judged = np.where((t >= low) & (t < high) & (t <= split), label, UNLABELLED)
        try:
            weights = _weights(pairs, others)
        except InputError:  # nothing to learn from but this part
            continue
        if (judged == UNLABELLED).all():
            continue
        for k, caution in enumerate(_CAUTION.tolist()):
            chosen = parameters.with_weights(name, replace(weights, caution=caution))
            total[k] += sum(_scored(people, chosen, judged).f1)
    # Among those as good as the best within half a percent, the one that changes least.
    good = _CAUTION[total >= total.max() - 0.01 * _BLOCKS]
    return float(good[np.argmin(np.abs(good))])
