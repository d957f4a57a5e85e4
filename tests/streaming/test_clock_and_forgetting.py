"""Clocks that jump, and what streams keep while people, streams and time come and go."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import run
from hypothesis import given, settings
from hypothesis import strategies as st
from rows_of_streams import Row, each, flat, resumed, stream, walkers
from selection import others_slow

import graphtrack as gt
from graphtrack.forecasting import paths
from graphtrack.interaction.people import Place
from graphtrack.io.formats.ndjson import NOT_USED
from graphtrack.streaming import answers as of_streams
from graphtrack.streaming.answers import StreamBounds, TrackAnswers
from graphtrack.streaming.behaviour import Asked
from graphtrack.streaming.session import Answers

ALL = Asked(True, True, (Place("bar", np.array([[1.0, 3.0]]), 0.5),))

kinds = pytest.mark.parametrize("identified", [True, False], ids=["identities", "detections"])
far = st.floats(60.001, 1e10) | st.sampled_from([1e10, 3600.0, 86_400.0])


@pytest.mark.slow
@kinds
@settings(max_examples=4)
@given(
    place=st.integers(1, 19),
    jump=far,
    back=st.booleans(),
    rows=st.integers(1, 3),
    start=st.sampled_from([0.0, -50.0, 1.7e9]),
)
def test_rows_of_one_implausible_time_change_nothing(
    identified: bool, place: int, jump: float, back: bool, rows: int, start: float
) -> None:
    usual = walkers(10, identified, start=start)
    t = usual[place]["t"] + (-jump if back else jump)
    t = min(max(t, -1e10), 1e10)
    strange = [{**usual[place], "t": t} | ({"track_id": 5 * i} if identified else {}) for i in range(rows)]
    notes: list[str] = []
    found = each(stream(identified, notes), [*usual[:place], *strange, *usual[place:]])
    told = flat(found[place : place + rows])
    assert [row["status"] for row in told] == ["unconfirmed"] * rows
    expected = each(stream(identified), usual)
    assert found[:place] + found[place + rows :] == expected
    assert len(notes) == 1 and "unconfirmed until the next row agrees" in notes[0]


@kinds
def test_a_plausible_row_discards_the_rows_that_wait(identified: bool) -> None:
    usual = walkers(10, identified)
    strange = [{**usual[7], "t": 1e6 + later} for later in (0.0, 0.1)]
    found = each(stream(identified), [*usual[:7], strange[0], *usual[7:10], strange[1]])
    assert [row["status"] for row in (*found[7], *found[-1])] == ["unconfirmed"] * 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("identified", "to"),
    others_slow(
        [(identified, to) for identified in (True, False) for to in (-300.0, 3.0 - 86_400.0, 500.0)],
        [(True, -300.0), (True, 500.0), (False, 3.0 - 86_400.0), (False, 500.0)],
    ),
)
def test_a_second_row_begins_the_stream_again_and_it_is_said(identified: bool, to: float) -> None:
    notes: list[str] = []
    before, after = walkers(12, identified), walkers(12, identified, start=to)
    people = stream(identified, notes)
    found = each(people, before) + each(people, after) + [people.finish()]
    first = stream(identified)
    assert flat(found[: len(before)]) == flat(each(first, before))
    again, (_, note) = found[len(before) :], notes
    assert "time jumped from 1.1 s to" in note
    assert ("the stream begins again" in note) == (to < 0.0)
    # Both rows of the first frame wait; the next row is a witness, from which all are used.
    assert [row["status"] for row in flat(again[:2])] == ["unconfirmed"] * 2
    fresh = stream(identified)
    expected = [*each(fresh, after), fresh.finish()]
    if identified:
        assert again[2:] == expected[2:]
    elif to < 0.0:
        known = {row["track_id"] for row in flat(found[: len(before)]) if "track_id" in row}
        shifted = [without_ids(row) for row in flat(again[2:])]
        assert shifted == [*map(without_ids, first.finish()), *map(without_ids, flat(expected))]
        people = [row for row in flat(again) if "track_id" in row]
        assert known and known.isdisjoint(row["track_id"] for row in people if row["t"] < 0.0)


def without_ids(row: Row) -> Row:
    """Return a row without track ids, which go on where a stream begins again."""
    revised = [{**one, "before": 0, "after": 0} for one in row.get("revised", ())]
    return {**row, "track_id": 0, "revised": revised}


def test_a_clock_that_goes_back_begins_the_frames_of_groups_again() -> None:
    people = stream(True, asked=ALL, horizon=(0.8, 0.4))
    rows = [*walkers(8, True, start=400.0, step=0.4), *walkers(8, True, step=0.4)]
    found = flat(each(people, rows)) + people.finish()
    times = [row["t"] for row in found if "group" in row]
    expected = [400.0 + 0.4 * k for k in range(8)] + [0.4 * k for k in range(8)]
    np.testing.assert_allclose(sorted(set(times), key=times.index), expected)


@kinds
@pytest.mark.parametrize("stop", others_slow(range(18, 27), [20, 21]))
def test_a_jump_and_its_witness_may_be_in_two_runs(identified: bool, stop: int, tmp_path: Path) -> None:
    rows = [*walkers(10, identified, start=500.0), *walkers(10, identified)]
    whole = flat(each(stream(identified), rows))
    assert resumed(identified, rows, [stop], tmp_path) == whole


# -- forgetting ----------------------------------------------------------------------------------------------


def coming_and_going(seed: int, frames: int, *, streams: bool, step: float = 0.5) -> list[Row]:
    """Rows of people, or streams of one person, who come, stay for a while, pause, and are replaced."""
    rng = np.random.default_rng(seed)
    leaves = np.zeros(3)
    names = np.arange(3)
    rows: list[Row] = []
    for k in range(frames):
        for i in range(3):
            if k >= leaves[i]:
                leaves[i], names[i] = k + rng.integers(3, 30), names.max() + 1
            name = int(names[i]) if rng.random() < 0.9 else int(rng.integers(names.max() + 1))  # some return
            if rng.random() < 0.3:
                continue
            x, y = rng.normal((0.3 * (k % 20), 4.0 * i), 0.05).tolist()
            row = {"stream": f"s{name}"} if streams else {"track_id": name}
            rows.append({**row, "frame": k, "t": round(step * k, 6), "x": x, "y": y})
    return rows


@pytest.mark.slow
@kinds
@pytest.mark.parametrize("seed", others_slow(range(4), [0]))
def test_forgetting_is_the_same_in_a_resumed_stream(identified: bool, seed: int, tmp_path: Path) -> None:
    rows = coming_and_going(seed, 60 if identified else 36, streams=not identified)
    bounds = StreamBounds(forget_after=4.0)
    people = stream(identified, bounds=bounds)
    whole = flat(each(people, rows))
    stops = sorted(np.random.default_rng(seed).choice(len(rows) - 1, 6, replace=False) + 1)
    assert resumed(identified, rows, list(map(int, stops)), tmp_path, bounds=bounds) == whole
    if identified:
        assert sum(row["status"] == "new" for row in whole) > 50


def test_a_person_who_returns_after_being_forgotten_is_new() -> None:
    rows = walkers(60, True, step=0.2)
    kept = [row for row in rows if row["track_id"] == 0 or not 3.0 < row["t"] < 8.0]
    back = next(k for k, row in enumerate(kept) if row["track_id"] == 1 and row["t"] > 3.0)
    for after, is_new in ((4.0, True), (60.0, False)):
        found = flat(each(stream(True, bounds=StreamBounds(forget_after=after)), kept))[back:]
        alone = [row for row in kept[back:] if row["track_id"] == 1]
        fresh = flat(each(stream(True), alone))
        assert ([row for row in found if row["track_id"] == 1] == fresh) == is_new


OPTIONS: dict[str, dict[str, Any]] = {"plain": {}, "everything": {"asked": ALL, "horizon": (0.8, 0.4)}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "option"),
    others_slow(
        [(kind, option) for kind in ("people", "streams", "detections") for option in OPTIONS],
        [("people", "everything"), ("streams", "plain"), ("detections", "everything")],
    ),
)
def test_what_is_kept_is_bounded_while_people_streams_and_time_go_on(
    kind: str, option: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(paths, "_CAPACITY", 64)  # anchors of forecasts, 4,096 at most
    people = stream(kind == "people", bounds=StreamBounds(forget_after=5.0), **OPTIONS[option])
    frames = 64 if kind == "streams" else 120
    rows = coming_and_going(1, frames, streams=kind == "streams", step=1.0)
    if kind == "detections":
        rows = [{key: value for key, value in row.items() if key != "track_id"} for row in rows]
    sizes, most = [], 0
    for number, row in enumerate(rows, 1):
        people.answers(number, json.dumps(row).encode())
        if number * 8 % len(rows) < 8:
            states = [one.state() for one in people.members.values()]
            sizes.append(len(json.dumps([people.shared_state(), *states])))
            most = max(most, len(people.members))
    # Evidence of groups and gaze is kept for 100 s, and scenes are learned from the last 3,200 detections.
    assert max(sizes[4:]) < 1.6 * max(sizes[:4])
    assert most <= 3 * 5 * 2
    if kind != "people":
        assert people.count < 60


@pytest.mark.slow
def test_the_greatest_track_id_outlives_a_forgotten_stream() -> None:
    people = stream(False, bounds=StreamBounds(forget_after=5.0))
    rows = [{**row, "stream": "a"} for row in walkers(20, False)]
    rows += [{**row, "stream": "b"} for row in walkers(20, False, start=900.0, step=0.4)]
    rows += [{**row, "stream": "a"} for row in walkers(20, False, start=950.0)]
    found = flat(each(people, rows)) + people.finish()
    by_stream = [row for row in found if row["stream"] == "a" and "track_id" in row]
    early, late = (
        {one["track_id"] for one in by_stream if (one["t"] > 900.0) == is_late} for is_late in (0, 1)
    )
    assert early and late and early.isdisjoint(late)


@pytest.mark.slow
def test_streams_with_clocks_of_their_own_are_forgotten_by_what_elapses() -> None:
    """A clip after the other, each from 0 on, and one stream that goes on all the time at another time."""
    people = stream(False, bounds=StreamBounds(forget_after=5.0))
    most = 0
    for clip in range(6):
        for row in walkers(10, False, step=0.2):
            people.answers(1, json.dumps({**row, "stream": f"clip{clip}"}).encode())
        live = {"t": 1e6 + 2.0 * clip, "x": 0.0, "y": 0.0, "stream": "live"}
        people.answers(1, json.dumps(live).encode())
        most = max(most, len(people.members))
        assert "live" in people.members
    assert most <= 5


# -- bounds by number, where no time goes by -----------------------------------------------------------------


def test_people_streams_and_detections_of_one_time_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of_streams, "MOST_DETECTIONS", 7)
    bounds = StreamBounds(people=5, streams=5)
    cases = {
        "people": [{"track_id": k, "frame": 0, "t": 0.0, "x": 0.0, "y": 0.0} for k in range(9)],
        "streams": [{"stream": f"s{k}", "t": 0.0, "x": 0.0, "y": 0.0} for k in range(9)],
        "detections": [{"t": 0.0, "x": float(k), "y": 0.0} for k in range(9)],
    }
    for kind, rows in cases.items():
        people = stream(kind == "people", bounds=bounds)
        errors = [row["error"] for row in flat(each(people, rows)) if "error" in row]
        most = 7 if kind == "detections" else 5
        assert len(errors) == 9 - most and all(f"one more than {most} {kind}" in one for one in errors)
        assert len(people.members) <= 5


@kinds
def test_rows_that_wait_are_bounded(identified: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of_streams, "MOST_DETECTIONS", 7)
    people = stream(identified, bounds=StreamBounds(people=7))
    strange = [{"track_id": k} if identified else {} for k in range(30)]
    rows = [{**one, "frame": 5, "t": 1e9, "x": 0.0, "y": 0.0} for one in strange]
    each(people, [*walkers(2, identified), *rows])
    clock = people.clock if isinstance(people, TrackAnswers) else people.members[""].clock
    assert len(clock.waiting) == 7


def test_options_of_streams_are_refused_with_a_file(cwd: Path) -> None:
    (cwd / "tracks.csv").write_text("track_id,frame,t,x,y\n1,0,0,0,0\n")
    for option in ("--forget-after", "--max-people"):
        done = run("track", "tracks.csv", "-o", "out.csv", option, "9", program="graphtrack")
        assert done.returncode == 2 and f"{option} with a file" in done.stderr


@pytest.mark.slow
def test_the_command_says_that_a_stream_begins_again(cwd: Path) -> None:
    rows = [*walkers(5, True, start=200.0), *walkers(5, True)]
    done = run("track", "-", "--model", "position", program="graphtrack", rows=rows)
    assert done.returncode == 0
    assert "note: time jumped from 200.4 s to 0 s: the stream begins again" in done.stderr


@pytest.mark.slow
@kinds
def test_answers_to_unconfirmed_rows_are_no_rows_of_a_table(identified: bool, cwd: Path) -> None:
    usual = walkers(10, identified)
    strange = {**usual[7], "t": 1e9} | ({"track_id": 99} if identified else {})
    for name, rows in (("usual", usual), ("strange", [*usual[:7], strange, *usual[7:]])):
        done = run("track", "-", "--model", "position", program="graphtrack", rows=rows)
        (cwd / f"{name}.ndjson").write_text(done.stdout)
    one, other = (gt.read(f"{name}.ndjson") for name in ("usual", "strange"))
    assert one.to_table().equals(other.to_table())
    assert other.summary.refused.get(NOT_USED, 0) == int(identified)


@pytest.mark.parametrize("sensor", ["", "gate"])
def test_a_second_row_that_contradicts_the_first_has_one_note(sensor: str) -> None:
    """A third observation that agrees has no reason; in Python there is one warning."""
    rows = [{"track_id": 1, "t": k / 10, "x": k / 10, "y": 0.0, "pos_std": 0.02} for k in range(20)]
    rows = [{**row, "sensor": sensor} for row in rows] if sensor else rows
    near = {**rows[15], "x": rows[15]["x"] + 0.01} | ({"sensor": "other"} if sensor else {})
    far = [{**near, "x": near["x"] + 5.0 + n, "t": rows[k]["t"]} for n, k in enumerate((10, 12))]
    mixed = [*rows[:11], far[0], *rows[11:13], far[1], *rows[13:16], near, *rows[16:]]
    notes: list[str] = []
    answers = flat(each(Answers(gt.Model("joint")).people(notes.append), mixed))
    moved = [k for k, row in enumerate(answers) if "reason" in row]
    assert moved == [11, 14] and all("1 ms later" in answers[k]["reason"] for k in moved)
    assert len(notes) == 1 and "1 ms later" in notes[0] and answers[18]["status"] == "late"
    smoother = gt.OnlineSmoother()
    with pytest.warns(gt.InputWarning, match="1 ms later") as warned:
        for row in mixed:
            place = row["x"], row["y"]
            of_row = gt.Observation(row["t"], position=place, position_std=0.02, sensor=row.get("sensor", ""))
            estimate = smoother.update(of_row)
            assert bool(estimate.reason) == (row in far)
            assert smoother.last is not None and not smoother.last.reason
    assert len(warned) == 1


@pytest.mark.parametrize("model", ["position", "joint", "social"])
def test_a_reset_begins_as_a_new_one_does(model: str) -> None:
    """To the last bit, at an earlier time, with the options; people get track ids that were not used."""
    rng = np.random.default_rng(7)
    place = np.cumsum(rng.normal(0.1, 0.02, (15, 2)), axis=0)
    observed = [gt.Observation(0.1 * k, position=tuple(one), head=0.2) for k, one in enumerate(place)]

    def states(smoother: gt.OnlineSmoother) -> list[str]:
        found = map(smoother.update, observed)
        return [str([one.status, *one.position, *one.covariance.ravel()]) for one in found]

    constants = None if model == "joint" else "default"
    smoother = gt.OnlineSmoother(model, lag=1.0, constants=constants)
    first = states(smoother)
    assert smoother.update(replace(observed[0], t=-9.0)).status == "too-late"
    smoother.reset()
    assert smoother.last is None and smoother.lag == 1.0
    assert states(smoother) == first

    def people(tracker: gt.OnlineTracker) -> list[Any]:
        found = [tracker.update(0.1 * k, [one, np.add(one, (4.0, 1.0))]) for k, one in enumerate(place)]
        return [[(one.track_id, *one.position, one.detection) for one in some] for some in found]

    options: dict[str, Any] = {"scene": {"clutter_density": 1e-4}, "lag": 1.0, "constants": constants}
    tracker = gt.OnlineTracker(model, **options)
    before = people(tracker)
    used = {one[0] for some in before for one in some}
    with pytest.raises(gt.InputError, match="a time in seconds"):
        tracker.update(0.0, [])
    tracker.reset()
    again = people(tracker)
    shift = min(one[0] for some in again for one in some) - min(used)
    assert shift > max(used) - min(used)
    assert [[(one[0] - shift, *one[1:]) for one in some] for some in again] == before
