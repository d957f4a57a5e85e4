"""Text of files and their names cannot steer the terminal."""

from __future__ import annotations

import unicodedata
from functools import partial
from pathlib import Path

import command
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack.cli.console import WIDE, column_widths, print_table, printable, shown_number

LABEL = "\x1b[31mred\x1b[0m\x07 [bold]b[/x] :smile: \x1b]0;title\x9c"
SHOWN = "red [bold]b[/x] :smile: ]0;title"


run = partial(command.run, program="graphtrack")


@given(st.text(st.characters(exclude_categories=())))
def test_no_control_character_is_printable_and_all_else_is(text: str) -> None:
    shown = printable(text)
    assert all(c == "\n" or unicodedata.category(c) not in ("Cc", "Cs") for c in shown)
    assert printable(shown) == shown
    assert len(printable(text, one_line=True).splitlines()) <= 1


@pytest.fixture
def named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    name = "a\x1b[2J\nerror: b.csv"
    rows = "".join(f'1,{k},{k / 10},0,0,"{LABEL}"\n' for k in range(3))
    Path(name).write_text("track_id,frame,t,x,y,label\n" + rows)
    return name


def test_labels_and_file_names_are_shown_without_escape_sequences(named: str) -> None:
    done = run("info", named)
    assert done.returncode == 0 and SHOWN in done.stdout
    assert done.stderr.startswith("a error: b.csv: csv, rows read 3")
    assert not {"\x1b", "\x07", "\x9c"} & set(done.stdout + done.stderr)


def test_errors_are_one_line_whatever_the_names(named: str) -> None:
    done = run("info", named, "--format", "mot")
    said = done.stderr
    assert done.returncode == 2 and said.count("\n") == 1
    assert said.startswith("error: a error: b.csv, line 1: found 6 columns")
    assert "\x1b" not in said


def test_what_is_written_keeps_the_label(named: str) -> None:
    assert run("add-noise", named, "-o", "out.csv", "--position-noise", "0.1").returncode == 0
    assert gt.read("out.csv").by_id(1).label == LABEL


def test_a_table_has_a_row_for_each_and_a_dash_where_there_is_no_value(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_table("Errors", [{"method": "kf", "rmse": -0.1234}, {"method": LABEL, "rmse": float("nan")}])
    title, heading, _, *rows = [line.strip() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert (title, heading.split()) == ("Errors", ["method", "rmse"])
    assert [row.split() for row in rows] == [["kf", "-0.123"], [*SHOWN.split(), "–"]]


@given(
    st.lists(st.lists(st.text("ab ", max_size=60), min_size=2, max_size=2), min_size=1, max_size=12),
    st.integers(0, 200),
)
def test_columns_fit_where_their_words_do(columns: list[list[str]], available: int) -> None:
    widths = column_widths(columns, available)
    words = [max((len(word) for cell in cells for word in cell.split()), default=0) for cells in columns]
    natural = [max(map(len, cells)) for cells in columns]
    assert all(w <= width <= n for w, width, n in zip(words, widths, natural, strict=True))
    assert sum(widths) <= available or widths == words
    assert sum(widths) >= available or widths == natural


@pytest.mark.parametrize("narrow", [4, 40])
def test_no_column_of_a_wide_table_is_cut(narrow: int, capsys: pytest.CaptureFixture[str]) -> None:
    words = {f"heading of column {k}": "x" * (38 if k == 0 else narrow - 1) + "|" for k in range(8)}
    row = {"some words that can be wrapped": "one two three " * 5, **words}
    print_table("", [row, row])
    shown = capsys.readouterr().out
    assert shown.count("|") == 2 * 8 and "…" not in shown
    assert narrow == 40 or max(map(len, shown.splitlines())) <= WIDE


def test_large_numbers_are_shown_without_exponent() -> None:
    assert [shown_number(v) for v in (-31_812.0, 0.04884, 999.6, 1.0, 2.4e-5)] == [
        "-31,800",
        "0.0488",
        "1,000",
        "1",
        "2.4e-05",
    ]
