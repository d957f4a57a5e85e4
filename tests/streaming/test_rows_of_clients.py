"""Rows as clients write them: text identities, no frame numbers, dates, NaN, and clocks that are set back."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import run
from rows_of_streams import Row, each, flat, resumed, settings_of, stream, walkers

from graphtrack.interaction.people import Place
from graphtrack.streaming.behaviour import Asked

NAMES = ("9b1d-44", "Zoë")
GROUPS = Asked(True, True, (Place("bar", np.array([[1.0, 3.0]]), 0.5),))


def named(rows: list[Row]) -> list[Row]:
    return [{**row, "track_id": NAMES[row["track_id"]]} for row in rows]


def numbered(answers: list[Row]) -> list[Row]:
    """Return answers with the numbers of `walkers` for `NAMES`."""
    number = dict(zip(NAMES, range(2), strict=True))
    found = [{**row, "track_id": number[row["track_id"]]} for row in answers]
    for row in found:
        if "attention" in row:
            row["attention"] = [
                {**one, "target": number.get(one["target"], one["target"])} for one in row["attention"]
            ]
    return found


def test_people_with_text_identities_have_the_answers_of_numbers_in_groups_and_gaze_too() -> None:
    rows = [{**row, "head_deg": 90.0 - 180.0 * row["track_id"]} for row in walkers(8, True, step=0.4)]
    plain, texts = (stream(True, asked=GROUPS, horizon=(0.8, 0.4)) for _ in range(2))
    expected = flat(each(plain, rows)) + plain.finish()
    found = flat(each(texts, named(rows))) + texts.finish()
    assert {target["target"] for row in found for target in row.get("attention", ())} >= set(NAMES)
    assert numbered(found) == expected


@pytest.mark.parametrize("stop", [3, 8])
def test_text_identities_go_on_in_a_resumed_stream(stop: int, tmp_path: Path) -> None:
    rows = named(walkers(8, True))
    whole = flat(each(stream(True), rows))
    assert resumed(True, rows, [stop], tmp_path) == whole
    assert {row["track_id"] for row in whole} == set(NAMES)


@pytest.mark.slow
def test_texts_of_forgotten_people_are_forgotten() -> None:
    people = stream(True)
    for k in range(3000):
        row = {"track_id": f"person {k}", "frame": k, "t": 2.0 * k, "x": 0.0, "y": 0.0}
        (answer,) = people.answers(k + 1, json.dumps(row).encode())
        assert answer["track_id"] == f"person {k}" and answer["status"] == "new"
    assert len(json.dumps(people.shared_state())) < 30_000


@pytest.mark.parametrize("text", ["", "x" * 201])
def test_an_empty_or_endless_identity_is_an_error(text: str) -> None:
    (answer,) = flat(each(stream(True), [{"track_id": text, "frame": 0, "t": 0.0, "x": 0.0, "y": 0.0}]))
    assert "text of up to 200 characters" in answer["error"] and answer["track_id"] is None


def test_rows_without_frame_numbers_are_numbered_by_their_times() -> None:
    rows = walkers(6, True)
    bare = [{name: value for name, value in row.items() if name != "frame"} for row in rows]
    assert flat(each(stream(True), bare)) == flat(each(stream(True), rows))
    (answer,) = flat(each(stream(True), [{"track_id": 1, "x": 0.0, "y": 0.0}]))
    assert "neither t nor frame" in answer["error"]


def test_nan_is_not_observed_and_infinity_is_an_error() -> None:
    rows = walkers(6, True)
    rows[4] |= {"x": float("nan"), "y": float("nan")}
    empty = [*rows[:4], {**rows[4], "x": None, "y": None}, *rows[5:]]
    assert flat(each(stream(True), rows)) == flat(each(stream(True), empty))
    (answer,) = flat(each(stream(True), [{**rows[0], "x": float("inf")}]))
    assert "a finite number" in answer["error"]


@pytest.mark.slow
@pytest.mark.parametrize("zone", ["Z", "+02:00", ""])
def test_dates_come_back_as_they_were_written(zone: str, cwd: Path) -> None:
    rows = walkers(6, True)
    dated = [{**row, "t": f"2026-11-28T23:59:59{row['t']:.1f}".replace("590", "59") + zone} for row in rows]
    options = ("track", "-", "--model", "position", "--state", "s.state")
    found = []
    for part in (dated[:5], dated[5:]):  # the second resumes
        done = run(*options, program="graphtrack", rows=part)
        assert done.returncode == 0, done.stderr
        found += [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["t"] for row in found] == [row["t"] for row in dated]
    expected = flat(each(replace(settings_of(), lag=2.0).people(), rows))
    assert [row["x"] for row in found] == pytest.approx([row["x"] for row in expected], abs=1e-6)


kinds = pytest.mark.parametrize("identified", [True, False], ids=["identities", "detections"])


@pytest.mark.slow
@kinds
@pytest.mark.parametrize("back", [1.5, 9.0, 30.0])
def test_a_clock_that_is_set_back_by_more_than_the_lag_begins_again(identified: bool, back: float) -> None:
    """As after the restart of a simulator or a robot; the lag is one second."""
    notes: list[str] = []
    before, after = walkers(12, identified, start=back), walkers(12, identified, start=0.0)
    people = stream(identified, notes)
    found = each(people, before)
    again = each(people, after)
    fresh = stream(identified)
    expected = each(fresh, after)
    assert any("the stream begins again" in note for note in notes)
    assert not any("error" in row for row in flat(again))
    if identified:
        assert [row["status"] for row in flat(again[:2])] == ["too-late"] * 2
        assert again[2:] == expected[2:]
    else:
        people_of = [row for row in flat(again) if "track_id" in row]
        known = {row["track_id"] for row in flat(found) if "track_id" in row}
        assert len(people_of) >= 2 * 10 and known.isdisjoint(
            row["track_id"] for row in people_of if row["t"] < back - 0.5
        )


def test_new_people_after_a_clock_that_is_set_back_begin_the_stream_again() -> None:
    notes: list[str] = []
    people = stream(True, notes)
    each(people, walkers(12, True, start=20.0))
    after = [{**row, "track_id": row["track_id"] + 7} for row in walkers(12, True)]
    again = each(people, after)
    assert any("the stream begins again" in note for note in notes)
    assert again[2:] == each(stream(True), after)[2:]
    assert set(people.members) == {7, 8}


def interleaved(first: list[Row], second: list[Row], delay: int) -> list[Row]:
    rows = []
    for k, one in enumerate(first):
        rows += [one, *second[max(k - delay, 0) : max(k - delay + 1, 0)]]
    return rows


def test_delayed_rows_between_rows_in_order_begin_nothing_again() -> None:
    """Rows of one of two sensors come three seconds later, and those of one of two people in single rows."""
    notes: list[str] = []
    of_person = walkers(60, True)
    first, second = of_person[::2], of_person[1::2]
    people = stream(True, notes)
    found = flat(each(people, interleaved(first, second, 30)))
    assert not notes and {row["status"] for row in found} == {"new"}
    notes.clear()
    late = [{**row, "sensor": "slow"} for row in first]
    found = flat(each(stream(True, notes), interleaved(first, late, 30)))
    assert not any("again" in note for note in notes)
    assert [row["status"] for row in found if row.get("sensor") != "slow"].count("new") >= len(first)


def test_a_burst_of_a_slow_sensor_begins_nothing_again() -> None:
    notes: list[str] = []
    fast = [{**row, "sensor": "fast"} for row in walkers(80, True)[::2]]
    slow = [{**row, "sensor": "slow"} for row in fast[:40]]
    people = stream(True, notes)
    each(people, fast[:60] + slow[:20] + fast[60:] + slow[20:])
    assert not notes and set(people.members) == {0}


def with_poses(rows: list[Row]) -> list[Row]:
    """Rows of a sensor that drives along x, with a pose before the rows of each time."""
    found: list[Row] = []
    for row in rows:
        if not found or found[-1]["t"] != row["t"]:
            t = row["t"]
            found.append({"pose": True, "t": t, "x": 0.1 * row["frame"], "y": 0.0, "yaw_deg": 0.0})
        found.append({**row, "x": row["x"] - 0.1 * row["frame"]})
    return found


def test_poses_begin_again_with_the_rows() -> None:
    """After a while answers are those of a stream that began there."""
    notes: list[str] = []
    people = stream(True, notes)
    each(people, with_poses(walkers(20, True, start=30.0)))
    after = with_poses(walkers(30, True))
    again = flat(each(people, after))
    fresh = flat(each(stream(True), after))
    assert sum("the stream begins again" in note for note in notes) == 2  # of the poses, and of the rows
    late = [row for row in again if "status" in row and 2.0 < row["t"] < 10.0]
    expected = {(row["track_id"], row["t"]): row for row in fresh if "status" in row}
    assert len(late) > 15
    for row in late:
        known = expected[row["track_id"], row["t"]]
        assert (row["x"], row["y"]) == pytest.approx((known["x"], known["y"]), abs=0.05)
