"""Short texts and tables of objects, in which labels are text."""

import html
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.evaluation import Comparison
from graphtrack.model import LikelihoodParameters, MotionParameters
from graphtrack.tracks.track import Track, TrackSet

NASTY = "<script>alert('&')</script>" * 10
CHANGED = gt.Parameters(MotionParameters(0.2, 0.3, 0.4), likelihood=LikelihoodParameters(robust="huber"))
SAID_OF_CHANGED = (
    "Model('separate', motion.acceleration_density=0.2, motion.initial_speed_std=0.3, motion.head_rate=0.4, "
    "likelihood.robust='huber')"
)


class Nasty(gt.Term):
    """<script>alert()</script>"""

    factors = cost = None  # type: ignore[assignment]


@cache
def people() -> TrackSet:
    return gt.simulate("joint", n_tracks=3, n_steps=200, rng=np.random.default_rng(0))


@cache
def solution() -> gt.Solution:
    (found,) = gt.solve(TrackSet((people().by_id(0)[:20],)), "joint", constants="default")
    assert isinstance(found, gt.Solution)
    return found


@cache
def comparison() -> Comparison:
    return gt.compare(people(), ["kf", "rts"], model="joint")


@cache
def score() -> gt.TrackingScore:
    return gt.score([person[:20] for person in people()], people()[:3].map(lambda person: person[:20]))


def nasty_score() -> gt.TrackingScore:
    (line,) = score().sequences
    return replace(score(), sequences=(replace(line, name=NASTY),) * 500)


def online(count: int) -> gt.OnlineSmoother:
    made = gt.OnlineSmoother("joint", lag=1.0, constants="default")
    for k in range(count):
        made.update(gt.Observation(0.5 * k, frame=k, position=(k, 2.0), head=0.5))
    return made


def estimate(**seen: object) -> gt.Estimate:
    return online(2).update(gt.Observation(1.0, frame=2, **seen))  # type: ignore[arg-type]


def labelled() -> TrackSet:
    return TrackSet(tuple(replace(people().by_id(0)[:5], track_id=i, label=NASTY) for i in range(500)))


SHORT: dict[str, tuple[Callable[[], object], str]] = {
    "tracks": (people, "TrackSet(3 tracks, 600 person-frames, 0.0–19.9 s, body, head; truth)"),
    "no tracks": (lambda: people().with_tracks([]), "TrackSet(0 tracks)"),
    "track": (
        lambda: people().by_id(0),
        "Track(0, 'simulated 0', 200 frames, 0.0–19.9 s, body, head; truth)",
    ),
    "positions": (
        lambda: Track(7, np.arange(1), np.ones(1), np.ones((1, 2))),
        "Track(7, 1 frame, 1.0–1.0 s)",
    ),
    "estimates": (
        lambda: replace(solution().track, label="", true_position=None),
        "Track(0, 20 frames, 0.0–1.9 s, body, head; estimates)",
    ),
    "model": (lambda: gt.Model("joint"), "Model('joint')"),
    "model with a term": (lambda: gt.Model("separate", terms=[Nasty]), "Model('separate', Nasty)"),
    "model with parameters": (lambda: gt.Model("separate", CHANGED), SAID_OF_CHANGED),
    "nobody yet": (
        lambda: online(0),
        "OnlineSmoother(model Model('joint'), engine chain, lag 1 s, window empty)",
    ),
    "online": (
        lambda: online(4),
        "OnlineSmoother(model Model('joint'), engine chain, lag 1 s, window 0.5–1.5 s)",
    ),
    "waiting": (
        lambda: online(0).update(gt.Observation(0.0, head=1.0)),
        "Estimate(t=0 s, frame 0, 'waiting')",
    ),
    "score": (score, "TrackingScore(HOTA 0.948, IDF1 1.000, MOTA 1.000; 1 sequence, within 1 m)"),
    "comparison": (comparison, "Comparison(kf, rts; 3 tracks, 0 failed, 0 left out)"),
}


@pytest.mark.parametrize(("make", "said"), SHORT.values(), ids=SHORT)
def test_a_line_says_what_it_is(make: Callable[[], object], said: str) -> None:
    assert repr(make()) == said


THINGS: dict[str, Callable[[], object]] = {
    **{name: make for name, (make, _) in SHORT.items()},
    "solution": solution,
    "estimate": lambda: estimate(position=(2.0, 2.0)),
    "failed": lambda: replace(estimate(), reason=NASTY[:200]),
    "nasty tracks": labelled,
    "a nasty track": lambda: labelled().by_id(3),
    "a nasty score": nasty_score,
    "a nasty solution": lambda: replace(solution(), track=labelled().by_id(3)),
}


@pytest.mark.parametrize("make", THINGS.values(), ids=THINGS)
def test_it_is_short_and_a_table_of_text(make: Callable[[], object]) -> None:
    thing = make()
    assert len(repr(thing)) < 450 and "\n" not in repr(thing)
    page = thing._repr_html_()  # type: ignore[attr-defined]
    assert len(page) < 5000
    assert {"table"} <= set(re.findall(r"<(\w+)", page)) <= {"table", "caption", "tr", "th", "td"}


def test_results_say_how_they_came_out_and_labels_are_text() -> None:
    assert repr(solution()).startswith("Solution(track 0, 20 frames, cost ")
    assert repr(solution()).endswith(" steps, converged, chain)")
    assert repr(estimate(position=(2.0, 2.0))).startswith("Estimate(t=1 s, frame 2, 'new', position (")
    assert comparison()._repr_html_().count("<tr>") == 3
    text = html.unescape(re.sub("<[^>]*>", "", labelled()._repr_html_()))
    assert "and 490 more" in text and "<script>alert(" in text
