"""Groups, looks and forecasts as the replay holds them, in step with the samples of people that it keeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.report.coding import COARSE_STEP, SURE_STEP, TIME_STEP, delta_code
from graphtrack.report.shapes import longest_step
from graphtrack.report.style import group_colour
from graphtrack.tracks import Track

if TYPE_CHECKING:
    from graphtrack.behaviour.attention import Attention
    from graphtrack.behaviour.groups import Groups
    from graphtrack.behaviour.places import Place
    from graphtrack.report.behaviour.given import Behaviour

SHOWN_LOOKS: Final = 2
"""Targets of a person that are shown at a time: the likeliest."""

LEAST_LOOK: Final = 0.15
"""Probability below which a look is not drawn: it would hardly be seen."""

MAX_FANS: Final = 8_000
"""Forecasts in a page; of more, those made at every second, third … time are kept."""

FAN_STEPS: Final = 6
"""Times ahead that a fan shows, the last among them."""

Index = NDArray[np.intp]


def behaviour_codes(
    behaviour: Behaviour, tracks: Sequence[Track], kept: Sequence[Index]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Codes of the scene and of each person, for `graphtrack.report.replay.replay_data`.

    Parameters
    ----------
    behaviour : of people of these tracks
    tracks : whom the replay shows
    kept : which samples of each track it keeps

    Returns
    -------
    scene : ``groups`` (number, colour, and over time centre and kind, 1 a conversation, 2 walking together),
        ``places``, and ``fans`` (seconds ahead, and for how long one is shown)
    people : ``group`` and ``group_p`` at the samples kept; ``look_0``, ``look_p_0``, … the index of a target
        (a person; beyond them a place) and how probable; ``fan_t`` and series of all fans one after another
    """
    scene: dict[str, Any] = {"groups": [], "places": [_place(place) for place in behaviour.places]}
    people: list[dict[str, Any]] = [{} for _ in tracks]
    parts = []
    if behaviour.groups is not None:
        scene["groups"], of_people = _groups(behaviour.groups, tracks, kept)
        parts.append(of_people)
    if behaviour.attention is not None:
        parts.append(_looks(behaviour, behaviour.attention, tracks, kept))
    if behaviour.forecasts is not None:
        scene["fans"], of_people = _fans(behaviour.forecasts, tracks)
        parts.append(of_people)
    for of_people in parts:
        for person, more in zip(people, of_people, strict=True):
            person |= more
    scene["has"] = {
        "groups": behaviour.groups is not None,
        "looks": behaviour.attention is not None,
        "fans": behaviour.forecasts is not None,
        "places": bool(behaviour.places),
    }
    return scene, people


def _place(place: Place) -> dict[str, Any]:
    outline = np.round(place.outline, 3).tolist()
    return {"name": place.name, "radius": round(float(place.radius), 3), "outline": outline}


