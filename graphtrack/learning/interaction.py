"""Learning the parameters of groups (`fit_groups`) and of attention (`fit_attention`) from labels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.interaction.attention import Attention, AttentionParameters, attention
from graphtrack.interaction.evidence import (
    ALONG,
    DIRECTIONS,
    REACH,
    SLOW,
    PairEvidence,
    abreast,
    averaged,
    facing_scores,
    pair_evidence,
    pair_features,
    probabilities,
    walks,
    with_bodies,
)
from graphtrack.interaction.groups import groups, groups_of
from graphtrack.interaction.parameters import (
    DEFAULT,
    RINGS,
    ConversationWeights,
    FacingWeights,
    GroupParameters,
)
from graphtrack.interaction.people import IntArray, People, people_of
from graphtrack.interaction.scores import LEAST, GroupScore, LookScore, score_gaze, score_groups, true_shares
from graphtrack.interaction.tables import LookLabels
from graphtrack.io.groups import UNLABELLED, GroupLabels
from graphtrack.tracks.track import Track, TrackSet

_RIDGE = 20.0
_SPREAD = 1e-6


def fit_facing(
    people: People, evidence: list[PairEvidence], used: BoolArray, parameters: GroupParameters
) -> tuple[FacingWeights, FacingWeights]:
    """Learn the weights of companions and of others by the likelihood of bodies, with a ridge.

    ``evidence``: of the same people, with more or less information; ``used``: (n,) rows with a body
    """
    from scipy.optimize import minimize

    angle = np.arctan2(people.body[used, 1], people.body[used, 0])
    place = np.round(angle / (DIRECTIONS[1] - DIRECTIONS[0])).astype(np.int64) % len(DIRECTIONS)
    features = np.concatenate([_features(people, one, parameters.stride)[used] for one in evidence])
    chosen = (np.arange(len(features)), np.tile(place, len(evidence)))
    scale = features.std(axis=(0, 1)) + _SPREAD
    features = features / scale

    def cost(weights: FloatArray) -> tuple[float, FloatArray]:
        probability = probabilities(features @ weights)
        value = -np.log(probability[chosen] + 1e-300).sum() + 0.5 * _RIDGE * weights @ weights
        expected = np.einsum("nd,ndf->f", probability, features)
        return float(value), expected - features[chosen].sum(axis=0) + _RIDGE * weights

    found = minimize(cost, np.zeros(2 * len(RINGS)), jac=True, method="L-BFGS-B").x / scale
    values = [float(round(value, 3)) for value in np.clip(found, -50.0, 50.0).tolist()]
    return FacingWeights(*values[: len(RINGS)]), FacingWeights(*values[len(RINGS) :])


def _features(people: People, evidence: PairEvidence, stride: float) -> FloatArray:
    """Return (n, directions, 2·rings) counts of companions, and others, by distance from the o-space."""
    together = 0.5 * (1.0 + np.tanh(0.5 * evidence.odds))
    units = np.eye(2 * len(RINGS)).reshape(-1, 2, len(RINGS))
    scene = people.position, evidence.left, evidence.right, together
    return np.stack([facing_scores(*scene, weights, stride) for weights in units], axis=2)


_LEAST = 20
"""Pairs in frames, of those who walk together and of those who do not, below which nothing is learned."""


def fit_walking(people: People, label: IntArray, used: BoolArray, start: GroupParameters) -> GroupParameters:
    """Learn distances and velocities of labelled pairs who walk together, and of others who walk near.

    ``label``: (n,) numbers that those of a group share within a frame, −1: alone; ``used``: (n,) rows to
    learn from; ``start`` is returned where there are too few pairs.
    """
    left, right, _ = pair_features(people, start.stride)
    walk = walks(people, start)
    use = used[left] & used[right] & (np.minimum(walk[left], walk[right]) > 0.5)
    left, right = left[use], right[use]
    together = (label[left] == label[right]) & (label[left] >= 0)
    if min(np.count_nonzero(together), np.count_nonzero(~together)) < _LEAST:
        return start
    far, square = abreast(people, left, right)
    learned = {
        "walking_distance": far[together].mean(),
        "walking_distance_std": far[together].std(),
        "walking_speed_std": np.sqrt(0.5 * square[together].mean()),
        "strangers_speed_std": np.sqrt(0.5 * square[~together].mean()),
        "strangers_density": 1.0 / (np.pi * REACH**2 * ALONG),
        "walking_share": together.mean(),
    }
    ranges = {one.name: one.metadata["range"] for one in fields(start) if one.name in learned}
    values: dict[str, Any] = {
        name: float(np.clip(np.round(value, 4), *ranges[name])) for name, value in learned.items()
    }
    return replace(start, **values)


_APART = 12.0  # seconds between training frames: frames in between are correlated
_CAUTION = np.arange(-2.0, 2.01, 0.5)
_BLOCKS = 4
_CLEAR = 0.5  # length of the expected direction of bodies from which facing is learned
_SIGNS = np.array([1.0, -1.0, -1.0, -1.0, 1.0])
"""Sign of each feature's weight: see `ConversationWeights`."""

_HIDDEN: dict[str, Callable[[Track], Track]] = {
    "heads": lambda track: track,
    "bodies": lambda track: replace(track, head=None),
    "places": lambda track: replace(track, head=None, body=None),
}
"""Learned parts, each from people with only that information."""


@dataclass(frozen=True)
class GroupFit:
    """Learned parameters, and their scores on training and held-out data."""

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


