"""The data of the replay and the chart of angles: thinned, quantised and delta-coded, to be small."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from graphtrack.display import person_colour
from graphtrack.geometry.angles import FloatArray
from graphtrack.report.behaviour.codes import behaviour_codes
from graphtrack.report.coding import ANGLE_STEP, COARSE_STEP, LENGTH_STEP, SURE_STEP, TIME_STEP, delta_code
from graphtrack.report.lives import UNSURE, Life, event_times, least_between
from graphtrack.report.pairing import Pair
from graphtrack.report.shapes import longest_step, probability_ellipse
from graphtrack.report.style import person_dash

if TYPE_CHECKING:
    from graphtrack.evaluation.tracking.events import IdentityEvent
    from graphtrack.report.behaviour.given import Behaviour

MAX_SAMPLES: Final = 200_000
"""Person-frames in a page. Packed, noisy ones with every channel take up to 33 bytes each: 7 MB of a page."""

MAX_DOING: Final = MAX_SAMPLES // 2
"""The same where groups, looks or forecasts are shown: they take 10 bytes each, and pictures of their own."""


def replay_data(
    pairs: Sequence[Pair],
    *,
    max_rate: float = 30.0,
    max_samples: int | None = None,
    lives: Sequence[Life] | None = None,
    events: Sequence[IdentityEvent] = (),
    behaviour: Behaviour | None = None,
) -> dict[str, Any]:
    """Everything the replay and the charts of angles show, ready for `json.dumps`.

    Each channel of a person is a list of integers: the first is the value in units of `TIME_STEP`,
    `LENGTH_STEP`, `ANGLE_STEP`, `SURE_STEP` or `COARSE_STEP`, the following ones are differences to the last
    known value, and None is a missing value. Differences of rounded values do not accumulate error. A
    channel that is known nowhere is None.

    Parameters
    ----------
    pairs : the people to show; those without a finite position are left out
    max_rate : frames a second that are kept
    max_samples : samples that are kept of all people together; of every n frames one is kept to stay below.
        By default `MAX_SAMPLES`, or `MAX_DOING` with a ``behaviour``
    lives : of each of the people, if births, deaths, gaps and joins are to be shown
    events : switches and fragmentations, where the truth is known
    behaviour : groups, looks and forecasts of the people

    Returns
    -------
    dict
        ``frame`` (seconds from one frame to the next, as shown; None where nobody has two), ``every`` (one
        of how many frames is shown), ``kept`` and ``of`` (person-frames shown, and there), ``steps`` (the
        four units), ``people``, ``events`` (each time, true person, track before, track after, whether a
        switch, whether found again), ``lives``, whether births, deaths and gaps are shown, ``unsure``,
        the probability below which a link is, and ``behaviour`` (see `behaviour_codes`).
    """
    placed = [(i, pair) for i, pair in enumerate(pairs) if np.isfinite(pair.estimate.position).any()]
    times = [pair.estimate.t for _, pair in placed]
    frame = frame_interval(times)
    if max_samples is None:
        max_samples = MAX_SAMPLES if behaviour is None else MAX_DOING
    every, kept = _thinned(times, frame, max_rate, max_samples)
    people = [
        _person(i, pair, at) | ({} if lives is None else _life(pair, lives[i], at))
        for (i, pair), at in zip(placed, kept, strict=True)
    ]
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
        "lives": lives is not None,
        "unsure": UNSURE,
        "events": [
            [round(t, 3), str(e.person), str(e.before), str(e.after), int(e.switch), int(e.found_again)]
            for e, t in zip(events, event_times(pairs, events), strict=True)
        ],
    }


def _life(pair: Pair, life: Life, at: NDArray[np.intp]) -> dict[str, Any]:
    """Probabilities of links to the samples that are kept; gaps: from, to, filled, joined, probability."""
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
    """Seconds from frame to frame of the track that has most a second; None where none has two frames.

    Parameters
    ----------
    times : of each track, (n,) seconds
    """
    return min((float(np.median(np.diff(t))) for t in times if len(t) > 1), default=None)


def thin(t: FloatArray, rate: float) -> NDArray[np.intp]:
    """Indices of at most ``rate`` samples a second, the first and the last always among them.

    The first sample of each interval 1/rate of absolute time is kept, so that people stay in step.
    """
    interval = np.floor(t * rate + 1e-6)
    first = np.unique(interval, return_index=True)[1]
    return np.union1d(first, len(t) - 1)


def _thinned(
    times: Sequence[FloatArray], frame: float | None, max_rate: float, max_samples: int
) -> tuple[int, list[NDArray[np.intp]]]:
    """One of how many frames stays within both limits, and the indices of what is kept of each track."""
    every = 1 if frame is None else max(1, int(np.ceil(1.0 / (frame * max_rate) - 1e-6)))
    longest = max((float(np.ptp(t)) for t in times), default=0.0)
    while True:
        # Whole frames, so that steps stay even; where none is left out, times need not be even at all.
        if frame is None or every == 1:
            kept = [np.arange(len(t)) for t in times]
        else:
            kept = [thin(t, 1.0 / (every * frame)) for t in times]
        total = sum(map(len, kept))
        if total <= max_samples or frame is None or every * frame > longest:
            return every, kept
        every = max(every + 1, int(every * total / max_samples))


def _person(index: int, pair: Pair, at: NDArray[np.intp]) -> dict[str, Any]:
    estimate = pair.estimate
    body_std, head_std = estimate.std("body"), estimate.std("head")
    absent, absent_pair = np.full(len(at), np.nan), np.full((len(at), 2), np.nan)
    velocity = absent_pair if estimate.velocity is None else estimate.velocity[at]
    ellipse = probability_ellipse(
        np.full((len(at), 2, 2), np.nan) if estimate.covariance is None else estimate.covariance[at, :2, :2]
    )
    lengths = {
        "x": estimate.position[at, 0],
        "y": estimate.position[at, 1],
        "vx": velocity[:, 0],
        "vy": velocity[:, 1],
        "major": ellipse.semi_major,
        "minor": ellipse.semi_minor,
        "seen_x": pair.seen_position[at, 0],
        "seen_y": pair.seen_position[at, 1],
        "true_x": pair.true_position[at, 0],
        "true_y": pair.true_position[at, 1],
    }
    angles = {
        "tilt": ellipse.angle,
        "body": absent if estimate.body is None else estimate.body[at],
        "head": absent if estimate.head is None else estimate.head[at],
        "body_std": absent if body_std is None else body_std[at],
        "head_std": absent if head_std is None else head_std[at],
        "seen_body": pair.seen_body[at],
        "seen_head": pair.seen_head[at],
        "true_body": pair.true_body[at],
        "true_head": pair.true_head[at],
    }
    t = estimate.t[at]
    return {
        # As text: a number in JavaScript has 53 bits.
        "id": str(estimate.track_id),
        "label": pair.label,
        "colour": person_colour(index),
        "dash": person_dash(index),
        # Between samples further apart than this the person is not shown: the track has a hole there.
        "hole": round(longest_step(t), 3),
        "seen": None if pair.seen is None else "".join("1" if flag else "0" for flag in pair.seen[at]),
        "t": delta_code(t, TIME_STEP),
        **{name: delta_code(values, LENGTH_STEP) for name, values in lengths.items()},
        **{name: delta_code(values, ANGLE_STEP) for name, values in angles.items()},
    }
