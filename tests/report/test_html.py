import base64
import json
import re
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest
from made_up import CALIBRATION, ERRORS, observed, scene, walker

from graphtrack.errors import InputError
from graphtrack.report.content import Card, DataTable, Note, Report, Section
from graphtrack.report.html import format_cell, render_report, write_html
from graphtrack.report.lives import pair_tracks
from graphtrack.report.page import tracking_report
from graphtrack.report.replay import replay_data
from graphtrack.tracks.track import ReadSummary, TrackSet

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
        tracking_report(
            estimates, observations, title="A square", comparison=ERRORS, calibration=CALIBRATION, events=()
        )
    )


@pytest.mark.slow
def test_the_page_refers_to_nothing_outside_itself(full):
    page = Page(full)
    for _, attributes in page.elements:
        for name in ("src", "href", "srcset", "action", "poster", "data"):
            assert attributes.get(name, "#").startswith(("#", "data:image/png;base64,"))
    assert not any(tag in ("link", "iframe", "object", "embed") for tag, _ in page.elements)
    # The name of SVG is written like an address; nothing is fetched from it.
    assert not re.search(r"https?:|@import|url\(", full.replace("http://www.w3.org/2000/svg", ""))
    policies = [a["content"] for tag, a in page.elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert policies[0].startswith("default-src 'none'")


def unpacked(text):
    return json.loads(zlib.decompress(base64.b64decode(text)))


def replay_in(page):
    kinds = [a for tag, a in page.elements if tag == "script"]
    (text,) = [s for s, a in zip(page.scripts, kinds, strict=True) if a.get("id") == "replay-data"]
    return unpacked(text)


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (np.arange(60) / 2.5, "one frame (0.4 s)"),
        (np.arange(60) / 25.0, "one frame (0.04 s)"),
        (np.cumsum(np.random.default_rng(0).uniform(0.5, 3.0, 60)), "one frame, with"),
    ],
)
def test_the_page_says_how_long_a_frame_is_where_frames_are_even(t, words):
    page = Page(render_report(Report("t", replay=replay_data(pair_tracks(TrackSet((walker(t=t),)))))))
    assert words in " ".join("".join(page.words).split())


def test_the_page_says_what_it_leaves_out():
    estimates, _ = scene(people=2, n=600)
    pairs = pair_tracks(estimates)
    thinned = Report("t", replay=replay_data(pairs, max_samples=300))
    words = " ".join(" ".join(Page(render_report(thinned)).words).split())
    assert "242 of 1 200 person-frames, one every 0.2 s" in words
    assert "person-frames, one every" not in render_report(Report("t", replay=replay_data(pairs)))


@pytest.mark.slow
def test_hostile_words_stay_words():
    tracks = [walker(i, label=HOSTILE) for i in (1, 2)]
    report = tracking_report(
        TrackSet(tuple(tracks)),
        TrackSet(tuple(map(observed, tracks)), summary=ReadSummary("csv", 3, {HOSTILE: 1}, (HOSTILE,))),
        title=HOSTILE,
        subtitle=HOSTILE,
        comparison=[{**row, "method": HOSTILE, "unit": HOSTILE} for row in ERRORS],
        calibration=[{**row, "method": HOSTILE} for row in CALIBRATION],
        cards=(Card(HOSTILE, HOSTILE, HOSTILE),),
        sections=(Section(HOSTILE, (Note(HOSTILE), DataTable(HOSTILE, (HOSTILE,), ((HOSTILE,),), HOSTILE))),),
    )
    plain = tracking_report(*scene(people=1), comparison=ERRORS, calibration=CALIBRATION)
    page, usual = Page(render_report(report)), Page(render_report(plain))
    assert len(page.scripts) == len(usual.scripts)
    assert HOSTILE in " ".join(page.words)
    assert replay_in(page)["people"][0]["label"] == HOSTILE


@pytest.mark.slow
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
    page = Page(render_report(tracking_report(TrackSet((bare,)))))
    layers = {a["data-layer"] for _, a in page.elements if "data-layer" in a}
    assert layers == {"head", "trail", "paths", "label"}


def test_the_parts_that_the_scripts_look_for_are_in_the_page(full):
    wanted = set(re.findall(r'part\("(\w+)"\)', full)) | set(re.findall(r'\[data-part="(\w+)"\]', full))
    there = {a["data-part"] for _, a in Page(full).elements if "data-part" in a}
    assert wanted == there


def test_the_table_of_people_holds_their_errors():
    estimates, observations = scene(people=2)
    report = tracking_report(estimates, observations)
    (section,) = [s for s in report.sections if s.title == "People"]
    table, motion = section.items
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert row["position RMSE (m)"] == pytest.approx(np.hypot(0.05, 0.05))
    assert row["head error (°)"] == pytest.approx(0.0, abs=1e-9)
    assert row["observed (%)"] == pytest.approx(75.0)
    row = dict(zip(motion.columns, motion.rows[0], strict=True))
    assert row["95 % from"] <= row["median speed (m/s)"] <= row["to"]
    assert row["frames with a heading (%)"] == 100.0 and 0.0 < row["heading ± 95 % (°)"] < 90.0


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "report.html"
    write_html(path, Report("first"))
    assert "first" in path.read_text(encoding="utf-8")
    with pytest.raises(ValueError, match="JSON"):
        data = replay_data(pair_tracks(scene(people=1)[0]))
        write_html(path, Report("second", replay={**data, "steps": {**data["steps"], "angle": float("nan")}}))
    assert "first" in path.read_text(encoding="utf-8")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(InputError):
        write_html(tmp_path / "nowhere" / "report.html", Report("third"))


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
