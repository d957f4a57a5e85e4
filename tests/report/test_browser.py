"""The page of many people in a browser: one visit, which the tests inspect."""

from pathlib import Path

import numpy as np
import pytest
from made_up import observed, walker
from page_scripts import in_browser

from graphtrack.report.html import render_report
from graphtrack.report.page import tracking_report
from graphtrack.tracks.track import TrackSet

PEOPLE = 60

VISIT = (Path(__file__).parent / "visit.js").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    n, hz = 30, 2.5
    t = np.arange(n) / hz

    def person(i):
        # All on parallel lines but the first, whose path crosses the middle of the scene.
        y = np.full(n, float(i)) if i else np.linspace(PEOPLE / 2 - 0.6, PEOPLE / 2 - 0.4, n)
        x = np.linspace(0.0, 20.0, n) if i else np.linspace(9.0, 11.0, n)
        return walker(i, n=n, t=t, position=np.stack([x, y], axis=1), label=f"walker {i}<b>")

    tracks = tuple(person(i) for i in range(PEOPLE))
    watched = TrackSet(tuple(observed(track) for track in tracks))
    report = tracking_report(TrackSet(tracks), watched, events=())
    return in_browser(render_report(report), VISIT, tmp_path_factory.mktemp("browser"))


@pytest.mark.slow
def test_people_stand_on_pages_and_are_found(seen):
    assert seen["names"] == [f"walker {i}<b>" for i in range(24)]
    assert seen["page"] == "1–24 of 60" and seen["tally"] == "60 of 60 shown"
    assert seen["second"] == [f"walker {i}<b>" for i in range(24, 48)]
    assert seen["found"] == ["walker 7<b>", "walker 31<b>"]
    assert seen["foundTally"] == "2 found, 60 of 60 shown"


@pytest.mark.slow
def test_all_none_or_only_some_are_shown(seen):
    assert seen["only"] == "2 found, 2 of 60 shown"
    assert seen["none"] == "2 found, 0 of 60 shown" and seen["empty"].endswith("0 people")
    assert seen["all"] == "2 found, 60 of 60 shown"


@pytest.mark.slow
def test_keys_and_buttons_step_by_frames(seen):
    assert [seen[name] for name in ("on", "ten", "back", "button")] == pytest.approx([0.4, 4.4, 4.0, 4.4])


def test_replay_and_chart_are_drawn(seen):
    assert seen["drawn"] == [True, True, True]


def test_tables_page_search_and_sort(seen):
    assert seen["rows"] == [f"walker {i}<b>" for i in range(20)]
    assert seen["rowsFound"] == [f"walker {i}<b>" for i in (5, *range(50, 60))]
    # By their numbers, not their letters.
    assert seen["sorted"] == [f"walker {i}<b>" for i in range(59, 39, -1)] and seen["aria"] == "descending"


def test_one_choice_leads_the_replay_the_chart_the_table_and_the_address(seen):
    assert seen["visited"]["name"] == "Person walker 59<b>"
    assert seen["visited"]["chart"] == "walker 59<b>"
    assert seen["visited"]["row"] == "walker 59<b>"
    assert seen["visited"]["hash"] == "#t=4.40&person=walker%2059%3Cb%3E"
    assert "walker 59<b>" in seen["visited"]["label"] and seen["visited"]["reading"].startswith(
        "4.40 s: speed 1.50 m/s"
    )
    assert seen["typed"] == "Person walker 33<b>" and seen["after"] == "walker 34<b>"
    assert seen["escaped"]


def test_the_pointer_names_and_a_click_chooses(seen):
    assert seen["tip"].startswith("walker 0<b>")
    assert seen["clicked"] == "Person walker 0<b>"


def test_the_timeline_has_everybody_in_order_and_a_click_chooses(seen):
    assert seen["lives"] == "1–60 of 60"
    assert seen["life"] == "Person walker 3<b>" and seen["lifeClock"] == pytest.approx(5.8, abs=0.3)
    assert "walker 3<b>, 0.0 to 11.6 s" in seen["story"]


def test_every_control_has_a_name(seen):
    assert seen["unnamed"] == []