def fit_groups(tracks: TrackSet, labels: GroupLabels, *, hold_out: float = 0.25) -> GroupFit:
    """Learn the weights of conversations by the likelihood of labelled pairs, and the caution by F1.

    Weights are of one sign each, pulled to 0 (ridge), and learned from a frame in `_APART` seconds. The
    caution has the best F1 (mean of T = 2/3 and T = 1) over parts of the time left out in turn. How people
    walk together is learned where enough do. Raise InputError if there are no labels, one group of all, or no
    groups.

    ``hold_out``: share of the recording's end held out for validation
    """
    people = people_of(tracks)
    label = labels.labels(*_rows(people))
    t = people.t[people.frame_of]
    labelled = label != UNLABELLED
    low, high = float(t[labelled].min()), float(t[labelled].max())
    split = high - hold_out * (high - low) if hold_out > 0.0 else np.inf
    parameters = walked = fit_walking(people, label, np.asarray(labelled & (t <= split)), DEFAULT)
    for name, hide in _HIDDEN.items():
        shown = with_bodies(people_of(hide(track) for track in tracks), DEFAULT.head_spread)
        if (name == "heads" and not shown.head.any()) or (name != "places" and not shown.body.any()):
            continue
        pairs = _pairs(shown, label, parameters)
        used = np.isin(pairs.t, _chosen(pairs.t, split))
        if walked != DEFAULT and not pairs.together[used].any():  # they all walk
            continue
        weights = _weights(pairs, used)
        caution = _caution(shown, label, pairs, parameters, name, split)
        parameters = parameters.with_weights(name, replace(weights, caution=caution))
    parameters = _faced(tracks, people, parameters, np.asarray(labelled & np.isin(t, _chosen(t, split))))
    before, after = (label.copy() for _ in range(2))
    before[t > split], after[t <= split] = UNLABELLED, UNLABELLED
    held = _scored(people, parameters, after) if (after != UNLABELLED).any() else None
    return GroupFit(parameters, DEFAULT, _scored(people, parameters, before), held)


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
    """Learn body directions, if any are known: from positions only, and from all information."""
    standing = used & (walks(people, parameters) < 0.5) & (np.linalg.norm(people.body, axis=1) > _CLEAR)
    if not standing.any():
        return parameters
    known = [people_of(_HIDDEN["places"](track) for track in tracks), people]
    evidence = [pair_evidence(one, parameters) for one in known]
    companions, strangers = fit_facing(people, evidence, standing, parameters)
    return replace(parameters, companions=companions, strangers=strangers)


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
            "only pairs of one group, or none, among pairs near each other" if len(together) else "no pairs",
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
        strangers = used & ~((pairs.t >= low) & (pairs.t < high))
        judged = np.where((t >= low) & (t < high) & (t <= split), label, UNLABELLED)
        try:
            weights = _weights(pairs, strangers)
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


_STEP = 0.5  # of the first simplex, in logarithms of parameters
_WIDE = 2.0  # 1-σ of the logarithm of a parameter about its start: a prior worth one labelled gaze
_MOST = 300  # evaluations


@dataclass(frozen=True)
class AttentionFit:
    """Learned parameters, and their scores on training and held-out data."""

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

    The result is calibrated for heads of this accuracy. The logarithms of the
    parameters (log odds of ``nothing``) are found by the simplex of Nelder and Mead (1965), with a wide
    Gaussian about the start, next to one term for each labelled gaze. Raise InputError without labelled gaze,
    or if all labels are nobody, or people of the labels are not among the tracks.

    Parameters
    ----------
    tracks : estimates or observations, as `attention` will be given them
    start : starting point; by default the parameters' defaults
    hold_out : share of the recording's end held out for validation
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
    begin, labelled_count = _free(start), _count_looked(first, labels, split)

    def cost(free: FloatArray) -> float:
        estimated = attention(tracks, parameters=_parameters(free), groups=found)
        belief = 0.5 * float(np.sum(((free - begin) / _WIDE) ** 2)) / max(labelled_count, 1)
        logs = [
            np.log(np.maximum(one.probability[rows][true], LEAST))[one.t[rows] <= split]
            for one, rows, true in true_shares(estimated, labels)
        ]
        return belief - float(np.concatenate(logs).mean())

    simplex = begin + np.vstack([np.zeros(len(begin)), _STEP * np.eye(len(begin))])
    options = {"maxfev": _MOST, "initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-4}
    best = _parameters(minimize(cost, begin, method="Nelder-Mead", options=options).x)
    parameters = AttentionParameters(*(float(f"{value:.3g}") for value in astuple(best)))
    estimated = attention(tracks, parameters=parameters, groups=found)
    after = (labelled > split).any()
    held = score_gaze(estimated, labels, (split, np.inf)) if after else None
    return AttentionFit(parameters, start, score_gaze(estimated, labels, (-np.inf, split)), held)


def _check(tracks: TrackSet, labels: LookLabels) -> None:
    known = np.array([track.track_id for track in tracks], dtype=np.int64)
    for name, identities in (("track", labels.track_id), ("target", labels.target[labels.target >= 0])):
        strange = np.setdiff1d(identities, known)
        if len(strange):
            raise InputError(f"{name} {strange[0]}", "people of the tracks", path=labels.path)
    if not (labels.target >= 0).any():
        raise InputError("no look at anybody", "looks at people, too", path=labels.path)


def _count_looked(found: list[Attention], labels: LookLabels, split: float) -> int:
    """Return the number of labelled looks: consecutive frames of one count once."""
    count = 0
    for one in found:
        target = labels.of(one.track_id, one.frame[one.t <= split])
        target = target[target != UNLABELLED]
        count += int(np.count_nonzero(np.diff(target))) + (len(target) > 0)
    return count


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