def _groups(
    groups: Groups, tracks: Sequence[Track], kept: Sequence[Index]
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    people, chosen = [], []
    for track, at in zip(tracks, kept, strict=True):
        rows = np.flatnonzero(groups.track_id == track.track_id)
        _, here, there = np.intersect1d(track.frame[at], groups.frame[rows], return_indices=True)
        number, sure = np.full(len(at), np.nan), np.full(len(at), np.nan)
        number[here], sure[here] = groups.group[rows[there]], groups.probability[rows[there]]
        number[number < 0] = np.nan
        people.append({"group": delta_code(number, 1.0), "group_p": delta_code(sure, SURE_STEP)})
        chosen.append(rows[there])
    use = np.sort(np.concatenate(chosen)) if chosen else np.empty(0, dtype=np.intp)
    use = use[groups.group[use] >= 0]
    found = []
    for number in np.unique(groups.group[use]).tolist():
        rows = use[groups.group[use] == number]
        rows = rows[np.unique(groups.frame[rows], return_index=True)[1]]
        found.append(
            {
                "number": number,
                "colour": group_colour(number),
                "hole": round(longest_step(groups.t[rows]), 3),
                "t": delta_code(groups.t[rows], TIME_STEP),
                "kind": delta_code(groups.kind[rows].astype(float), 1.0),
                "x": delta_code(groups.centre[rows, 0], COARSE_STEP),
                "y": delta_code(groups.centre[rows, 1], COARSE_STEP),
            }
        )
    return found, people


def _looks(
    behaviour: Behaviour, attention: Sequence[Attention], tracks: Sequence[Track], kept: Sequence[Index]
) -> list[dict[str, Any]]:
    index = {str(track.track_id): k for k, track in enumerate(tracks)}
    place = {one.name: len(tracks) + k for k, one in enumerate(behaviour.places)}
    of = {one.track_id: one for one in attention}
    people: list[dict[str, Any]] = []
    for track, at in zip(tracks, kept, strict=True):
        one = of.get(track.track_id)
        if one is None:
            people.append({})
            continue
        # Who is not in the replay is looked at in vain, as is a place that nobody said the whereabouts of.
        target = [(index if kind == "person" else place).get(name, -1) for kind, name in one.targets[:-1]]
        _, here, there = np.intersect1d(track.frame[at], one.frame, return_indices=True)
        people.append(_likeliest(np.array(target, dtype=np.intp), one.probability[there], here, len(at)))
    return people


def _likeliest(target: Index, probability: FloatArray, here: Index, count: int) -> dict[str, Any]:
    """The codes of the likeliest targets over ``count`` samples; those ``here`` have probabilities."""
    share = np.where(target >= 0, np.nan_to_num(probability[:, :-1]), 0.0)
    order = np.argsort(-share, axis=1, kind="stable")
    found = {}
    for k in range(SHOWN_LOOKS):
        at, sure = np.full(count, np.nan), np.full(count, np.nan)
        if k < share.shape[1]:
            best = order[:, k]
            p = share[np.arange(len(best)), best]
            seen = p >= LEAST_LOOK
            at[here[seen]], sure[here[seen]] = target[best[seen]], p[seen]
        found[f"look_{k}"], found[f"look_p_{k}"] = delta_code(at, 1.0), delta_code(sure, SURE_STEP)
    return found


def _fans(
    columns: Mapping[str, NDArray[Any]], tracks: Sequence[Track]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    ahead = np.unique(np.round(columns["ahead"], 6))
    shown = ahead[np.unique(np.linspace(0, len(ahead), FAN_STEPS + 1)[1:].round().astype(int) - 1)]
    use = np.isin(np.round(columns["ahead"], 6), shown)
    person, frame = columns["track_id"][use].astype(np.int64), columns["frame"][use].astype(np.int64)
    step = np.searchsorted(shown, np.round(columns["ahead"][use], 6))
    t, values = columns["t"][use], np.stack([columns[name][use] for name in _FAN], axis=1)
    # Everybody's of a time are kept, or nobody's.
    of_time = np.unique(frame, return_inverse=True)[1]
    fans = len(np.unique(np.stack([person, frame]), axis=1).T)
    every = max(1, -(-fans // MAX_FANS))
    stays = of_time % every == 0
    person, frame, step, t, values = (one[stays] for one in (person, frame, step, t, values))
    gaps = np.diff(np.unique(np.round(t, 3)))
    found: list[dict[str, Any]] = []
    for track in tracks:
        rows = np.flatnonzero(person == track.track_id)
        frames, first, row = np.unique(frame[rows], return_index=True, return_inverse=True)
        grid = np.full((len(frames), len(shown), len(_FAN)), np.nan)
        grid[row, step[rows]] = values[rows]
        series = {name: delta_code(grid[..., k].ravel(), COARSE_STEP) for k, name in enumerate(_FAN.values())}
        found.append({"fan_t": delta_code(t[rows][first], TIME_STEP), **series})
    hold = 1.5 * float(np.median(gaps)) if len(gaps) else 1.0
    return {"ahead": shown.tolist(), "hold": round(hold, 3), "every": every, "of": fans}, found


_FAN = {"x": "fan_x", "y": "fan_y", "radius_50": "fan_50", "radius_90": "fan_90"}
"""Column of a table of forecasts → series of the replay."""
