"""Names and units of time of a stream's own, a row at a time."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from graphtrack.errors import InputError
from graphtrack.streaming.protocol import StreamNames, with_first_row

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
@given(
    first=st.integers(0, 4 * 10**18),
    later=st.lists(st.integers(0, 90 * DAY), min_size=2, max_size=4),
)
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
