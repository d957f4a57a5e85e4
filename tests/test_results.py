"""Pages show the stored results, and `make claims` stores a command's measurements."""

import json
import re
from pathlib import Path

import pytest
import results
from documents import ROOT

from graphtrack.experiments import all_experiments

STEMS = sorted(path.stem for path in (results.RESULTS / "data").glob("*.json"))
BY_HAND = {"gaps-at-turns", "outliers", "declared-noise", "isam2-speed"}
"""Data without a command that measures them."""
TABLES = sorted(set(results.specs()) - {"names", "quotes"})
ABOUT = [
    {
        "title": "Errors of all",
        "columns": ["method", "rate", "error (°)", "low"],
        "rows": [["a", 1.0, -1.25, -2.0], ["b", 1.0, 2.5, None]],
    }
]


@pytest.mark.parametrize("page", results.pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_tables_of_a_page_are_those_of_the_data(page):
    text = page.read_text(encoding="utf-8")
    assert results.written(text) == text, "run `make results`"


def test_every_table_is_shown():
    text = "".join(page.read_text(encoding="utf-8") for page in results.pages())
    shown = {match["name"] for match in results.BLOCK.finditer(text)}
    assert text.count("<!-- results: ") == text.count("<!-- /results -->")
    found = [(match["kind"], match["name"]) for match in results.MARKER.finditer(text)]
    assert len(found) == len(re.findall(r"^\[(?:table|setting)\b", text, flags=re.M)), "a line is misspelt"
    assert set(TABLES) == shown | {name for kind, name in found if kind == "table"}
    settings = {name for kind, name in found if kind == "setting"}
    assert {stem for stem in STEMS if not re.search(r"-\d$", stem)} == settings


def test_figures_of_a_table_stand_in_the_data_alone():
    for page in results.pages():
        text = page.read_text(encoding="utf-8")
        assert page.name == "README.md" or not results.BLOCK.search(text), page


@pytest.mark.parametrize("quote", results.specs()["quotes"], ids=lambda quote: quote["text"])
def test_figures_in_prose_are_those_of_the_data(quote):
    prose = " ".join((ROOT / quote["page"]).read_text(encoding="utf-8").split())
    assert results.quoted(quote) in prose


@pytest.mark.parametrize("stem", STEMS)
def test_data_name_their_command_and_hold_what_is_shown(stem):
    data = results.stored(stem)
    assert all(table["title"].startswith(results.shown_titles(stem)) for table in data["tables"])
    assert (stem in BY_HAND) == (data["command"] == "")
    assert data["setting"].endswith(".")
    match data["command"].split():
        case ["graphtrack", "reproduce", name, *_]:
            assert name in all_experiments()
        case ["pytest", path, *_]:
            assert (ROOT / path).exists()
        case words:
            assert words[:1] in (["graphtrack"], ["perception"], ["make"], [])


@pytest.fixture
def stored(tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    monkeypatch.setattr(results, "ROOT", tmp_path)
    monkeypatch.setattr(results, "RESULTS", tmp_path)
    spec = {
        "data": "one",
        "title": "Errors",
        "rows": ["method"],
        "columns": ["rate"],
        "cells": {"error": "{error (°)|.1f}° ({low|.0f} …)"},
    }
    monkeypatch.setattr(results, "specs", lambda: {"names": {"a": "`a`"}, "errors": spec})
    results.write("one", {"command": "graphtrack reproduce one", "setting": "All.", "tables": ABOUT})
    return tmp_path


def test_a_table_is_written_with_its_labels_and_without_missing_intervals(stored):
    assert results.block("errors") == "||1: error|\n|---|---|\n|`a`|−1.2° (−2 …)|\n|b|2.5°|\n"
    page = "Text.\n\n<!-- results: errors -->\nold\n<!-- /results -->\n"
    assert "|b|2.5°|" in results.written(page) and "old" not in results.written(page)
    assert results.block("about one") == "All. `graphtrack reproduce one`\n"


def test_the_line_of_a_table_names_its_file_and_becomes_the_table(stored):
    page = results.written("Text.\n\n[setting one]\n\n[table errors: elsewhere.json]\n\nEnd.\n")
    assert page.splitlines()[2:5:2] == [
        "[setting one: graphtrack reproduce one]",
        "[table errors: data/one.json]",
    ]
    built = results.on_page_markdown(page, page=None, config=None, files=None)
    assert "All. `graphtrack reproduce one`\n" in built and "[table" not in built
    assert "\n\n||1: error|\n|---|---|\n|`a`|−1.2° (−2 …)|\n|b|2.5°|\n\n\nEnd.\n" in built


def test_two_rows_for_a_cell_and_missing_tables_are_refused(stored):
    twice = [{**ABOUT[0], "rows": [*ABOUT[0]["rows"], ABOUT[0]["rows"][0]]}]
    results.write("one", {"command": "", "setting": "", "tables": twice})
    with pytest.raises(LookupError, match="two rows"):
        results.block("errors")
    results.write("one", {"command": "", "setting": "", "tables": []})
    with pytest.raises(LookupError, match="0 tables begin with 'Errors'"):
        results.block("errors")


def test_what_a_command_measured_is_stored_with_its_setting(stored, monkeypatch):
    def measuring(command, *, check):
        assert command[1:4] == ["-m", "graphtrack", "reproduce"] and check
        more = [{**ABOUT[0], "rows": [["c", 1.0, 3.0123456, 0.0]]}, {**ABOUT[0], "title": "Not shown"}]
        path = Path(command[command.index("--json") + 1])
        path.write_text(json.dumps(more), encoding="utf-8")

    monkeypatch.setattr(results.subprocess, "run", measuring)
    assert results.measure("one")
    data = results.stored("one")
    assert data["setting"] == "All." and [table["rows"] for table in data["tables"]] == [
        [["c", 1.0, 3.0123, 0.0]]
    ]
    results.write("one", {"command": "graphtrack score a.csv", "setting": "All.", "tables": ABOUT})
    assert not results.measure("one")
