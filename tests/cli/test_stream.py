"""Rows in, estimates out: each row of a stream, its names and units, and rows without identities."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command import run
from crossing_people import street
from hypothesis import given
from hypothesis import strategies as st

from graphtrack.constants.online import OnlineSmoother
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model import Model, Observation
from graphtrack.streaming.answers import Scenes, TrackAnswers
from graphtrack.streaming.protocol import LONGEST_LINE, StreamNames, estimate_row, with_first_row
from graphtrack.streaming.session import Answers, lines_of
from graphtrack.tracking import OnlineTracker
from graphtrack.tracks.scene import SceneParameters


def smoother(**options):
    return OnlineSmoother("joint", lag=1.0, **options)


def row(track_id, frame, **columns):
    return {"track_id": track_id, "frame": frame, **columns}


def walker(track_id, n=15):
    return [row(track_id, k, x=0.12 * k, y=float(track_id), body_deg=5.0 * track_id) for k in range(n)]


def answers(people, rows):
    return [people.answers(number, json.dumps(one).encode())[-1] for number, one in enumerate(rows, 1)]


def answer(line, fps=10.0):
    (found,) = TrackAnswers(smoother, fps).answers(1, line if isinstance(line, bytes) else line.encode())
    return found


def test_interleaved_people_do_not_touch_each_other():
    mixed = [one for pair in zip(walker(1), walker(2), strict=True) for one in pair]
    found = answers(TrackAnswers(smoother, 10.0), mixed)
    for track_id in (1, 2):
        alone = answers(TrackAnswers(smoother, 10.0), walker(track_id))
        assert [one for one in found if one["track_id"] == track_id] == alone


def test_a_row_has_the_standard_deviations_of_its_covariance_and_null_for_what_is_unknown():
    seen = smoother().update(Observation(0.0, 0, (1.0, 2.0)))
    variance = [0.04, 0.0, np.nan, 0.09, np.radians(3.0) ** 2, np.inf]
    found = estimate_row(7, replace(seen, covariance=np.diag(variance)))
    names = ("x_std", "y_std", "vx_std", "vy_std", "body_std_deg", "head_std_deg")
    assert [found[name] for name in names] == [0.2, 0.0, None, 0.3, pytest.approx(3.0), None]
    assert found["track_id"] == 7


def test_every_row_is_told_what_became_of_it():
    rows = [
        row(1, 0, head_deg=10.0),
        row(1, 1, x=0.1, y=0.0),
        row(1, 3, x=0.3, y=0.0),
        row(1, 2, x=0.2, y=0.0),
        row(1, 3, x=0.3, y=0.0),
        row(1, 0, x=0.0, y=0.0),
        row(1, 4),
    ]
    found = answers(TrackAnswers(smoother, 10.0), rows)
    expected = ["waiting", "new", "new", "late", "duplicate", "too-late", "new"]
    assert [one["status"] for one in found] == expected
    assert found[0]["x"] is None
    assert found[0]["head_std_deg"] is None
    assert [one["frame"] for one in found] == [0, 1, 3, 3, 3, 3, 4]
    assert found[3]["x"] == found[4]["x"] == found[5]["x"]
    json.dumps(found, allow_nan=False)


def test_a_row_in_pixels_alone_starts_a_person_where_the_camera_is_known():
    camera = GroundCamera.from_scale(0.01)
    rows = [row(1, k, u=100.0 + 12.0 * k, v=250.0) for k in range(10)]
    found = answers(TrackAnswers(lambda: smoother(camera=camera), 10.0), rows)
    assert {one["status"] for one in found} == {"new"}
    x, y = camera.image_to_ground([100.0 + 12.0 * 9, 250.0])
    assert found[-1]["x"] == pytest.approx(x, abs=0.1)
    assert found[-1]["y"] == pytest.approx(y, abs=0.1)
    blind = answers(TrackAnswers(smoother, 10.0), rows[:2])
    assert {one["status"] for one in blind} == {"waiting"}


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('{"frame": 1}', "column track_id: found nothing, expected a whole number"),
        ('{"track_id": 1.5, "frame": 1}', "column track_id: found 1.5, expected a whole number"),
        ('{"track_id": "", "frame": 1}', "column track_id: found '', expected a whole number"),
        (f'{{"track_id": {10**30}, "frame": 1}}', f"column track_id: found {10**30}, expected a whole"),
        ('{"track_id": true, "frame": 1}', "column track_id: found true, expected a whole number"),
        ('{"track_id": 1, "frame": 3e9}', "column frame: found 3000000000, expected a whole number"),
        ('{"track_id": 1, "frame": 1, "x": 1e10, "y": 0}', "column x: found 1e+10, expected a number within"),
        ('{"track_id": 1, "frame": 1, "x": 1e300, "y": 0}', "column x: found 1e+300, expected a number"),
        ('{"track_id": 1, "frame": 1, "x": 1e999, "y": 0}', "column x: found '1e999', expected a finite"),
        (f'{{"track_id": 1, "frame": 1, "x": {"9" * 5000}, "y": 0}}', "column x: found '9999"),
        ('{"track_id": 1, "frame": 1, "x": NaN, "y": 0}', "column x: found an empty cell, expected all of x"),
        ('{"track_id": 1, "frame": 1, "x": true, "y": 0}', "column x: found true, expected a finite number"),
        ('{"track_id": 1, "frame": 1, "x": [1], "y": 0}', "column x: found a list, expected a finite number"),
        ('{"track_id": 1, "frame": 1, "x": 1}', "column y: found an empty cell, expected all of x … y or"),
        ('{"track_id": 1, "frame": 1, "body_p0": 1}', "column body_p1: found an empty cell"),
        ('{"track_id": 1, "frame": 1, "head_deg": 1e9}', "column head_deg: found 1e+09, expected a number"),
        ('{"track_id": 1, "frame": 1, "pos_std": 0}', "column pos_std: found 0, expected a number above 0"),
        ('{"track_id": 1, "frame": 1, "label": 5}', "column label: found 5, expected text or null"),
        ('{"track_id": 1, "frame": 1, "x": 1, "y": 0, "x": 2}', "found the key 'x' twice"),
        ('{"track_id": 1, "frame": 1, "x": 1_0}', "column x: found '1_0' at character 34, expected one JSON"),
        ('{"track_id": 1, "frame": 1', "found the end of the line, expected one JSON object"),
        ("[1, 2]", "found a list, expected one JSON object"),
        ("[" * 100_000, "found brackets within brackets"),
        (b'{"track_id": 1, "frame": 1, "label": "\xff"}', "found the byte 0xff, expected UTF-8 text"),
        (b'{"track_id": 1, "label": "' + b"a" * LONGEST_LINE, "found more than 1048576 bytes"),
    ],
)
def test_a_bad_row_is_told_as_it_would_be_of_a_file(line, told):
    found = answer(line)
    assert found["error"].startswith("line 1, " + told) or found["error"].startswith("line 1: " + told)


def test_class_likelihoods_that_are_all_zero_are_refused():
    zeros = {f"head_p{k}": 0.0 for k in range(12)}
    assert "class likelihoods that are all 0" in answer(json.dumps(row(1, 0, x=0.0, y=0.0, **zeros)))["error"]
    assert "error" not in answer(json.dumps(row(1, 0, x=0.0, y=0.0, **zeros | {"head_p3": 0.1})))


def test_a_time_or_a_frame_rate_is_needed():
    line = '{"track_id": 1, "frame": 1, "x": 0, "y": 0}'
    assert "column t" in answer(line, fps=None)["error"]
    assert answer(line.replace('"x"', '"t": 0.5, "x"'), fps=None)["t"] == 0.5


def test_an_error_says_whose_row_it_was_as_far_as_it_can_be_read():
    def place(line):
        found = answer(line)
        return found["track_id"], found["frame"], found["line"]

    assert place('{"track_id": 7, "frame": 3, "x": "a", "y": 0}') == (7, 3, 1)
    assert place('{"track_id": ["a"], "frame": 3}') == (None, 3, 1)
    assert place('{"track_id": 7, "frame": 3, "frame": 4}') == (7, None, 1)
    assert place("junk") == (None, None, 1)


def test_line_numbers_count_blank_and_long_lines(tmp_path):
    text = b"\n  \n{}\n" + b"a" * (3 * LONGEST_LINE) + b"\n\n{}"
    (tmp_path / "rows").write_bytes(text)
    with (tmp_path / "rows").open("rb") as stream:
        found = [(number, line[:5]) for number, line in lines_of(stream, 11)]
    assert found == [(13, b"{}\n"), (14, b"aaaaa"), (16, b"{}")]


def test_identities_that_doubles_cannot_tell_apart_stay_apart_or_are_refused():
    lines = [f'{{"track_id": {2**53 + k}, "frame": 0, "x": 0, "y": 0}}' for k in range(-3, 3)]
    people = TrackAnswers(smoother, 10.0)
    found = [people.answers(1, line.encode())[-1] for line in lines]
    known = [one["track_id"] for one in found if "error" not in one]
    assert len(known) == len(set(known)) == len(people.members) >= 2
    assert all(str(one["track_id"]) in line for one, line in zip(found, lines, strict=True) if one in known)
    assert "error" in found[-1]


@pytest.mark.parametrize("identified", [True, False])
def test_the_pixel_of_a_position_is_no_unused_key(identified):
    """As `perception observe` writes it; of a row without a position it is one."""
    told = []
    chosen = Answers(Model("position"), lag=1.0)
    people = chosen.people(told.append) if identified else chosen.scenes(told.append)
    of_person = {"track_id": 1} if identified else {}
    for k in range(12):
        people.answers(
            k, json.dumps({**of_person, "t": k / 10, "x": k / 10, "y": 0, "u": k, "v": 5}).encode()
        )
    assert told == []
    for k in (13, 14):
        people.answers(k, json.dumps({**of_person, "t": k / 10, "u": 1, "v": 5}).encode())
    assert told == ["key 'u' is not used", "key 'v' is not used"]


def test_unknown_keys_are_told_once_and_known_ones_of_answers_never():
    told = []
    people = TrackAnswers(smoother, 10.0, told.append)
    first = {"mood": "good", "status": "new", "confidence": 1, "true_x": 0, "true_y": 0, "label": "she"}
    for one in ({**first}, {**first, "colour": [1]}, {"shape": {"a": 1}, "x": "bad"}):
        answers(people, [row(1, 0, **one)])
    assert told == ["ignored key 'mood'", "ignored key 'colour'", "ignored key 'shape'"]


def test_angles_are_the_same_in_any_turn():
    def last(turn):
        rows = [row(1, k, x=0.1 * k, y=0.0, head_deg=30.0 + turn) for k in range(5)]
        return answers(TrackAnswers(smoother, 10.0), rows)[-1]["head_deg"]

    assert last(3600.0) == pytest.approx(last(0.0), abs=1e-9)


DAY = 86_400 * 10**9


def nobody(number: int, line: bytes) -> None:
    """Refuse a line without a word."""


def test_what_is_told_within_an_answer_has_the_same_names_and_unit() -> None:
    names = StreamNames({"t": "stamp", "x": "pos_x"}, unit=10**6)
    answer = {
        "end": 1.7,
        "revised": [{"t": 0.9, "before": -1, "after": 1}],
        "forecast": [{"ahead": 0.4, "x": 2.0}],
    }
    assert names.restored(answer) == {
        "end": 1700,
        "revised": [{"stamp": 900, "before": -1, "after": 1}],
        "forecast": [{"ahead": 0.4, "pos_x": 2.0}],
    }


@pytest.mark.parametrize("unit", [1, 10**3, 10**6])
@given(first=st.integers(0, 4 * 10**18), later=st.lists(st.integers(0, 90 * DAY), min_size=2, max_size=4))
def test_whole_stamps_come_back_to_the_last_digit(unit: int, first: int, later: list[int]) -> None:
    """Also times since 1970, which a double cannot hold in nanoseconds."""
    stamps = [(first + more) // unit for more in (0, *later)]
    lines = [(0, b"no row"), *((k, b'{"t": %d}' % stamp) for k, stamp in enumerate(stamps, start=1))]
    rest, names = StreamNames(unit=unit).beginning(iter(lines), nobody, print)
    seconds = [json.loads(line)["t"] for number, line in names.native_lines(rest) if number]
    assert 0.0 <= seconds[0] < 86_400.0
    for one, stamp in zip(seconds, stamps, strict=True):
        assert names.restored({"t": one}) == {"t": stamp}
        assert one - seconds[0] == pytest.approx((stamp - stamps[0]) * unit / 1e9, rel=0.0, abs=2e-9)


def test_fractions_of_a_unit_come_back() -> None:
    """A double resolves milliseconds since 1970 to three digits after the point."""
    stamps = [1_763_892_000_123.25 + 0.5 * k for k in range(5)]
    lines = [(k, json.dumps({"t": stamp}).encode()) for k, stamp in enumerate(stamps)]
    rest, names = StreamNames(unit=10**6).beginning(iter(lines), nobody, print)
    seconds = [json.loads(line)["t"] for _, line in names.native_lines(rest)]
    assert [names.restored({"t": one})["t"] for one in seconds] == stamps


def test_what_is_no_time_is_left_to_those_who_read_rows() -> None:
    for said in ("null", "true", '"now"', "[1]", "1" + "0" * 350):
        line = b'{"t": %s}' % said.encode()
        rest, names = StreamNames(unit=10**3).beginning(iter([(1, line)]), nobody, print)
        assert [json.loads(line) for _, line in names.native_lines(rest)] == [json.loads(line)]


def test_rows_that_cannot_be_read_are_refused_before_more_are_waited_for() -> None:
    refused: list[int] = []

    def lines():  # type: ignore[no-untyped-def]
        for number, line in enumerate((b"no JSON\n", b"\xff\n", b"[]\n"), start=1):
            yield number, line
            assert refused == list(range(1, number + 1))
        yield 4, b'{"frame": 0}\n'
        yield 5, b'{"frame": 1}\n'

    rest, cells = with_first_row(lines(), lambda number, line: refused.append(number))
    assert cells == {"frame": 0}
    assert [number for number, _ in rest] == [4, 5]


def test_well_known_names_of_columns_are_read_as_in_a_file() -> None:
    notes: list[str] = []
    lines = [(1, b'{"ped_id": 3, "time_ms": 1500, "pos_x": 1.0, "pos_y": 2.0}')]
    rest, names = StreamNames().beginning(iter(lines), nobody, notes.append)
    ((_, line),) = names.native_lines(rest)
    assert json.loads(line) == {"track_id": 3, "t": 1.5, "x": 1.0, "y": 2.0}
    assert names.restored(json.loads(line)) == json.loads(lines[0][1])
    assert notes == ["read columns 'ped_id' as track_id, 'time_ms' as t, 'pos_x' as x, 'pos_y' as y"]
    assert names == names.going_on(names.settings()) == StreamNames().going_on(names.settings())


def test_native_names_and_names_that_were_given_are_left_alone() -> None:
    lines = [(1, b'{"track_id": 3, "id": 4, "t": 0.0, "x": 1.0, "y": 2.0}')]
    given = StreamNames({"track_id": "who"})
    for names in (StreamNames(), given):
        assert names.beginning(iter(lines), nobody, print)[1] == names
    assert given.restored({"track_id": 3, "t": 0.25}) == {"who": 3, "t": 0.25}


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ('{"id": 3, "ped_id": 3, "t": 0, "x": 1, "y": 2}', "columns 'id' and 'ped_id'"),
        ('{"id": 3, "t": 0, "pos_x_cm": 1, "pos_y_cm": 2}', "column pos_x_cm .*metres"),
    ],
)
def test_names_that_may_mean_two_things_or_other_units_are_one_error(row: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        StreamNames().beginning(iter([(1, row.encode())]), nobody, print)


SCENE = SceneParameters(clutter_density=2e-3, birth_density=3e-3, death_rate=0.1)


def rows_of(seed: int, frames: int = 20, **more: object) -> list[dict[str, object]]:
    detections, _ = street(np.random.default_rng(seed), people=5, frames=frames)
    places = detections.position.tolist()
    return [
        {"frame": int(f), "t": round(0.4 * f, 6), "x": x, "y": y, **more}
        for f, (x, y) in zip(detections.frame.tolist(), places, strict=True)
    ]


def descriptors_of_people(k: int) -> dict[str, float]:
    """Some descriptor and score of detection k."""
    shown = np.random.default_rng(k).random(4).tolist()
    return {"score": shown[3]} | {f"appearance_{i}": value for i, value in enumerate(shown[:3])}


def scenes() -> Scenes:
    return Scenes(lambda: OnlineTracker("position", scene=SCENE), None)


def scene_answers(rows: list[dict[str, object]], of: Scenes | None = None) -> list[dict[str, object]]:
    of = scenes() if of is None else of
    lines = [json.dumps(row).encode() for row in rows]
    found = [one for number, line in enumerate(lines, 1) for one in of.answers(number, line)]
    return found + of.finish()


def test_each_frame_ends_with_its_people_and_what_was_taken_back() -> None:
    rows = rows_of(0)
    found = scene_answers(rows)
    ends = [row for row in found if "end" in row]
    assert [row["end"] for row in ends] == sorted({row["t"] for row in rows})
    assert sum(row["detections"] for row in ends) == len(rows)
    said = [row for row in found if "track_id" in row]
    assert sum(row["people"] for row in ends) == len(said)
    frames = {row["frame"] for row in rows}
    assert {row["frame"] for row in said} <= frames
    for row in said:
        assert row["observed"] in (0.0, 1.0)
        assert (row["identity_p"] is None) == (row["observed"] == 0.0)
    taken_back = [one for row in ends for one in row.get("revised", [])]
    assert taken_back
    assert {"t", "frame", "detection", "before", "after"} == taken_back[0].keys()


def test_an_end_tells_at_once_and_one_of_no_detections_is_a_frame_too() -> None:
    of = scenes()
    row = json.dumps({"t": 0.0, "x": 0.0, "y": 0.0}).encode()
    assert of.answers(1, row) == []
    *people, told = of.answers(2, b'{"end": 0.0}')
    assert told == {"end": 0.0, "people": len(people), "detections": 1}
    assert of.answers(3, b'{"end": 0.4}')[-1]["detections"] == 0
    (wrong,) = of.answers(4, b'{"end": 0.2}')
    assert "from 0.4 on (--max-delay)" in wrong["error"]


@pytest.mark.slow
def test_streams_do_not_know_of_each_other() -> None:
    one, other = rows_of(1, stream="north"), rows_of(2, stream=7)
    together = [row for pair in zip(one, other, strict=False) for row in pair]
    found = scene_answers(together)
    for name, rows in (("north", one[: len(other)]), (7, other[: len(one)])):
        alone = scene_answers(rows)
        assert [row for row in found if row["stream"] == name] == alone
    assert all("stream" not in row for row in scene_answers([{**row, "stream": None} for row in one]))


@pytest.fixture(scope="module")
def in_two_parts():
    """Rows, those that follow, and the answers to all of them."""
    rows = [row | descriptors_of_people(k) for k, row in enumerate(rows_of(3, frames=11))]
    later = [{**one, "t": one["t"] + 4.4, "frame": None} for one in rows]
    return rows, later, scene_answers([*rows, *later])


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ({"t": 4.0, "x": 1.0}, "all of x … y"),
        ({"t": 4.0}, "a detection without a position"),
        ({"x": 1.0, "y": 1.0}, "neither t nor frame"),
        ({"t": 3.0, "x": 1.0, "y": 1.0}, "a time from 4 on"),
        ({"t": 4.0, "x": 1.0, "y": 1.0, "track_id": 3}, "--associate always"),
        ({"t": 4.0, "x": 1.0, "y": 1.0, "stream": [1]}, "stream = "),
        ({"t": 4.0, "x": 1.0, "y": 1.0, "appearance_0": 1.0}, "a descriptor of 1 numbers"),
        ({"t": 4.0, "x": 1.0, "y": 1.0, "score": -1.0}, "score"),
        ({"end": "now"}, "the time of the frame that ends"),
    ],
)
def test_what_cannot_be_used_is_told_and_changes_nothing(
    row: dict[str, object], told: str, in_two_parts
) -> None:
    rows, later, undisturbed = in_two_parts
    found = scene_answers([*rows, row, *later])
    (wrong,) = [one for one in found if "error" in one]
    assert told in wrong["error"]
    assert wrong["line"] == len(rows) + 1
    assert [one for one in found if "error" not in one] == undisturbed


@pytest.mark.slow
def test_a_stream_takes_every_camera_that_files_take(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plane = np.array([[0.01, 0.001, -4.0], [0.0005, -0.02, 14.0], [1e-5, 0.0012, 0.1]])
    pixel = np.array([[100.0, 300.0], [540.0, 300.0], [540.0, 500.0], [100.0, 500.0]])
    ground = GroundCamera.from_homography(plane, visible=pixel).image_to_ground(pixel)
    np.savetxt("plane.txt", plane)
    np.savetxt("pairs.txt", np.hstack([pixel, ground]))
    rows = [{"track_id": 1, "t": 0.4 * k, "u": 300.0 + 5.0 * k, "v": 400.0} for k in range(6)]

    def places(*camera: str) -> np.ndarray:
        done = run("track", "-", "--model", "position", *camera, program="graphtrack", rows=rows)
        assert done.returncode == 0, done.stderr
        return np.array([(one["x"], one["y"]) for one in map(json.loads, done.stdout.splitlines())])

    np.testing.assert_allclose(places("--point-pairs", "pairs.txt"), places("--homography", "plane.txt"))
    np.testing.assert_allclose(places("--metres-per-pixel", "0.01")[0], [3.0, -4.0])
