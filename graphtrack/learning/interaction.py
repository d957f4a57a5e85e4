"""Learning the parameters of groups (`fit_groups`) and of attention (`fit_attention`) from labels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from typing import Generic, TypeAlias, TypeVar

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.interaction.attention import Attention, AttentionParameters, gaze_of, observers_of
from graphtrack.interaction.evidence import (
    ALONG,
    REACH,
    abreast,
    near_pairs,
    pair_evidence,
    walks,
)
from graphtrack.interaction.group_files import UNLABELLED, GroupLabels
from graphtrack.interaction.groups import groups, groups_of_present
from graphtrack.interaction.parameters import DEFAULT, GroupParameters
from graphtrack.interaction.people import IntArray, People, people_of, with_absent
from graphtrack.interaction.scores import LEAST, GroupScore, LookScore, score_gaze, score_groups, true_shares
from graphtrack.interaction.tables import LookLabels
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import with_clipped

_LEAST = 20
"""Pairs in frames, of those who walk together and of those who do not, below which nothing is learned."""


def fit_walking(people: People, label: IntArray, used: BoolArray, start: GroupParameters) -> GroupParameters:
    """Learn distances and velocities of labelled pairs who walk together, and of others who walk near.

    ``label``: (n,) numbers that those of a group share within a frame, −1: alone; ``used``: (n,) rows to
    learn from; ``start`` is returned where there are too few pairs.
    """
    left, right = near_pairs(people)
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
    return with_clipped(start, {name: np.round(value, 4) for name, value in learned.items()})


_PRIOR = {
    "stride": 0.1,
    "space_std": 0.2,
    "reach": 0.15,
    "body_spread": 0.3,
    "head_spread": 0.3,
    "persistence_seconds": 0.4,
}
"""1-σ of the logarithms of parameters of conversations about those of the literature."""
_TRIALS = 100  # evaluations
_FRAMES = 20  # frames that are learned from, at most
_ABOUT = 10.0  # seconds to either side of these that count as their past and future

_HIDDEN: tuple[Callable[[Track], Track], ...] = (
    lambda track: track,
    lambda track: replace(track, body=None),
    lambda track: replace(track, head=None),
    lambda track: replace(track, head=None, body=None),
)
"""What is learned from: one model serves whatever is known of people."""


Values = TypeVar("Values", GroupParameters, AttentionParameters)
Score = TypeVar("Score", GroupScore, LookScore)


@dataclass(frozen=True)
class LabelledFit(Generic[Values, Score]):
    """Learned parameters, and their scores on training and held-out data."""

    parameters: Values
    start: Values
    learned_from: Score
    held_out: Score | None


GroupFit: TypeAlias = LabelledFit[GroupParameters, GroupScore]
AttentionFit: TypeAlias = LabelledFit[AttentionParameters, LookScore]


def _searched(
    cost: Callable[[FloatArray], float], start: FloatArray, steps: FloatArray, **stop: float
) -> FloatArray:
    """Return the minimum (n,) by the simplex of Nelder and Mead (1965), which begins with ``steps`` (n,)."""
    from scipy.optimize import minimize

    simplex = start + np.vstack([np.zeros(len(start)), np.diag(steps)])
    found = minimize(cost, start, method="Nelder-Mead", options={"initial_simplex": simplex, **stop})
    return np.asarray(found.x)


def fit_groups(tracks: TrackSet, labels: GroupLabels, *, hold_out: float = 0.25) -> GroupFit:
    """Learn the parameters of conversations and of walking together from labelled groups.

    Those of conversations are the mode of the posterior: a prior about the literature's values (`_PRIOR`) and
    for each person the probability of the own group among those of all others (pseudo-likelihood; Besag
    1975). A recording counts for as many independent frames as it is longer than a conversation
    (`independent_frames`), and each group once. The parameters have to explain the groups with heads and
    bodies hidden, too. How people walk together is learned where enough do. Raise InputError if nobody is
    labelled, or all are together, or nobody is with anybody.

    ``hold_out``: share of the recording's end held out for validation
    """
    people = people_of(tracks)
    label = labels.labels(*_rows(people))
    t = people.t[people.frame_of]
    labelled = label != UNLABELLED
    low, high = float(t[labelled].min()), float(t[labelled].max())
    split = high - hold_out * (high - low) if hold_out > 0.0 else np.inf
    used = np.asarray(labelled & (t <= split))
    parameters = fit_walking(people, label, used, DEFAULT)
    independent = independent_frames(people, label, used)
    times = np.unique(t[used])
    chosen = times[np.linspace(0, len(times) - 1, min(len(times), _FRAMES)).round().astype(int)].tolist()
    if _stand(people, label, labelled & np.isin(t, chosen), parameters):
        near = np.abs(people.t[:, None] - np.array(chosen)).min(axis=1) <= _ABOUT + TIME_TOLERANCE
        everybody = with_absent(people)
        label_near = np.full(len(everybody), UNLABELLED)
        label_near[everybody.age == 0.0] = label
        label_near = label_near[near[everybody.frame_of]]
        all_shown = (with_absent(people_of(hide(track) for track in tracks)) for hide in _HIDDEN)
        shown = [_frames(one, near) for one in all_shown]
        begin = np.log([getattr(parameters, name) for name in _PRIOR])
        spread = np.array(list(_PRIOR.values()))

        def cost(free: FloatArray) -> float:
            made = _with_conversations(parameters, free)
            logs = [_own_groups(one, label_near, chosen, made) for one in shown]
            mean = float(np.mean(logs)) / len(chosen)
            return 0.5 * float(np.sum(((free - begin) / spread) ** 2)) - independent * mean

        best = _searched(cost, begin, spread, maxfev=_TRIALS, xatol=0.01, fatol=0.01)
        parameters = _with_conversations(parameters, best)
    elif parameters == DEFAULT:
        raise InputError(
            "no pairs near each other, or all of one group, or none",
            "labelled groups, and people near each other of different ones",
        )
    before, after = (label.copy() for _ in range(2))
    before[t > split], after[t <= split] = UNLABELLED, UNLABELLED
    held = _scored(people, parameters, after) if (after != UNLABELLED).any() else None
    return LabelledFit(parameters, DEFAULT, _scored(people, parameters, before), held)


def independent_frames(people: People, label: IntArray, used: BoolArray) -> float:
    """Return the number of frames with independent groups: 1 + the duration over the time of a conversation.

    That is the time that pairs spend in one group for each time that a pair leaves its group.

    Parameters
    ----------
    label : (n,) numbers that those of a group share within a frame, −1: alone
    used : (n,) rows with labels
    """
    left, right = near_pairs(people)
    keep = used[left] & used[right]
    left, right = left[keep], right[keep]
    t, pair = people.t[people.frame_of[left]], people.person[left] * len(people.ids) + people.person[right]
    order = np.lexsort((t, pair))
    together = ((label[left] == label[right]) & (label[left] >= 0))[order]
    same = (np.diff(pair[order]) == 0) & together[:-1]
    seconds = float(np.sum(np.diff(t[order])[same]))
    ended = np.count_nonzero(same & ~together[1:])
    times = people.t[people.frame_of[used]]
    return 1.0 + (float(times.max() - times.min()) * ended / seconds if seconds > 0.0 else 0.0)


def _stand(people: People, label: IntArray, used: BoolArray, parameters: GroupParameters) -> bool:
    """Return whether there are pairs who stand in one group, and pairs who stand and are in none together."""
    left, right = near_pairs(people)
    walk = walks(people, parameters)
    use = used[left] & used[right] & (np.maximum(walk[left], walk[right]) < 0.5)
    together = (label[left] == label[right]) & (label[left] >= 0)
    return bool(together[use].any() and not together[use].all())


def _with_conversations(parameters: GroupParameters, free: FloatArray) -> GroupParameters:
    """With the logarithms of the parameters of `_PRIOR`, within their ranges."""
    values = dict(zip(_PRIOR, np.exp(free).round(3).tolist(), strict=True))
    return with_clipped(parameters, values)


def _frames(people: People, chosen: BoolArray) -> People:
    """The people of some of the frames."""
    rows = chosen[people.frame_of]
    first = np.concatenate([[0], np.cumsum(np.diff(people.first)[chosen])])
    return People(
        people.ids,
        people.frame[chosen],
        people.t[chosen],
        first,
        people.person[rows],
        *(
            values[rows]
            for values in (people.position, people.velocity, people.body, people.head, people.age)
        ),
    )


def _own_groups(people: People, label: IntArray, chosen: list[float], parameters: GroupParameters) -> float:
    """Log probability of the group of each person, given those of all others, in frames of the times."""
    evidence = pair_evidence(people, parameters)
    total = 0.0
    for k in np.flatnonzero(np.isin(people.t, chosen)).tolist():
        begin, count = people.first[k], people.first[k + 1] - people.first[k]
        pairs = slice(evidence.start[k], evidence.start[k + 1])
        left, right = evidence.left[pairs] - begin, evidence.right[pairs] - begin
        odds = np.full((count, count), parameters.apart)
        odds[left, right] = odds[right, left] = evidence.odds[pairs]
        np.fill_diagonal(odds, 0.0)
        here = label[begin : begin + count]
        known = here != UNLABELLED
        total += _choices(odds[np.ix_(known, known)], here[known])
    return total


def _choices(odds: FloatArray, label: IntArray) -> float:
    """Log probability of each person's group given the others', summed over a frame, each group once."""
    own = np.where(label >= 0, label, label.max(initial=0) + 1 + np.arange(len(label)))
    names, place = np.unique(own, return_inverse=True)
    member = np.eye(len(names))[place]
    gain = odds @ member
    size, inside = member.sum(axis=0) - member, 0.5 * np.sum(member * gain, axis=0) - member * gain
    before = 2.0 * inside / np.maximum(size, 1.0)
    worth = 2.0 * (inside + gain) / (size + 1.0) - before  # to join each group, 0 for one without others
    logs = worth[np.arange(len(label)), place]
    alone = np.where(size[np.arange(len(label)), place] > 0.0, 0.0, -np.inf)
    members = member.sum(axis=0)[place]
    return float(np.sum((logs - np.logaddexp(np.logaddexp.reduce(worth, axis=1), alone)) / members))


def _rows(people: People) -> tuple[IntArray, FloatArray, IntArray]:
    frame_of = people.frame_of
    return people.frame[frame_of], people.t[frame_of], people.ids[people.person]


def _scored(people: People, parameters: GroupParameters, label: IntArray) -> GroupScore:
    found = groups_of_present(people, parameters)
    return score_groups(found.frame, found.track_id, found.group, label)


_STEP = 0.5  # of the first simplex, in logarithms of parameters
_WIDE = 2.0  # 1-σ of the logarithm of a parameter about its start: a prior worth one labelled gaze
_MOST = 300  # evaluations


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
    start = AttentionParameters() if start is None else start
    _check(tracks, labels)
    found = groups(tracks)
    observers = observers_of(tracks, groups=found)
    first = gaze_of(observers, start)
    labelled = np.concatenate([one.t[rows] for one, rows, _ in true_shares(first, labels)])
    if not len(labelled):
        raise InputError("no frame with labelled looks", "people and frames of the tracks", path=labels.path)
    low, high = float(labelled.min()), float(labelled.max())
    split = high - hold_out * (high - low) if hold_out > 0.0 else np.inf
    begin, labelled_count = _free(start), _count_looked(first, labels, split)

    def cost(free: FloatArray) -> float:
        estimated = gaze_of(observers, _parameters(free))
        belief = 0.5 * float(np.sum(((free - begin) / _WIDE) ** 2)) / max(labelled_count, 1)
        logs = [
            np.log(np.maximum(one.probability[rows][true], LEAST))[one.t[rows] <= split]
            for one, rows, true in true_shares(estimated, labels)
        ]
        return belief - float(np.concatenate(logs).mean())

    steps = np.full(len(begin), _STEP)
    best = _parameters(_searched(cost, begin, steps, maxfev=_MOST, xatol=0.02, fatol=1e-4))
    parameters = AttentionParameters(*(float(f"{value:.3g}") for value in astuple(best)))
    estimated = gaze_of(observers, parameters)
    after = (labelled > split).any()
    held = score_gaze(estimated, labels, (split, np.inf)) if after else None
    return LabelledFit(parameters, start, score_gaze(estimated, labels, (-np.inf, split)), held)


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
    return with_clipped(AttentionParameters(), values)
