"""Names and units of time of a stream's own, a row at a time."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from graphtrack.cli.stream_names import StreamNames

DAY = 86_400 * 10**9


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
    """Also those since 1970, of which a double has no nanoseconds."""
    stamps = [(first + more) // unit for more in (0, *later)]
    lines = [(0, b"no row"), *((k, b'{"t": %d}' % stamp) for k, stamp in enumerate(stamps, start=1))]
    rest, names = StreamNames(unit=unit).beginning(iter(lines))
    seconds = [json.loads(line)["t"] for number, line in names.native_lines(rest) if number]
    assert 0.0 <= seconds[0] < 86_400.0
    for one, stamp in zip(seconds, stamps, strict=True):
        assert names.restored({"t": one}) == {"t": stamp}
        # Whoever is shown the answers beside has the seconds of the stream.
        (shown,) = names.since_then({"revised": [{"t": one}]})["revised"]
        assert shown["t"] == pytest.approx(stamp * unit / 1e9)
        assert one - seconds[0] == pytest.approx((stamp - stamps[0]) * unit / 1e9, rel=0.0, abs=2e-9)


def test_fractions_of_a_unit_come_back() -> None:
    """Of milliseconds since 1970 a double has three digits after the point."""
    stamps = [1_763_892_000_123.25 + 0.5 * k for k in range(5)]
    lines = [(k, json.dumps({"t": stamp}).encode()) for k, stamp in enumerate(stamps)]
    rest, names = StreamNames(unit=10**6).beginning(iter(lines))
    seconds = [json.loads(line)["t"] for _, line in names.native_lines(rest)]
    assert [names.restored({"t": one})["t"] for one in seconds] == stamps


def test_what_is_no_time_is_left_to_those_who_read_rows() -> None:
    for said in ("null", "true", '"now"', "[1]", "1" + "0" * 350):
        line = b'{"t": %s}' % said.encode()
        rest, names = StreamNames(unit=10**3).beginning(iter([(1, line)]))
        assert [json.loads(line) for _, line in names.native_lines(rest)] == [json.loads(line)]
