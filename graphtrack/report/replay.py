"""Data of the replay and the charts: thinned, quantised and delta-coded, to be small.

Groups, gaze and forecasts are sampled at the kept samples of people.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.planar import heading_half_width, speed_interval
from graphtrack.report.lives import UNSURE, Life, Pair, event_times, least_between
from graphtrack.report.style import (
    NORMAL_95,
    group_colour,
    known_angle,
    longest_step,
    person_dash,
    probability_ellipse,
)
from graphtrack.tracks.display import person_colour
from graphtrack.tracks.track import Track

if TYPE_CHECKING:
    from graphtrack.evaluation.identity_events import IdentityEvent
    from graphtrack.interaction.attention import Attention
    from graphtrack.interaction.groups import Groups
    from graphtrack.interaction.people import Place
    from graphtrack.report.background import GroundImage
    from graphtrack.report.interaction import Behaviour
    from graphtrack.report.sensors import ShownSensor


TIME_STEP: Final = 1e-3
"""Seconds per unit of a coded time."""

LENGTH_STEP: Final = 1e-3
"""Metres (or m/s) per unit of a coded length (or velocity)."""

ANGLE_STEP: Final = float(np.radians(0.1))
"""Radians per unit of a coded angle."""

SURE_STEP: Final = 1e-2
"""Probability per unit of a coded probability."""

COARSE_STEP: Final = 1e-2
"""Metres per unit of a coarsely coded length: of forecasts, and of groups."""

KNOWN_HEADING: Final = float(np.pi / 2)
"""Half of the 95 % arc (radians) from which a heading is not known: nobody who stands has one."""

Codes = list[int | None]


def delta_code(values: FloatArray, step: float) -> Codes | None:
    """Return integers in units of ``step``: the first value, then differences; None if not finite."""
    known = np.isfinite(values)
    if not known.any():
        return None
    codes = np.full(len(values), None, dtype=object)
    codes[known] = np.diff(np.round(values[known] / step).astype(np.int64), prepend=0)
    found: Codes = codes.tolist()
    return found


SHOWN_TARGETS: Final = 2
"""Number of most probable gaze targets shown for a person."""

LEAST_LOOK: Final = 0.15
"""Probability below which gaze is not drawn, as it would be barely visible."""

MAX_FANS: Final = 8_000
"""Most forecasts in a page; above it, every second, third … time is kept."""

FAN_STEPS: Final = 6
"""Number of times ahead shown in a fan, including the last."""

Index = NDArray[np.intp]


def behaviour_codes(
    behaviour: Behaviour, tracks: Sequence[Track], kept: Sequence[Index]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return codes of the scene and of each person, for `graphtrack.report.replay.replay_data`.

    Parameters
    ----------
    behaviour : groups, gaze and forecasts of these tracks
    tracks : tracks of the replay
    kept : kept samples of each track

    Returns
    -------
    scene : ``groups`` (number, colour, and over time centre and kind, 1 a conversation, 2 walking together),
        ``places``, and ``fans`` (seconds ahead, and display duration)
    people : ``group`` and ``group_p`` at the samples kept; ``look_0``, ``look_p_0``, … the index of a target
        (a person, then places) and its probability; ``fan_t`` and series of all fans one after another
    """
    scene: dict[str, Any] = {"groups": [], "places": [_place(place) for place in behaviour.places]}
    people: list[dict[str, Any]] = [{} for _ in tracks]
    parts = []
    if behaviour.groups is not None:
        scene["groups"], of_people = _groups(behaviour.groups, tracks, kept)
        parts.append(of_people)
    if behaviour.attention is not None:
        parts.append(_gaze(behaviour, behaviour.attention, tracks, kept))
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


