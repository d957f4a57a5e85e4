"""Groups, attention and forecasts in the page: its content, its scripts' output, and refused input."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from command import run
from made_up import observed, walker
from made_up_behaviour import AHEAD, BAR, SCREEN, forecast, grouped, looking, standing
from page_scripts import decoded, delta_decode, in_browser, in_node

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.angles import wrap
from graphtrack.interaction.attention import attention_columns
from graphtrack.interaction.tables import read_attention, read_group_table
from graphtrack.io.read_write import write_table
from graphtrack.report.content import DataTable
from graphtrack.report.html import packed, render_report
from graphtrack.report.interaction import behaviour_found, behaviour_of, by_main_group, group_spans
from graphtrack.report.page import tracking_report
from graphtrack.report.replay import COARSE_STEP, FAN_STEPS, MAX_DOING, MAX_FANS, SURE_STEP
from graphtrack.tracks.track import TrackSet

SCRIPTS = ("replay_data.js", "lives.js", "replay_draw.js", "behaviour.js")


def all_of(tracks, places=(BAR, SCREEN)):
    return behaviour_of(
        tracks,
        groups=grouped(tracks),
        attention=looking(tracks, places),
        forecast=forecast(tracks),
        places=places,
    )


@pytest.fixture(scope="module")
def tracks():
    return standing()


@pytest.fixture(scope="module")
def report(tracks):
    return tracking_report(tracks, behaviour=all_of(tracks), title="Four who stand")


def in_page(report, code):
    """Return the value of ``code``, with the page's ``people`` and ``behaviour`` at hand."""
    start = (
        f"{decoded(report.replay)} const behaviour = decodeBehaviour(data, people);"
        "const present = (t) => people.map((person, index) => ({ person, index, state: stateAt(person, t) }))"
        ".filter(({ state }) => state);"
    )
    return in_node(SCRIPTS, start + code)


def table(report, title):
    tables = [item for section in report.sections for item in section.items if isinstance(item, DataTable)]
    (found,) = [one for one in tables if one.title.startswith(title)]
    return [dict(zip(found.columns, row, strict=True)) for row in found.rows]


