"""Pages show the stored results, and `make claims` stores a command's measurements."""

import json
import os
import re
from pathlib import Path

import pytest
import results
from documents import ROOT

from graphtrack.experiments import all_experiments
from perception.cli import evaluate

STEMS = sorted(path.stem for path in (results.RESULTS / "data").glob("*.json"))
CLAIMING = [
    path
    for path in results.pages()
    if path.parent == results.RESULTS or path.name in ("README.md", "papers.md")
]
"""Pages on which each figure comes from the data."""

UNIT = r"(?:°|%|×|ms\b|mm\b|m/s\b|m\b|s\b|points?\b)"
MEASURED = re.compile(rf"(?<![\w.,])\d[\d,]*(?:\.\d+)?(?:\s?{UNIT})|(?<![\w.,])\d+\.\d+")
"""A number with a unit of results, or with decimals."""

BLOCKS = (
    r"```.*?```",
    r"<!-- results: .*?<!-- /results -->",  # tables made from the data
    r"^\[(?:table|setting) [^\n]*\]$",
    r"^#[^\n]*$",  # headings
)
NO_RESULTS = (
    r"`[^`]+`",  # code, and parameters
    r"\]\([^)]*\)",  # addresses of links
    r"\b95 % (?:intervals?|bootstrap)",
    r"(?:\b(?:[Ee]q|Figs?|Tables?)\.? |§)\d+(?:[.–]\d+)*",
    r"Python 3\.\d+",
)
"""Blocks and phrases of a page whose numbers are no results."""

TABLES = sorted(set(results.specs()) - set(results.NO_TABLES))
PAPERS = ("Baxter 2014", "Chen 2011", "Yan 2011", "Ba & Odobez 2003")
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


@pytest.mark.parametrize("name", TABLES)
def test_a_table_has_lines_from_the_data(name):
    assert len(results.block(name).splitlines()) > 2


def test_figures_of_a_table_stand_in_the_data_alone():
    for page in results.pages():
        text = page.read_text(encoding="utf-8")
        assert page.name == "README.md" or not results.BLOCK.search(text), page


@pytest.mark.parametrize("quote", results.specs()["quotes"], ids=lambda quote: quote["text"])
def test_figures_in_prose_are_those_of_the_data(quote):
    prose = " ".join((ROOT / quote["page"]).read_text(encoding="utf-8").split())
    assert results.quoted(quote) in prose


@pytest.mark.parametrize("printed", results.specs()["printed"], ids=lambda printed: printed["text"])
def test_figures_of_a_paper_name_their_place_in_it(printed):
    assert printed["text"] in " ".join((ROOT / printed["page"]).read_text(encoding="utf-8").split())
    assert printed["source"].startswith(PAPERS) and re.search(r"Table|Fig\.|§|eq\.", printed["source"])


def claims(text: str, quotes: list[str]) -> list[str]:
    """Measured-looking numbers of a page that no quotation has."""
    for pattern in BLOCKS:
        text = re.sub(pattern, " ", text, flags=re.MULTILINE | re.DOTALL)
    text = " ".join(text.split())
    for quote in quotes:
        text = text.replace(quote, " ")
    for pattern in NO_RESULTS:
        text = re.sub(pattern, " ", text)
    return [match[0] for match in MEASURED.finditer(text)]


@pytest.mark.parametrize("page", CLAIMING, ids=lambda page: str(page.relative_to(ROOT)))
def test_figures_of_a_page_come_from_the_data(page):
    name = str(page.relative_to(ROOT))
    specs = results.specs()
    quotes = [results.quoted(quote) for quote in specs["quotes"] if quote["page"] == name]
    quotes += [printed["text"] for printed in specs["printed"] if printed["page"] == name]
    found = claims(page.read_text(encoding="utf-8"), [" ".join(quote.split()) for quote in quotes])
    assert not found, "quote them in tables.toml, show them in a table, or leave them out"


def test_numbers_that_look_measured_are_found():
    text = "# 3.1 of 7 %\n\n3.5° (95 % interval 2.0° … 4.0°), eq. 5, Table 2, `0.1 m`, 12 clips, 40 ms.\n"
    assert claims(text, []) == ["3.5°", "2.0°", "4.0°", "40 ms"]
    assert claims(text, ["3.5° (95 % interval 2.0° … 4.0°)"]) == ["40 ms"]
    assert claims("[table a: data/1.5.json]\n\n```text\n2.5 m\n```\n[x](y.md#2.5) 1,000 × 2", []) == [
        "1,000 ×"
    ]


@pytest.mark.parametrize("stem", STEMS)
def test_data_name_their_command_and_hold_what_is_shown(stem):
    data = results.stored(stem)
    assert all(table["title"].startswith(results.shown_titles(stem)) for table in data["tables"])
    assert data["tables"], "measure it: python docs/hooks/results.py --measure NAME"
    assert data["setting"].endswith(".")
    assert data["command"].startswith(results.MEASURED)
    match data["command"].split():
        case ["graphtrack", "reproduce", name, *_]:
            assert name in all_experiments()
        case ["perception", "evaluate", name, *_]:
            assert name in (*evaluate._TABLES, *evaluate._REAL)
        case ["pytest", *words]:
            paths = [ROOT / word for word in words if word.startswith("tests/")]
            assert paths and all(path.exists() and "figures" in path.read_text("utf-8") for path in paths)


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
    results.measure("one")
    data = results.stored("one")
    assert data["setting"] == "All." and [table["rows"] for table in data["tables"]] == [
        [["c", 1.0, 3.0123, 0.0]]
    ]
    results.write("one", {"command": "graphtrack score a.csv", "setting": "All.", "tables": ABOUT})
    with pytest.raises(LookupError, match="writes no tables"):
        results.measure("one")


def test_what_tests_record_is_stored(stored, monkeypatch, tmp_path):
    tests = tmp_path / "test_some.py"
    tests.write_text(
        "def test_it(figures):\n    figures('Errors', {'method': 'c', 'error (°)': 1.5})\n", "utf-8"
    )
    monkeypatch.setattr(results, "MEASURED", ("pytest ",))
    options = f"-p conftest -p no:cacheprovider --rootdir {tmp_path}"
    results.write("one", {"command": f"pytest {tests} {options}", "setting": "All.", "tables": []})
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "tests"), prepend=os.pathsep)
    results.measure("one")
    (table,) = results.stored("one")["tables"]
    assert table["columns"] == ["method", "error (°)"] and table["rows"] == [["c", 1.5]]
