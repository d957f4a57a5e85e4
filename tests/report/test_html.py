import json
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from made_up import ERRORS, NEES, observed, scene, walker
from plotly.offline import get_plotlyjs

from graphtrack.errors import InputError
from graphtrack.report.build import tracking_report
from graphtrack.report.content import Card, Note, Report, Section, Table
from graphtrack.report.html import format_cell, render_report, safe_json, write_report
from graphtrack.report.replay import LENGTH_STEP, delta_decode
from graphtrack.tracks import ReadSummary, TrackSet

HOSTILE = "</script><script>alert('x')</script>&\"'"


class Page(HTMLParser):
    """Elements with their attributes, and the text of each script."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.scripts, self.words = [], [], []
        self._in_script = False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag == "script":
            self._in_script = True
            self.scripts.append("")

    def handle_endtag(self, tag):
        if tag == "script":
            self._in_script = False

    def handle_data(self, data):
        if self._in_script:
            self.scripts[-1] += data
        else:
            self.words.append(data)


@pytest.fixture(scope="module")
def full():
    estimates, observations = scene(people=3)
    return render_report(
        tracking_report(estimates, observations, title="A square", comparison=ERRORS, consistency=NEES)
    )


def test_the_page_refers_to_nothing_outside_itself(full):
    page = Page(full)
    for _, attributes in page.elements:
        for name in ("src", "href", "srcset", "action", "poster", "data"):
            assert attributes.get(name, "#").startswith(("#", "data:image/png;base64,"))
    assert not any(tag in ("link", "iframe", "object", "embed") for tag, _ in page.elements)
    # Plotly's own text has addresses for maps, which no chart here uses; ours has none at all.
    ours = full.replace(get_plotlyjs(), "")
    assert len(ours) < len(full)
    assert not re.search(r"https?:|@import|url\(", ours)
    policies = [a["content"] for tag, a in page.elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert policies[0].startswith("default-src 'none'")


def test_plotly_stands_in_the_page_once_and_only_for_charts(full):
    assert full.count(get_plotlyjs()[:200]) == 1
    estimates, observations = scene(people=1)
    still = render_report(tracking_report(estimates, observations, comparison=ERRORS, interactive=False))
    assert len(still) < 2_000_000
    assert "Plotly Cloud" not in still


def test_plotly_is_told_not_to_offer_sending_data_away(full):
    assert "showSendToCloud: false" in full
    assert 'plotlyServerURL: ""' in full


def test_the_replay_in_the_page_brings_back_the_positions(full):
    page = Page(full)
    kinds = [a for tag, a in page.elements if tag == "script"]
    (text,) = [s for s, a in zip(page.scripts, kinds, strict=True) if a.get("id") == "replay-data"]
    estimates, _ = scene(people=3)
    for person, estimate in zip(json.loads(text)["people"], estimates, strict=True):
        t = delta_decode(person["t"], 1e-3, len(person["t"]))
        at = np.searchsorted(estimate.t, t - 5e-4)
        x = delta_decode(person["x"], LENGTH_STEP, len(t))
        assert x == pytest.approx(estimate.position[at, 0], abs=1e-3)


def test_hostile_words_stay_words():
    track = walker(1, label=HOSTILE)
    report = tracking_report(
        TrackSet((track,)),
        TrackSet((observed(track),), summary=ReadSummary("csv", 3, {HOSTILE: 1}, (HOSTILE,))),
        title=HOSTILE,
        subtitle=HOSTILE,
        comparison=[{**row, "method": HOSTILE, "unit": HOSTILE} for row in ERRORS],
        consistency=[{**row, "method": HOSTILE} for row in NEES],
        cards=(Card(HOSTILE, HOSTILE, HOSTILE),),
        sections=(Section(HOSTILE, (Note(HOSTILE), Table(HOSTILE, (HOSTILE,), ((HOSTILE,),), HOSTILE))),),
    )
    plain = tracking_report(*scene(people=1), comparison=ERRORS, consistency=NEES)
    page, usual = Page(render_report(report)), Page(render_report(plain))
    assert len(page.scripts) == len(usual.scripts)
    assert HOSTILE in " ".join(page.words)
    data = [s for s in page.scripts if s.startswith(("{", "["))]
    assert all(json.loads(s) is not None for s in data)
    assert json.loads(data[0])["people"][0]["label"] == HOSTILE


def test_links_lead_somewhere_and_ids_are_distinct(full):
    page = Page(full)
    ids = [a["id"] for _, a in page.elements if "id" in a]
    assert len(set(ids)) == len(ids)
    targets = [a["href"][1:] for tag, a in page.elements if tag == "a"]
    assert targets
    assert set(targets) <= set(ids)


def test_everything_that_can_be_operated_has_a_name(full):
    page = Page(full)
    for tag, attributes in page.elements:
        if tag in ("canvas", "img") or attributes.get("role") in ("img", "region"):
            assert attributes.get("aria-label") or attributes.get("alt")
        if tag == "input" and attributes["type"] == "range":
            assert attributes["aria-label"]


def test_the_controls_are_those_that_there_are_data_for():
    bare = walker(1, body=None, covariance=None, velocity=None)
    page = Page(render_report(tracking_report(TrackSet((bare,)), interactive=False)))
    layers = {a["data-layer"] for _, a in page.elements if "data-layer" in a}
    assert layers == {"head", "trail", "label"}


def test_the_parts_that_the_scripts_look_for_are_in_the_page(full):
    wanted = set(re.findall(r'part\("(\w+)"\)', full)) | {"everybody", "nobody"}
    there = {a["data-part"] for _, a in Page(full).elements if "data-part" in a}
    assert wanted == there


@pytest.mark.parametrize("interactive", [True, False])
def test_nobody_at_all_still_makes_a_page(interactive):
    page = render_report(tracking_report(TrackSet(()), interactive=interactive))
    assert "<canvas" not in page


def test_clock_times_count_from_the_start_and_say_so():
    track = walker(1)
    late = walker(1, t=track.t + 1.7e9)
    report = tracking_report(TrackSet((late,)), TrackSet((observed(late),)), interactive=False)
    assert report.subtitle == "Times count from 1700000000 s."
    assert report.replay["people"][0]["t"][0] == 0


def test_the_table_of_people_holds_their_errors():
    estimates, observations = scene(people=2)
    report = tracking_report(estimates, observations, interactive=False)
    (section,) = [s for s in report.sections if s.title == "People"]
    (table,) = section.items
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert row["position RMSE (m)"] == pytest.approx(np.hypot(0.05, 0.05))
    assert row["head error (°)"] == pytest.approx(0.0, abs=1e-9)
    assert row["observed (%)"] == pytest.approx(75.0)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "report.html"
    write_report(path, Report("first"))
    assert "first" in path.read_text(encoding="utf-8")
    with pytest.raises(ValueError, match="JSON"):
        write_report(
            path, Report("second", replay={"people": [{**_person(), "x": [float("nan")]}], "rate": None})
        )
    assert "first" in path.read_text(encoding="utf-8")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(InputError):
        write_report(tmp_path / "nowhere" / "report.html", Report("third"))


def _person():
    from graphtrack.report.replay import replay_data

    return replay_data(TrackSet((walker(n=1),)))["people"][0]


def test_json_in_a_page_cannot_end_its_element():
    text = safe_json({"label": HOSTILE + "<!--"})
    assert not set("<>&") & set(text)
    assert json.loads(text)["label"] == HOSTILE + "<!--"


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, "–"),
        (float("nan"), "–"),
        (np.float32(0.5), "0.5"),
        (np.int64(12345), "12345"),
        (12345.6, "12346"),
        (0.123456, "0.1235"),
        (True, "yes"),
        ("a_b", "a_b"),
    ],
)
def test_cells(value, shown):
    assert format_cell(value) == shown


def test_tables_come_from_frames_and_dicts_alike():
    rows = [{"method": "a", "error": 1.5}, {"method": "b", "error": 2.0}]
    assert Table.from_records("t", rows) == Table.from_records("t", pd.DataFrame(rows))
    with pytest.raises(InputError):
        Table.from_records("t", [rows[0], {"method": "b"}])