def test_the_replay_holds_what_was_given(report, tracks):
    first, second, third, _ = report.replay["people"]
    n = len(tracks.by_id(1))
    assert delta_decode(first["group"], 1.0, n).tolist() == [0.0] * n and third["group"] is None
    assert delta_decode(second["group_p"], SURE_STEP, n) == pytest.approx(0.9)
    # The next one, and the first of the places, which stand behind the people.
    assert delta_decode(first["look_0"], 1.0, n).tolist() == [1.0] * n
    assert delta_decode(first["look_1"], 1.0, n).tolist() == [4.0] * n
    assert delta_decode(first["look_p_1"], SURE_STEP, n) == pytest.approx(0.2)
    fans = delta_decode(third["fan_x"], COARSE_STEP, n // 2 * len(AHEAD)).reshape(-1, len(AHEAD))
    assert fans == pytest.approx(np.tile(3.0 + AHEAD, (n // 2, 1)), abs=COARSE_STEP)
    scene = report.replay["behaviour"]
    assert [group["number"] for group in scene["groups"]] == [0]
    assert [place["name"] for place in scene["places"]] == ["bar", "screen"]
    assert scene["fans"]["ahead"] == AHEAD.tolist() and scene["has"]["looks"]


@pytest.mark.slow
def test_each_kind_has_a_checkbox_and_only_where_there_is_some(report, tracks):
    def layers(one):
        return set(re.findall(r'data-layer="(\w+)"', render_report(one)))

    assert {"groups", "looks", "fans", "places"} <= layers(report)
    some = tracking_report(tracks, behaviour=behaviour_of(tracks, groups=grouped(tracks)))
    assert layers(some) & {"groups", "looks", "fans", "places"} == {"groups"}
    assert not layers(tracking_report(tracks)) & {"groups", "looks", "fans", "places"}


def test_sections_say_what_was_given(report):
    assert [section.title for section in report.sections][:3] == ["Groups", "Gaze", "Forecasts"]
    (group,) = table(report, "All groups")
    assert group["who"] == "1, 2" and group["kind"] == "conversing" and group["to (s)"] == pytest.approx(7.6)
    dwell = table(report, "Gaze at places")
    assert {(row["place"], row["seconds"]) for row in dwell} == {("bar", 1.6)}  # 8 s, 0.2 of them
    looks = {row["person"]: row for row in table(report, "Gaze of each person")}
    assert looks["1"]["looks most at"] == "2" and looks["1"]["for (s)"] == pytest.approx(4.8)
    # They stand, and were forecast to go: the error is how far.
    for row in table(report, "Forecasts by time"):
        assert row["error (m)"] == pytest.approx(row["ahead (s)"]) and row["inside 90 % (%)"] == 0.0


def test_probable_looks_at_a_place_are_intervals(tracks):
    found = looking(tracks, (BAR,))
    first = found[0]
    share = first.probability.copy()
    share[5:10] = 0.0
    share[5:10, len(first.people)] = 1.0
    found[0] = replace(first, probability=share)
    report = tracking_report(tracks, behaviour=behaviour_of(tracks, attention=found, places=[BAR]))
    (row,) = [row for row in table(report, "Gaze at places") if row["person"] == "1"]
    assert row["looks"] == 1 and row["likelier than not (s)"] == "1.8–3.8"


def test_the_order_of_a_table_is_without_effect(report, tracks, tmp_path):
    behaviour = all_of(tracks)
    rng = np.random.default_rng(0)
    named = {
        "groups": behaviour.groups.columns(),
        "attention": attention_columns(behaviour.attention),
        "forecast": behaviour.forecasts,
    }
    for name, columns in named.items():
        order = rng.permutation(len(columns["frame"]))
        write_table({key: values[order] for key, values in columns.items()}, tmp_path / f"{name}.csv")
    files = {name: tmp_path / f"{name}.csv" for name in named}
    again = tracking_report(tracks, behaviour=behaviour_of(tracks, places=[BAR, SCREEN], **files))
    assert again.replay == report.replay
    assert table(again, "All groups") == table(report, "All groups")
    assert table(again, "Gaze at places") == table(report, "Gaze at places")


def test_tables_are_read_as_they_were_written(tracks, tmp_path):
    groups, looks = grouped(tracks), looking(tracks, (BAR,))
    write_table(groups.columns(), tmp_path / "groups.csv")
    back = read_group_table(tmp_path / "groups.csv").columns()
    for name, values in groups.columns().items():
        np.testing.assert_array_equal(back[name], values)
    write_table(attention_columns(looks), tmp_path / "looks.csv")
    columns = attention_columns(read_attention(tmp_path / "looks.csv"))
    pd.testing.assert_frame_equal(pd.DataFrame(columns), pd.DataFrame(attention_columns(looks)))


def test_forecasts_without_frames_are_found_by_their_times(tracks, tmp_path):
    made = forecast(tracks)
    write_table({k: v for k, v in made.columns.items() if k != "frame"}, tmp_path / "forecast.csv")
    found = behaviour_of(tracks, forecast=tmp_path / "forecast.csv").forecasts["frame"]
    np.testing.assert_array_equal(found, made.columns["frame"])


def test_clock_times_count_from_the_start_as_the_tracks_do():
    late = standing(start=1.7e9)
    report = tracking_report(late, behaviour=all_of(late))
    (group,) = table(report, "All groups")
    assert group["from (s)"] == pytest.approx(0.0) and group["to (s)"] == pytest.approx(7.6)
    assert in_page(report, "return fanAt(behaviour, people[0], 0.1).made;") == pytest.approx(0.0)
    assert len(table(report, "Forecasts by time")) == len(AHEAD)


def test_scripts_find_the_group_its_hull_and_its_o_space(report):
    found = in_page(
        report,
        """
        const [one, ...more] = groupsAt(behaviour, present(1.0), 1.0);
        const hull = hullOf(one.members);
        return {
          more: more.length, members: one.members.map(({ person }) => person.id), p: one.p,
          radius: one.radius, centre: one.centre,
          within: [[1, 0.3], [1.5, 0], [2.3, 0]].map(([x, y]) => isInside(hull, x, y)),
          outside: [[0.5, 0], [1.5, 0.5], [2.5, 0]].map(([x, y]) => isInside(hull, x, y)),
          words: [groupUnder(behaviour, people, 1.5, 0, 1.0), groupUnder(behaviour, people, 3.0, 0, 1.0)],
        };
        """,
    )
    assert found["more"] == 0 and found["members"] == ["1", "2"] and found["p"] == pytest.approx(0.9)
    # Both stand half a metre from the centre, and a shoulder is a quarter of one.
    assert found["centre"] == pytest.approx([1.5, 0.0]) and found["radius"] == pytest.approx(0.25)
    assert found["within"] == [True] * 3 and found["outside"] == [False] * 3
    assert found["words"] == ["conversing (group 0, 90\u202f%): 1, 2", ""]


def test_scripts_find_looks_and_who_is_hidden_has_no_group(report):
    found = in_page(
        report,
        """
        const looks = looksOf(behaviour, people, people[0], stateAt(people[0], 1.0), 1.0);
        people[0].shown = people[1].shown = false;
        return { looks, hidden: groupUnder(behaviour, people, 1.5, 0, 1.0) };
        """,
    )
    assert found["looks"] == [
        {"x": 2, "y": 0, "p": pytest.approx(0.6), "name": "2"},
        {"x": 4, "y": 3, "p": pytest.approx(0.2), "name": "bar"},
    ]
    assert found["hidden"] == ""


def test_a_forecast_shows_the_times_still_ahead_until_the_next_is_late(report):
    made, half, late = in_page(
        report,
        """
        const told = (fan) => fan && [fan.made, fan.steps.map((step) => step.x)];
        const at = (t) => told(fanAt(behaviour, people[2], t));
        return [at(0.8), at(1.3), at(7.2 + behaviour.fans.hold + 0.01)];
        """,
    )
    assert made == [pytest.approx(0.8), pytest.approx([3.4, 3.8, 4.2, 4.6])]
    assert half == [pytest.approx(0.8), pytest.approx([3.8, 4.2, 4.6])]
    assert late is None


def test_scripts_say_what_somebody_does(report):
    first, third, gone = in_page(
        report, "return [[0, 1.0], [2, 1.0], [0, 99]].map(([i, t]) => doingInWords(behaviour, people, i, t));"
    )
    assert first == (
        "conversing (group 0, 90\u202f%) · looks at 2 (60\u202f%), bar (20\u202f%) · "
        "in 1.4 s within 0.8 m of (2.6, 0.0) with 90\u202f%"
    )
    assert third.startswith("alone (90\u202f%) · looks at 4") and gone == ""


def test_hulls_hold_their_points_whatever_their_order():
    points = np.random.default_rng(1).normal(size=(40, 2)).tolist()
    code = (
        f"const points = {json.dumps(points)}, hull = convexHull(points);"
        "const again = convexHull(points.slice().reverse());"
        "const middle = (k) => hull.reduce((sum, p) => sum + p[k], 0) / hull.length;"
        "const nearly = points.map((p) => [0, 1].map((k) => p[k] + 1e-6 * (middle(k) - p[k])));"
        "return [hull, again, nearly.every(([x, y]) => isInside(hull, x, y))];"
    )
    hull, again, held = in_node(SCRIPTS, code)
    assert sorted(hull) == sorted(again) and 2 < len(hull) < 40 and held


VISIT = """
const box = (name) => document.querySelector('[data-layer="' + name + '"]');
const canvas = part("canvas"), ctx = canvas.getContext("2d");
const paint = () => ctx.getImageData(0, 0, canvas.width, canvas.height).data.join();
const seen = {};
for (let tries = 0; tries < 40; tries += 1) await next();
for (const name of ["groups", "looks", "fans", "places"]) {
  const before = paint();
  box(name).click(); await next();
  seen[name] = paint() !== before;
  box(name).click(); await next();
}
const view = part("canvas").getBoundingClientRect();
// From (0, 0) to (4.5, 6.2), with half a metre about it.
const scale = Math.min(view.width / 5.5, view.height / 7.2);
const at = (x, y) => ({
  clientX: view.left + view.width / 2 + (x - 2.25) * scale,
  clientY: view.top + view.height / 2 - (y - 3.1) * scale,
  bubbles: true, pointerType: "mouse",
});
part("canvas").dispatchEvent(new PointerEvent("pointermove", at(1.5, 0))); await next();
seen.group = part("tip").hidden ? "" : part("tip").textContent;
part("canvas").dispatchEvent(new PointerEvent("pointermove", at(3, 0))); await next();
seen.person = part("tip").hidden ? "" : part("tip").textContent;
part("canvas").dispatchEvent(new PointerEvent("click", at(3, 0))); await next();
seen.doing = part("doing").textContent;
return seen;
"""


@pytest.mark.slow
def test_in_a_browser_layers_are_drawn_and_the_pointer_is_told(report, tmp_path):
    seen = in_browser(render_report(report), VISIT, tmp_path)
    assert [seen[name] for name in ("groups", "looks", "fans", "places")] == [True] * 4
    assert seen["group"].startswith("conversing (group 0")
    assert seen["person"].startswith("3 · alone") and "looks at 4 (60" in seen["person"]
    assert seen["doing"] == seen["person"].removeprefix("3 · ")


def test_groups_are_told_by_their_spans(tracks):
    groups = grouped(tracks)
    (span,) = group_spans(groups)
    assert (span.members, span.smallest, span.largest) == ((1, 2), 2, 2)
    assert span.person_seconds == pytest.approx(2 * 20 * 0.4)
    swapped = replace(groups, group=np.where(groups.track_id >= 3, 5, -1))
    assert by_main_group(swapped, (1, 2, 3, 4)) == [3, 4, 1, 2]
    assert by_main_group(None, (3, 1)) == [3, 1]


@pytest.mark.slow
def test_a_page_of_300_people_with_everything_stays_below_8_megabytes():
    rng = np.random.default_rng(0)
    n, people = 40, 300
    places = 40.0 * rng.random((people, 2))

    def noisy(i):
        one = walker(i, n=n, hz=2.5)
        position = places[i] + np.cumsum(rng.normal(0.0, 0.1, (n, 2)), axis=0)
        angles = {name: wrap(getattr(one, name) + rng.normal(0.0, 0.3, n)) for name in ("body", "head")}
        spread = one.covariance * rng.random((n, 1, 1))
        return walker(i, n=n, hz=2.5, position=position, covariance=spread, **angles)

    tracks = TrackSet(tuple(noisy(i) for i in range(people)))
    rows = grouped(tracks)
    rows = replace(
        rows,
        group=np.where(rng.random(len(rows)) < 0.2, -1, rows.track_id // 4),
        probability=rng.random(len(rows)),
        centre=places[rows.track_id] + rng.normal(0.0, 0.1, (len(rows), 2)),
    )
    looks = [replace(one, probability=rng.dirichlet(np.full(people, 0.02), n)) for one in looking(tracks)]
    made = forecast(tracks, every=1)
    noise = {name: made.columns[name] + rng.normal(0.0, 0.1, len(made)) for name in ("x", "y")}
    wide = {name: rng.random(len(made)) for name in ("radius_50", "radius_90")}
    made = replace(made, columns={**made.columns, **noise, **wide})
    given = behaviour_of(tracks, groups=rows, attention=looks, forecast=made)
    seen = TrackSet(tuple(observed(track) for track in tracks))
    report = tracking_report(tracks, seen, behaviour=given)
    of_people = report.replay["people"]
    fans = len(packed([{k: v for k, v in one.items() if k.startswith("fan_")} for one in of_people]))
    shown = sum(len(one["fan_t"]) for one in of_people)
    whole = len(packed(report.replay))
    rest = len(render_report(report).encode()) - whole
    # However many minutes: so many samples and so many forecasts go into a page.
    most_fans = fans * MAX_FANS / shown * FAN_STEPS / len(AHEAD)
    assert rest + (whole - fans) * MAX_DOING / report.replay["kept"] + most_fans < 8_000_000


def test_of_many_forecasts_some_are_shown_and_the_page_says_so(tracks, monkeypatch):
    monkeypatch.setattr("graphtrack.report.replay.MAX_FANS", 15)
    report = tracking_report(tracks, behaviour=behaviour_of(tracks, forecast=forecast(tracks)))
    assert report.replay["behaviour"]["fans"]["every"] == 3  # 40 of them
    assert sum(len(one["fan_t"]) for one in report.replay["people"]) <= 16
    assert "One forecast in 3 is shown." in render_report(report)


@pytest.mark.slow
def test_one_person_and_one_without_a_place_have_a_page():
    alone = standing(people=1)
    lost = replace(alone.by_id(1), track_id=2, position=np.full_like(alone.by_id(1).position, np.nan))
    nobody = [replace(one, people=(), probability=np.ones((20, 1))) for one in looking(standing(people=2))]
    for tracks in (alone, TrackSet((alone.by_id(1), lost))):
        groups = grouped(tracks)
        groups = replace(groups, group=np.full(len(groups), -1))
        looks = nobody[: len(tracks)]
        given = behaviour_of(tracks, groups=groups, attention=looks, forecast=forecast(alone))
        report = tracking_report(tracks, behaviour=given)
        assert "No groups were found." in render_report(report)
        assert in_page(report, "return doingInWords(behaviour, people, 0, 1.0);").startswith("alone")


def test_looks_and_forecasts_of_others_are_refused(tracks):
    more = standing(people=5)
    with pytest.raises(InputError, match="gaze at person 5, expected people of the tracks"):
        behaviour_of(tracks, attention=looking(more)[:4])
    with pytest.raises(InputError, match="looks of person 5"):
        behaviour_of(tracks, attention=looking(more)[4:])
    with pytest.raises(InputError, match="gaze at 'bar', expected one of the given places"):
        behaviour_of(tracks, attention=looking(tracks, (BAR,)), places=[SCREEN])
    with pytest.raises(InputError, match="forecasts of person 5"):
        behaviour_of(tracks, forecast=forecast(more))
    with pytest.raises(InputError, match="forecasts of person 1 in frame 20"):
        behaviour_of(tracks, forecast=forecast(standing(n=22)))


@pytest.mark.slow
def test_looks_at_places_that_nobody_gave_are_counted_and_in_no_map(tracks):
    report = tracking_report(tracks, behaviour=behaviour_of(tracks, attention=looking(tracks, (BAR,))))
    assert len(table(report, "Gaze at places")) == 4
    assert "No position of bar was given" in render_report(report)
    assert report.replay["people"][0]["look_1"] is None


@pytest.fixture
def here(tracks, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gt.write(tracks, "tracks.csv")
    write_table(grouped(tracks).columns(), "groups.csv")
    write_table(attention_columns(looking(tracks, (BAR,))), "attention.csv")
    write_table(forecast(tracks).columns, "forecast.csv")
    (tmp_path / "places.csv").write_text("name,x,y,radius\nbar,4,3,0.5\n")
    return tmp_path


def graphtrack(line):
    return run(*line.split(), program="graphtrack")


def test_what_people_do_is_found_where_there_is_enough_of_it(tracks):
    found = behaviour_found(tracks)
    assert found.groups is not None and {one.track_id for one in found.attention} == {
        one.track_id for one in tracks
    }
    without_heads = behaviour_found(tracks.map(lambda track: replace(track, head=None)))
    assert without_heads.groups is not None and without_heads.attention is None
    alone = tracks.with_tracks(tracks.tracks[:1])
    assert behaviour_found(alone) is None
    at_places = behaviour_found(alone, places=(BAR, SCREEN))
    assert at_places.groups is None and len(at_places.attention) == 1
    assert behaviour_found(tracks, with_attention=False).attention is None


def test_a_smoothed_page_has_the_run_and_what_people_do(here):
    everything = "--groups --attention --places places.csv --crowd zones.csv --figures figures"
    (here / "zones.csv").write_text("name,x,y,radius\nroom,0,0,4\n")
    done = graphtrack(f"smooth tracks.csv -o smoothed.csv --report all.html {everything}")
    assert done.returncode == 0, done.stderr
    page = (here / "all.html").read_text(encoding="utf-8")
    sections = (
        "Groups",
        "Gaze",
        "Crowd measures",
        "Calibration",
        "Learned constants",
        "Methods, for a paper",
    )
    for title in sections:
        assert f">{title}" in page, title
    assert "F-formation" in page  # the methods paragraph has how groups were found
    assert (here / "figures" / "reliability-on-the-observations.svg").exists()
    noisy = gt.read("tracks.csv")
    solutions = gt.solve(noisy)
    estimates = noisy.with_tracks(one.track for one in solutions)
    gt.write_report("same.html", estimates, noisy, solutions=solutions, groups=gt.groups(estimates))
    again = (here / "same.html").read_text(encoding="utf-8")
    assert all(f">{title}" in again for title in ("Groups", *sections[3:]))
    with pytest.raises(InputError, match="solutions without observations"):
        gt.write_report("same.html", estimates, solutions=solutions)
    done = graphtrack("smooth tracks.csv -o smoothed.csv --groups")
    assert done.returncode == 2 and "--groups without --report" in done.stderr


@pytest.mark.slow
def test_the_command_writes_the_page(here):
    tables = "--groups groups.csv --attention attention.csv --places places.csv --forecast forecast.csv"
    done = graphtrack(f"report tracks.csv -o report.html --observations tracks.csv {tables} --title Standing")
    assert done.returncode == 0 and "wrote report.html" in done.stderr, done.stderr
    page = (here / "report.html").read_text(encoding="utf-8")
    for words in ("<title>Standing</title>", ">Groups<", ">Gaze<", ">Forecasts<", 'data-layer="fans"'):
        assert words in page
    gt.write_report("again.html", gt.read("tracks.csv"), groups="groups.csv", title="Standing")
    assert ">Groups<" in (here / "again.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("groups", "conversing", "dancing", "line 2, column kind: found 'dancing', expected one of nothing"),
        ("groups", ",0.9,", ",1.9,", "line 2, column probability: found '1.9', expected a probability"),
        ("groups", "probability", "sureness", None),
        ("groups", "track_id", "who", "no column track_id"),
        (
            "groups",
            "\n0,0,2,",
            "\n0,0,1,",
            "column track_id: found '1', expected each person and target once",
        ),
        ("groups", "\n0,0,2,", "\n0,0,7,", "groups of person 7, expected people of the tracks"),
        ("attention", "person", "persons", "column kind: found 'persons', expected one of person, place"),
        ("attention", '"person","2"', '"person","two"', "column target: found 'two', expected an id"),
        ("attention", '"person","2"', '"person","8"', "gaze at person 8, expected people of the tracks"),
        ("attention", ",0.6", ",", "column probability: found an empty cell, expected a finite number"),
        ("places", ",0.5", ",", "places.csv, line 2: found place 'bar' with neither radius nor polygon"),
        ("forecast", "\n1,0,0,", "\n1,33,0,", "forecasts of person 1 in frame 33, expected frames"),
    ],
)
def test_bad_tables_end_with_a_line(here, name, old, new, words):
    path = here / f"{name}.csv"
    text = path.read_text(encoding="utf-8")
    assert old in text, text[:300]
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    done = graphtrack(f"report tracks.csv -o report.html --{name} {name}.csv")
    if words is None:
        assert done.returncode == 0, done.stderr
        return
    assert done.returncode == 2 and words in " ".join(done.stderr.split()), done.stderr
    assert f"{name}.csv" in done.stderr and not (here / "report.html").exists()