def _gaze(
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
        # Gaze at people outside the replay and at places without a position is not shown.
        target = [(index if kind == "person" else place).get(name, -1) for kind, name in one.targets[:-1]]
        _, here, there = np.intersect1d(track.frame[at], one.frame, return_indices=True)
        people.append(_likeliest(np.array(target, dtype=np.intp), one.probability[there], here, len(at)))
    return people


def _likeliest(target: Index, probability: FloatArray, here: Index, count: int) -> dict[str, Any]:
    """Return codes of the most probable targets over ``count`` samples, known at those ``here``."""
    share = np.where(target >= 0, np.nan_to_num(probability[:, :-1]), 0.0)
    order = np.argsort(-share, axis=1, kind="stable")
    found = {}
    for k in range(SHOWN_TARGETS):
        at, sure = np.full(count, np.nan), np.full(count, np.nan)
        if k < share.shape[1]:
            best = order[:, k]
            p = share[np.arange(len(best)), best]
            was_observed = p >= LEAST_LOOK
            at[here[was_observed]], sure[here[was_observed]] = target[best[was_observed]], p[was_observed]
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
    # Forecasts of one time are all kept, or none.
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


MAX_SAMPLES: Final = 200_000
"""Most person-frames in a page. Noisy data with every channel take up to 33 bytes each: 7 MB of a page."""

MAX_DOING: Final = MAX_SAMPLES // 2
"""Most person-frames with groups, gaze or forecasts, which add 10 bytes each, and pictures."""


def replay_data(
    pairs: Sequence[Pair],
    *,
    max_rate: float = 30.0,
    max_samples: int | None = None,
    lives: Sequence[Life] | None = None,
    events: Sequence[IdentityEvent] = (),
    behaviour: Behaviour | None = None,
    sensors: Sequence[ShownSensor] = (),
    background: GroundImage | None = None,
) -> dict[str, Any]:
    """Return the data of the replay and the angle charts, ready for `json.dumps`.

    Each channel of a person is a list of integers: the first is the value in units of `TIME_STEP`,
    `LENGTH_STEP`, `ANGLE_STEP`, `SURE_STEP` or `COARSE_STEP`, the following ones are differences to the last
    known value, and None is a missing value. Differences of rounded values do not accumulate error. A
    channel without values is None.

    Parameters
    ----------
    pairs : the people to show; those without a finite position are left out
    max_rate : most frames a second to keep
    max_samples : most samples of all people together; one of every n frames is kept to stay below.
        By default `MAX_SAMPLES`, or `MAX_DOING` with a ``behaviour``
    lives : life of each person, to show births, deaths, gaps and joins
    events : switches and fragmentations, if the truth is known
    behaviour : groups, gaze and forecasts of the people
    sensors : from `graphtrack.report.sensors.shown_sensors`
    background : an image under the paths

    Returns
    -------
    dict
        ``frame`` (seconds from one shown frame to the next; None if no person has two), ``every`` (one
        of how many frames is shown), ``kept`` and ``of`` (person-frames shown, and there), ``steps`` (the
        four units), ``people``, ``events`` (each time, true person, track before, track after, whether a
        switch, whether found again), ``lives``, whether births, deaths and gaps are shown, ``unsure``,
        the probability below which a link is, ``behaviour`` (see `behaviour_codes`), ``sensors``
        (title, colour, outline of the field of view, whether it was learned), and ``background`` (its
        address, and left, right, bottom and top in metres), or None.
    """
    placed = [(i, pair) for i, pair in enumerate(pairs) if np.isfinite(pair.estimate.position).any()]
    times = [pair.estimate.t for _, pair in placed]
    frame = frame_interval(times)
    if max_samples is None:
        max_samples = MAX_SAMPLES if behaviour is None else MAX_DOING
    every, kept = _thinned(times, frame, max_rate, max_samples)
    people = [
        _person(i, pair, at, [one.name for one in sensors])
        | ({} if lives is None else _life(pair, lives[i], at))
        for (i, pair), at in zip(placed, kept, strict=True)
    ]
    names = {pair.estimate.track_id: pair.name for pair in pairs}
    shown = None
    if behaviour is not None:
        shown, more = behaviour_codes(behaviour, [pair.estimate for _, pair in placed], kept)
        people = [one | other for one, other in zip(people, more, strict=True)]
    return {
        "frame": None if frame is None else round(frame * every, 4),
        "every": every,
        "kept": sum(map(len, kept)),
        "of": sum(map(len, times)),
        "steps": {
            "time": TIME_STEP,
            "length": LENGTH_STEP,
            "angle": ANGLE_STEP,
            "sure": SURE_STEP,
            "coarse": COARSE_STEP,
        },
        "people": people,
        "behaviour": shown,
        "background": None
        if background is None
        else {"image": background.encoded(), "extent": [round(end, 3) for end in background.extent]},
        "sensors": [
            {
                "title": one.title,
                "colour": one.colour,
                "outline": None if one.outline is None else np.round(one.outline, 3).tolist(),
                "learned": one.learned,
            }
            for one in sensors
        ],
        "lives": lives is not None,
        "unsure": UNSURE,
        "events": [
            [round(t, 3), str(e.person), before, after, int(e.switch), int(e.found_again)]
            for e, t in zip(events, event_times(pairs, events), strict=True)
            for before, after in [[names.get(k, str(k)) for k in (e.before, e.after)]]
        ],
    }


def _life(pair: Pair, life: Life, at: NDArray[np.intp]) -> dict[str, Any]:
    """Return link probabilities at the kept samples; gaps: from, to, filled, joined, probability."""
    sure = pair.estimate.identity_p
    return {
        "sure": None if sure is None else delta_code(least_between(sure, at), SURE_STEP),
        "gaps": [
            [
                round(gap.start, 3),
                round(gap.end, 3),
                int(gap.filled),
                int(gap.joined),
                round(gap.probability, 3) if np.isfinite(gap.probability) else None,
            ]
            for gap in life.gaps
        ],
    }


def frame_interval(times: Sequence[FloatArray]) -> float | None:
    """Return the frame interval in seconds of the track with the highest rate; None without two frames.

    Parameters
    ----------
    times : (n,) seconds of each track
    """
    each = map(np.unique, times)  # rows of several sensors may have one time
    return min((float(np.median(np.diff(t))) for t in each if len(t) > 1), default=None)


def thin(t: FloatArray, rate: float) -> NDArray[np.intp]:
    """Return indices of at most ``rate`` samples a second, including the first and the last.

    The first sample of each interval 1/rate of absolute time is kept, so that people stay synchronised.
    """
    interval = np.floor(t * rate + 1e-6)
    first = np.unique(interval, return_index=True)[1]
    return np.union1d(first, len(t) - 1)


def _thinned(
    times: Sequence[FloatArray], frame: float | None, max_rate: float, max_samples: int
) -> tuple[int, list[NDArray[np.intp]]]:
    """Return the decimation that satisfies both limits, and the kept indices of each track."""
    every = 1 if frame is None else max(1, int(np.ceil(1.0 / (frame * max_rate) - 1e-6)))
    longest = max((float(np.ptp(t)) for t in times), default=0.0)
    while True:
        # Decimate whole frames, so that steps stay uniform; without decimation, times may be irregular.
        if frame is None or every == 1:
            kept = [np.arange(len(t)) for t in times]
        else:
            kept = [thin(t, 1.0 / (every * frame)) for t in times]
        total = sum(map(len, kept))
        if total <= max_samples or frame is None or every * frame > longest:
            return every, kept
        every = max(every + 1, int(every * total / max_samples))


def _motion(estimate: Track, at: NDArray[np.intp]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the 95 % interval of speed, and heading with 1/1.96 of half its 95 % arc, where it is known."""
    absent = np.full(len(at), np.nan)
    if estimate.velocity is None:
        return absent, absent, absent, absent
    velocity, heading = estimate.velocity[at], estimate.heading[at]
    if estimate.covariance is None:
        return absent, absent, heading, absent
    covariance = estimate.covariance[at, 2:4, 2:4]
    half = heading_half_width(velocity, covariance)
    unknown = half >= KNOWN_HEADING
    heading[unknown] = half[unknown] = np.nan
    return *speed_interval(velocity, covariance), heading, half / NORMAL_95


def _person(index: int, pair: Pair, at: NDArray[np.intp], sensors: Sequence[str]) -> dict[str, Any]:
    estimate = pair.estimate
    observed = probability_ellipse(pair.observed_covariance[at])
    place_of = {name: float(place) for place, name in enumerate(sensors)}
    sensor = np.array([place_of.get(name, np.nan) for name in pair.sensor[at].tolist()])
    body_std, head_std = estimate.std("body"), estimate.std("head")
    absent_pair = np.full((len(at), 2), np.nan)
    velocity = absent_pair if estimate.velocity is None else estimate.velocity[at]
    ellipse = probability_ellipse(
        np.full((len(at), 2, 2), np.nan) if estimate.covariance is None else estimate.covariance[at, :2, :2]
    )
    low, high, heading, heading_std = _motion(estimate, at)
    lengths = {
        "x": estimate.position[at, 0],
        "y": estimate.position[at, 1],
        "vx": velocity[:, 0],
        "vy": velocity[:, 1],
        "speed_low": low,
        "speed_high": high,
        "major": ellipse.semi_major,
        "minor": ellipse.semi_minor,
        "seen_x": pair.observed_position[at, 0],
        "seen_y": pair.observed_position[at, 1],
        "seen_major": observed.semi_major,
        "seen_minor": observed.semi_minor,
        "true_x": pair.true_position[at, 0],
        "true_y": pair.true_position[at, 1],
    }
    angles = {
        "tilt": ellipse.angle,
        "heading": heading,
        "heading_std": heading_std,
        "body": known_angle(estimate, "body")[at],
        "head": known_angle(estimate, "head")[at],
        "body_std": body_std[at],
        "head_std": head_std[at],
        "seen_tilt": observed.angle,
        "seen_body": pair.observed_body[at],
        "seen_head": pair.observed_head[at],
        "true_body": pair.true_body[at],
        "true_head": pair.true_head[at],
    }
    t = estimate.t[at]
    return {
        "number": str(estimate.track_id),  # a number in JavaScript has 53 bits
        "id": pair.name,
        "label": pair.label,
        "colour": person_colour(index),
        "dash": person_dash(index),
        # Between samples further apart than this the person is not shown: the track has a hole there.
        "hole": round(longest_step(t), 3),
        "seen": None
        if pair.was_observed is None
        else "".join("1" if flag else "0" for flag in pair.was_observed[at]),
        "t": delta_code(t, TIME_STEP),
        "sensor": delta_code(sensor, 1.0),
        **{name: delta_code(values, LENGTH_STEP) for name, values in lengths.items()},
        **{name: delta_code(values, ANGLE_STEP) for name, values in angles.items()},
    }
