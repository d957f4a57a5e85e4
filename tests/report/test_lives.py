"""Births, deaths, gaps, joins and switches: the page agrees with the tracks."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from made_up import walker
from page_scripts import decoded, delta_decode, in_node

import graphtrack as gt
from graphtrack.evaluation.identity_events import IdentityEvent
from graphtrack.report.content import MAX_ROWS, Chart, DataTable
from graphtrack.report.html import render_report
from graphtrack.report.lives import UNSURE, life_of, pair_track
from graphtrack.report.page import tracking_report
from graphtrack.report.replay import SURE_STEP, replay_data
from graphtrack.tracks.track import TrackSet

SCRIPTS = ("replay_data.js", "lives.js", "people.js")


def associated(track_id=1, n=60, seed=0, kept=0.6, first=0):
    """A person observed in some frames, first and last; every frame in between exists."""
    rng = np.random.default_rng([seed, track_id])
    seen = rng.random(n) < kept
    seen[[0, -1]] = True
    track = walker(track_id, n=n, hz=2.5, frame=np.arange(n) + first, t=(np.arange(n) + first) / 2.5)
    p = np.where(seen, rng.random(n), np.nan)
    p[0] = 1.0
    return replace(track, observed=seen.astype(float), identity_p=p)


def lives_of(*tracks):
    return [life_of(pair_track(track)) for track in tracks]


def section(report, title="Identities"):
    return next((part for part in report.sections if part.title == title), None)


def table(report, title):
    items = section(report).items
    return next((item for item in items if isinstance(item, DataTable) and item.title == title), None)


@pytest.mark.parametrize("seed", range(8))
def test_births_and_deaths_are_first_and_last_rows_and_gaps_are_runs_that_were_not_observed(seed):
    track = associated(seed=seed, first=7 * seed)
    (life,) = lives_of(track)
    assert (life.birth, life.death) == (track.t[0], track.t[-1])
    runs = [
        list(group) for flag, group in groupby(range(len(track)), lambda k: track.observed[k]) if not flag
    ]
    assert [(gap.start, gap.end) for gap in life.gaps] == [
        (track.t[run[0] - 1], track.t[run[-1] + 1]) for run in runs
    ]
    assert [gap.probability for gap in life.gaps] == [track.identity_p[run[-1] + 1] for run in runs]
    assert all(gap.filled and gap.joined for gap in life.gaps)
    links = track.identity_p[1:][np.isfinite(track.identity_p[1:])]
    assert life.least == links.min()
    assert life.unsure == (links < UNSURE).sum()


def test_who_is_not_seen_again_was_not_joined():
    track = associated(n=20, kept=1.0)
    observed = np.ones(20)
    observed[:3] = observed[15:] = 0.0
    (life,) = lives_of(replace(track, observed=observed))
    assert [(gap.start, gap.end, gap.joined) for gap in life.gaps] == [
        (track.t[0], track.t[3], False),
        (track.t[14], track.t[19], False),
    ]
    (never,) = lives_of(replace(track, observed=np.zeros(20)))
    assert [(gap.start, gap.end, gap.joined) for gap in never.gaps] == [(track.t[0], track.t[-1], False)]


def test_tracks_of_given_identities_have_no_timeline_without_the_truth():
    plain = TrackSet((walker(1), walker(2)))
    assert section(tracking_report(plain)) is None
    assert section(tracking_report(plain, events=())) is not None
    assert section(tracking_report(TrackSet((associated(),)))) is not None


def test_the_tables_say_what_lives_are():
    tracks = [associated(i + 1, kept=0.7) for i in range(4)]
    lives = lives_of(*tracks)
    report = tracking_report(TrackSet(tuple(tracks)))
    assert [row[:4] for row in table(report, "Births and deaths").rows] == [
        (life.person, life.birth, life.death, len(life.gaps)) for life in lives
    ]
    gaps = table(report, "Gaps and joins").rows
    assert sorted(row[:3] for row in gaps) == sorted(
        (life.person, gap.start, gap.end) for life in lives for gap in life.gaps
    )
    sure = [row[-1] for row in gaps]
    assert sure == sorted(sure)


def test_events_stand_at_the_time_of_the_track_that_has_the_person_now():
    first, second = walker(1, n=20, hz=2.5), walker(2, n=20, hz=2.5, frame=np.arange(20) + 5)
    events = (
        IdentityEvent(9, 70, 1, 2, switch=True, found_again=False),
        IdentityEvent(12, 70, 2, 2, switch=False, found_again=True),
    )
    report = tracking_report(TrackSet((first, second)), events=events)
    assert report.replay["events"] == [[1.6, "70", "1", "2", 1, 0], [2.8, "70", "2", "2", 0, 1]]
    rows = table(report, "Switches and fragmentations").rows
    assert rows == (("2", 1.6, 70, "1", True, False), ("2", 2.8, 70, "2", False, True))
    assert [row[-1] for row in table(report, "Births and deaths").rows] == [1, 1]


def test_clock_times_of_lives_and_events_count_from_the_start_too():
    track = associated(kept=0.5)
    late = replace(track, t=track.t + 1.7e9)
    event = IdentityEvent(3, 7, 1, 1, switch=False, found_again=True)
    report = tracking_report(TrackSet((late,)), events=(event,))
    assert report.subtitle == "Times count from 1700000000 s."
    assert report.replay["people"][0]["t"][0] == 0
    assert report.replay["events"][0][0] == pytest.approx(1.2, abs=1e-3)
    assert report.replay["people"][0]["gaps"][0][0] == pytest.approx(
        life_of(pair_track(track)).gaps[0].start, abs=1e-3
    )


@pytest.mark.slow
@pytest.mark.parametrize("people", [0, 1, 300])
def test_a_page_of_nobody_of_one_and_of_hundreds(people):
    tracks = TrackSet(tuple(associated(i + 1, n=40) for i in range(people)))
    report = tracking_report(tracks, events=())
    page = render_report(report)
    assert ("timeline panel" in page) == ("<canvas" in page) == bool(people)
    assert any(isinstance(item, Chart) for item in section(report).items) == bool(people)
    assert len(page) < 2_500_000
    if people == 300:
        gaps = table(report, "Gaps and joins")
        assert len(gaps.rows) == MAX_ROWS and f"first {MAX_ROWS} of" in gaps.note


def test_thinned_data_keep_gaps_and_the_least_sure_links():
    track = associated(n=400, kept=0.9)
    report = tracking_report(TrackSet((track,)))
    whole = report.replay["people"][0]
    pair = pair_track(track)
    thinned = replay_data([pair], max_samples=50, lives=[life_of(pair)])["people"][0]
    assert thinned["gaps"] == whole["gaps"]
    kept = delta_decode(thinned["sure"], SURE_STEP, len(thinned["t"]))
    assert len(kept) <= 50
    assert np.nanmin(kept) == pytest.approx(np.nanmin(track.identity_p), abs=0.005)


def in_page(report, code):
    start = f"{decoded(report.replay)} const events = decodeEvents(data.events, people);"
    return in_node((*SCRIPTS, "replay_draw.js"), start + code)


@pytest.mark.parametrize("seed", range(4))
def test_bars_and_gaps_fill_a_life_once(seed):
    track = associated(seed=seed, kept=0.6)
    report = tracking_report(TrackSet((track,)))
    parts, gaps = in_page(report, "return [seenParts(people[0]), people[0].gaps.map((g) => [g.from, g.to])];")
    edges = sorted(parts + gaps)
    assert edges[0][0] == pytest.approx(track.t[0]) and edges[-1][1] == pytest.approx(track.t[-1])
    assert [one[1] for one in edges[:-1]] == pytest.approx([one[0] for one in edges[1:]], abs=2e-3)
    for frame in np.flatnonzero(track.observed == 0.0):
        assert not any(a + 1e-3 < track.t[frame] < b - 1e-3 for a, b in parts)


def test_nothing_is_a_bar_before_the_first_and_after_the_last_sight():
    observed = np.ones(20)
    observed[:3] = observed[15:] = 0.0
    track = replace(associated(n=20, kept=1.0), observed=observed)
    parts = in_page(tracking_report(TrackSet((track,))), "return seenParts(people[0]);")
    assert parts == [pytest.approx([1.2, 5.6])]
    never = replace(track, observed=np.zeros(20))
    assert in_page(tracking_report(TrackSet((never,))), "return seenParts(people[0]);") == []


def test_orders_of_the_timeline():
    sure = associated(1, n=20, kept=1.0, first=10)
    sure = replace(sure, identity_p=np.ones(20))
    doubtful = replace(associated(2, n=20, kept=1.0, first=5), identity_p=np.full(20, 0.5))
    hidden = np.ones(20)
    hidden[5:12] = 0.0
    lost = replace(associated(3, n=20, kept=1.0, first=12), identity_p=np.ones(20), observed=hidden)
    event = IdentityEvent(14, 7, 99, 1, switch=True, found_again=False)
    report = tracking_report(TrackSet((sure, doubtful, lost)), events=(event,))
    code = """const found = {};
    ["birth", "unsure", "gap", "switches"].forEach((order) => {
      found[order] = orderedLives(people, events, order).map((i) => people[i].id);
    });
    people[1].shown = false;
    found.shown = orderedLives(people, events, "birth").map((i) => people[i].id);
    return found;"""
    assert in_page(report, code) == {
        "birth": ["2", "1", "3"],
        "unsure": ["2", "1", "3"],
        "gap": ["3", "2", "1"],
        "switches": ["1", "2", "3"],
        "shown": ["1", "3"],
    }


def test_what_the_timeline_says_in_words():
    hidden = np.ones(20)
    hidden[5:9] = 0.0
    p = np.ones(20)
    p[9], p[12] = 0.634, 0.02
    p[5:9] = np.nan
    track = replace(associated(3, n=20, kept=1.0), identity_p=p, observed=hidden)
    events = (IdentityEvent(12, 70, 44, 3, switch=True, found_again=True),)
    report = tracking_report(TrackSet((track,)), events=events)
    code = "return [-1, 1.0, 2.4, 3.6, 4.6, 9].map((t) => lifeInWords(people, 0, t, events, 0.1));"
    life = "3, 0.0 to 7.6 s"
    assert in_page(report, code) == [
        f"-1.0 s · {life} · not born",
        f"1.0 s · {life} · seen, link 100\u202f% sure",
        f"2.4 s · {life} · gap of 2.0 s, filled in, joined, 63\u202f% sure",
        f"3.6 s · {life} · seen, link 100\u202f% sure · gap of 2.0 s, joined, 63\u202f% sure",
        f"4.6 s · {life} · seen, link 2\u202f% sure",
        f"9.0 s · {life} · gone",
    ]
    assert in_page(report, "return lifeInWords(people, 0, 4.8, events, 0.1);").endswith(
        "true person 70: 44 → 3, found again"
    )


def test_the_replay_marks_births_deaths_and_joins_where_they_happened():
    track = associated(kept=0.7)
    report = tracking_report(TrackSet((track,)))
    marks = in_page(report, "return marksOf(people[0]).map((m) => [m.kind, m.t, people[0].t[m.at]]);")
    (life,) = lives_of(track)
    wanted = [("birth", life.birth), ("death", life.death), *(("join", gap.end) for gap in life.gaps)]
    assert [(kind, round(t, 3)) for kind, t, _ in marks] == [(kind, round(t, 3)) for kind, t in wanted]
    assert [t for _, t, _ in marks] == pytest.approx([at for _, _, at in marks], abs=2e-3)


def test_a_filled_gap_of_a_trail_is_a_part_of_its_own():
    track = associated(kept=0.7, seed=3)
    report = tracking_report(TrackSet((track,)))
    parts = in_page(report, "return trailParts(people[0], 0, people[0].t.length - 1);")
    assert parts[0][0] == 0 and parts[-1][1] == len(track) - 1
    assert [part[1] for part in parts[:-1]] == [part[0] for part in parts[1:]]
    dotted = {k for first, last, gap in parts if gap for k in range(first + 1, last)}
    assert dotted == set(np.flatnonzero(track.observed == 0.0).tolist())


@pytest.mark.parametrize(
    ("column", "unit", "since"),
    [
        ([f"2026-11-23T10:00:{k:02d}.5+01:00" for k in range(7, 12)], "iso", "2026-11-23 09:00:07 UTC"),
        ([f"2026-11-23 10:00:{k:02d}" for k in range(7, 12)], "iso", "2026-11-23 10:00:07"),
        ([1_795_428_007_500 + 1000 * k for k in range(5)], "ms", "2026-11-23 10:00:07 UTC"),
        ([36_000.5 + k for k in range(5)], "s", ""),
    ],
)
def test_times_of_dates_count_from_the_first(column, unit, since):
    """As read from tables and bags, where they count from midnight; other seconds are as they are."""
    table = {"id": [1] * 5, "when": column, "x": range(5), "y": [0.0] * 5}
    tracks = gt.read(table, columns="id=id,t=when,x=x,y=y", time_unit=unit)
    report = tracking_report(tracks)
    assert report.subtitle == (f"Times count from {since}." if since else "")
    first = tracks[0].t[0] - (np.floor(tracks[0].t[0]) if since else 0.0)
    assert report.replay["people"][0]["t"][0] == pytest.approx(1000.0 * first)
