"""The replay's data, and the page's scripts that touch no page, run in node."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import observed, scene, walker
from page_scripts import decoded, delta_decode, in_node

from graphtrack.geometry.angles import difference, wrap
from graphtrack.report.html import packed
from graphtrack.report.lives import pair_tracks
from graphtrack.report.replay import ANGLE_STEP, LENGTH_STEP, TIME_STEP, delta_code, replay_data, thin
from graphtrack.report.style import probability_ellipse
from graphtrack.tracks.track import TrackSet


def data_of(*tracks, **options):
    return replay_data(pair_tracks(TrackSet(tracks)), **options)


def test_the_page_unpacks_what_python_packed():
    data = replay_data(pair_tracks(*scene(people=3)))
    assert in_node(("replay_data.js",), f"return unpack({packed(data)!r});") == json.loads(json.dumps(data))


def steps(data, count, start=0.0):
    """The times that `count` steps on and as many back lead to."""
    code = f"""{decoded(data)}
    const times = sampleTimes(people), on = [{start}], back = [];
    for (let k = 0; k < {count}; k++) on.push(stepTime(times, data.frame, on[on.length - 1], 1));
    back.push(on[on.length - 1]);
    for (let k = 0; k < {count}; k++) back.push(stepTime(times, data.frame, back[back.length - 1], -1));
    return [on, back];"""
    on, back = in_node(("replay_data.js",), code)
    return np.array(on), np.array(back)


@pytest.mark.parametrize("hz", [1 / 3, 2.5, 10.0, 25.0])
def test_a_step_of_the_replay_is_a_frame_of_the_data(hz):
    on, back = steps(data_of(walker(hz=hz, n=30)), 12)
    assert on == pytest.approx(np.arange(13) / hz, abs=1e-3)
    assert back == pytest.approx(on[::-1])


def test_a_step_stops_at_the_ends_and_goes_to_a_frame_from_in_between():
    data = data_of(walker(hz=2.5, n=3))
    on, back = steps(data, 5)
    assert on == pytest.approx([0, 0.4, 0.8, 0.8, 0.8, 0.8], abs=1e-3)
    assert back == pytest.approx([0.8, 0.4, 0, 0, 0, 0], abs=1e-3)
    assert steps(data, 1, start=0.3)[0] == pytest.approx([0.3, 0.4], abs=1e-3)


def test_with_mixed_rates_a_step_is_the_next_frame_of_anybody():
    quick, slow = walker(1, hz=25.0, n=11), walker(2, hz=2.5, n=4)
    on, back = steps(data_of(quick, slow), 12)
    assert on == pytest.approx([*np.arange(11) * 0.04, 0.8, 1.2], abs=1e-3)
    assert back == pytest.approx(on[::-1])


PEOPLE = [
    {"id": "1", "label": "Anna"},
    {"id": "2", "label": ""},
    {"id": "12", "label": "left Hall"},
    {"id": "120", "label": "right hall"},
    {"id": "P05", "label": "", "number": "7"},
]


def test_people_are_found_by_whole_ids_and_parts_of_labels():
    found = {
        "": [0, 1, 2, 3, 4],
        "  ,": [0, 1, 2, 3, 4],
        "p05": [4],
        "7": [4],
        "12": [2],
        "1, 2": [0, 1],
        "HALL": [2, 3],
        "anna, 120": [0, 3],
        "12 left hall": [2],
        "nobody": [],
    }
    code = f"""const people = {json.dumps(PEOPLE)};
    people.forEach((p) => {{ p.name = p.id + (p.label ? " " + p.label : ""); p.number = p.number || p.id; }});
    const found = {json.dumps(list(found))}.map((words) => [words, findPeople(people, words)]);
    return Object.fromEntries(found);"""
    assert in_node(("people.js",), code) == found


def test_pages_hold_everything_once():
    code = """return [0, 1, 24, 25, 300].map((count) => {
      const first = pageOf(count, 24, 0), seen = [];
      for (let page = 0; page < first.pages; page++) {
        const p = pageOf(count, 24, page);
        for (let i = p.from; i < p.to; i++) seen.push(i);
      }
      const whole = seen.length === count && seen.every((x, i) => x === i);
      return [whole, pageOf(count, 24, 99).page === first.pages - 1];
    });"""
    assert in_node(("people.js",), code) == [[True, True]] * 5


def test_gaps_of_an_angle_are_from_the_sample_before_to_the_one_after():
    seen = [None, None, None, 1.0, None, None, 1.0, None, None, None, 1.0, None, None, None]
    code = f"""const seen = {json.dumps(seen)}.map((x) => (x === null ? NaN : x)), t = seen.map((_, i) => i);
    return [unseenSpans(t, seen), unseenSpans(t, t.map(() => NaN))];"""
    assert in_node(("angles_draw.js",), code) == [[[0, 3], [6, 10], [10, 13]], []]


def test_who_is_chosen_is_shown_and_everybody_hears_of_it():
    code = """const crowd = createCrowd([{ id: "7", shown: true }, { id: "8", shown: true }]);
    let heard = 0; crowd.onChange(() => { heard += 1; });
    crowd.showOnly([0]); const hidden = crowd.people[1].shown;
    crowd.choose(crowd.indexOf("8"));
    return [hidden, crowd.people[1].shown, crowd.chosen, heard, crowd.indexOf("9")];"""
    assert in_node(("people.js",), code) == [False, True, 1, 2, -1]


def test_the_pointer_finds_people_then_paths():
    t = np.arange(11) / 10.0

    def line(track_id, y, later=0.0):
        return walker(track_id, n=11, t=t + later, position=np.stack([t, np.full(11, y)], axis=1))

    code = f"""{decoded(data_of(line(1, 0.0), line(2, 1.0, later=5.0), line(3, 2.0)))}
    people[2].shown = false;
    const at = (x, y, everything) => pickPerson(people, x, y, 0.6, 0.3, everything, 0.01);
    return [at(0.62, 0.05, false), at(0.4, 0.03, false), at(0.1, 0, false), at(0.1, 0, true),
            at(0.5, 1.02, false), at(0.5, 1.02, true), at(0.6, 2, true), at(0.6, 0.5, true)];"""
    person, trail, behind, whole, absent, path, hidden, nowhere = in_node(
        ("replay_data.js", "replay_pick.js"), code
    )
    assert person == {"index": 0, "time": 0.6}
    assert trail == {"index": 0, "time": pytest.approx(0.4)}
    assert behind is None and whole == {"index": 0, "time": pytest.approx(0.1)}
    assert absent is None and path == {"index": 1, "time": pytest.approx(5.5)}
    assert hidden is None and nowhere is None


ROWS = [["10", "b"], ["9", "–"], ["–", "a"], ["-1.5", "b"]]


def test_tables_sort_numbers_as_numbers_with_dashes_last():
    code = f"""const rows = {json.dumps(ROWS)};
    return [[0, 1], [0, -1], [1, 1]].map(([column, way]) => sortedRows(rows, column, way));"""
    assert in_node(("tables.js",), code) == [[3, 1, 0, 2], [0, 1, 3, 2], [2, 0, 3, 1]]


def test_tables_find_whole_numbers_and_parts_of_words():
    found = {"": [0, 1, 2, 3], " B": [0, 3], "1": [], "9, a": [1, 2]}
    code = f"""const words = {json.dumps(list(found))}, rows = {json.dumps(ROWS)};
    return Object.fromEntries(words.map((w) => [w, filteredRows(rows, w)]));"""
    assert in_node(("tables.js",), code) == found


def test_the_chart_draws_angles_without_jumps_and_once_in_every_turn():
    rng = np.random.default_rng(0)
    angle = wrap(np.cumsum(rng.normal(0.4, 0.5, 60)))
    values = [None if 20 <= i < 25 else float(a) for i, a in enumerate(angle)]
    code = f"""const angle = {json.dumps(values)}.map((x) => (x === null ? NaN : x));
    const t = angle.map((_, i) => i / 10 + (i >= 40 ? 9 : 0));
    const path = unwrapped(Float64Array.from(angle)), runs = knownRuns(t, path, 0.5);
    const low = Math.min(...path.filter(Number.isFinite)), high = Math.max(...path.filter(Number.isFinite));
    return [Array.from(path), runs, low, high, turnsInSight(low, high)];"""
    path, runs, low, high, turns = in_node(("replay_data.js", "angles_draw.js"), code)
    assert runs == [[0, 19], [25, 39], [40, 59]]  # unknown values, and a gap, end a run
    known = np.array([x for x in path if x is not None])
    assert known == pytest.approx(np.unwrap([a for a in values if a is not None]))
    for k in range(-20, 21):
        assert (k in turns) == (high + 2 * np.pi * k >= -np.pi and low + 2 * np.pi * k <= np.pi)


def test_what_the_chart_says_in_words():
    person = walker(4, n=30, hz=10.0)
    data = replay_data(pair_tracks(TrackSet((person,)), TrackSet((observed(person, slice(0, 5)),))))
    code = f"{decoded(data)} return [0, 1, 99].map((t) => anglesInWords(people[0], t));"
    unseen, seen, later = in_node(("replay_data.js", "angles_draw.js"), code)
    body, head = np.degrees(person.body[10]), np.degrees(person.head[10])
    assert f"body {body:.0f}° ± 8° (observed" in seen.replace("−", "-")
    assert f"head {head:.0f}° ± 10° (truth {head:.0f}°)" in seen.replace("−", "-")
    assert "observed" not in unseen
    assert later == "99.00 s: not there (0.0 to 2.9 s)"


numbers = st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=40)


@given(numbers)
def test_codes_bring_back_every_value_to_half_a_step(values):
    values = np.array(values)
    back = delta_decode(delta_code(values, LENGTH_STEP), LENGTH_STEP, len(values))
    assert np.array_equal(np.isnan(back), np.isnan(values))
    known = np.isfinite(values)
    assert np.all(np.abs(back - values)[known] <= LENGTH_STEP / 2 + 1e-9)


def decode(person, name, step):
    return delta_decode(person[name], step, len(person["t"]))


def test_the_data_survive_json_within_a_millimetre_and_a_tenth_of_a_degree():
    estimates, observations = scene(people=3, n=80)
    data = json.loads(
        json.dumps(replay_data(pair_tracks(estimates, observations), max_rate=100.0), allow_nan=False)
    )
    assert data["every"] == 1 and data["kept"] == data["of"] == 240
    for person, estimate, observation in zip(data["people"], estimates, observations, strict=True):
        assert decode(person, "t", TIME_STEP) == pytest.approx(estimate.t, abs=1e-3)
        for i, axis in enumerate("xy"):
            assert decode(person, axis, LENGTH_STEP) == pytest.approx(estimate.position[:, i], abs=1e-3)
            seen, true = (
                decode(person, f"seen_{axis}", LENGTH_STEP),
                decode(person, f"true_{axis}", LENGTH_STEP),
            )
            assert seen == pytest.approx(observation.position[:, i], abs=1e-3, nan_ok=True)
            assert true == pytest.approx(observation.true_position[:, i], abs=1e-3)
        for name in ("body", "head"):
            error = difference(decode(person, name, ANGLE_STEP), getattr(estimate, name))
            assert np.abs(error).max() <= ANGLE_STEP
            std = decode(person, f"{name}_std", ANGLE_STEP)
            assert std == pytest.approx(estimate.std(name), abs=ANGLE_STEP)
        seen_body = decode(person, "seen_body", ANGLE_STEP)
        assert np.isfinite(seen_body).tolist() == np.isfinite(observation.body).tolist()
        assert np.nanmax(np.abs(difference(seen_body, observation.body))) <= ANGLE_STEP
        ellipse = probability_ellipse(estimate.covariance[:, :2, :2])
        assert decode(person, "major", LENGTH_STEP) == pytest.approx(ellipse.semi_major, abs=1e-3)
        assert [flag == "1" for flag in person["seen"]] == np.isfinite(observation.position[:, 0]).tolist()


@given(st.lists(st.floats(0.001, 0.5), min_size=1, max_size=60), st.floats(1.0, 40.0))
def test_thinning_keeps_both_ends_and_the_rate(steps, rate):
    t = np.cumsum(steps)
    at = thin(t, rate)
    assert at[0] == 0
    assert at[-1] == len(t) - 1
    assert np.all(np.diff(at) > 0)
    intervals = np.floor(t[at[:-1]] * rate + 1e-6)
    assert len(np.unique(intervals)) == len(intervals)


def test_of_too_many_samples_one_of_every_few_frames_is_kept():
    estimates, observations = scene(people=10, n=500)
    data = replay_data(pair_tracks(estimates, observations), max_samples=1000)
    kept = sum(len(person["t"]) for person in data["people"])
    assert data["kept"] == kept <= 1000 and data["of"] == 5000
    # The last frame is always among them: every sixth leaves room for it, every fifth would not.
    assert data["every"] == 6 and data["frame"] == pytest.approx(6 / 25)
    assert set(np.diff(decode(data["people"][0], "t", TIME_STEP))[:-1].round(3)) == {0.24}


def test_absent_channels_and_people_are_absent():
    nowhere = walker(2, position=np.full((60, 2), np.nan))
    bare = walker(1, body=None, head=None, covariance=None, velocity=None)
    data = replay_data(pair_tracks(TrackSet((nowhere, bare))))
    (person,) = data["people"]
    assert person["id"] == "1"
    missing = (
        "body",
        "head",
        "body_std",
        "major",
        "vx",
        "seen",
        "seen_x",
        "seen_head",
        "true_x",
        "true_body",
    )
    assert all(person[name] is None for name in missing)


def test_the_page_shows_people_where_they_are():
    estimate = walker(4, n=60)
    jump = replace(estimate, t=np.where(np.arange(60) < 30, estimate.t, estimate.t + 10.0))
    seen = replace(observed(estimate), t=jump.t)
    data = replay_data(pair_tracks(TrackSet((jump,)), TrackSet((seen,))), max_rate=100.0)
    between = (jump.t[:-1] + jump.t[1:]) / 2.0
    code = f"""{decoded(data)} const ask = (times) => times.map((t) => stateAt(people[0], t));
    return [ask({jump.t.tolist()}), ask({between.tolist()}), ask([-1, 99])];"""
    at, halfway, outside = in_node(("replay_data.js",), code)
    assert outside == [None, None]
    for i, state in enumerate(at):
        assert [state["x"], state["y"]] == pytest.approx(jump.position[i], abs=2e-3)
        assert abs(difference(state["body"], jump.body[i])) < 0.01
        assert state["seen"] == (not 20 <= i < 35)
    for i, state in enumerate(halfway):
        if i == 29:
            assert state is None  # the hole of ten seconds
            continue
        assert [state["x"], state["y"]] == pytest.approx(jump.position[i : i + 2].mean(axis=0), abs=2e-3)
        middle = wrap(jump.body[i] + difference(jump.body[i + 1], jump.body[i]) / 2.0)
        assert abs(difference(state["body"], middle)) < 0.01
