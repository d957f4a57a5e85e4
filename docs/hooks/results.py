"""Tables of measured results: measured by ``make claims``, put into the pages when the site is built.

``docs/results/data/NAME.json`` holds what a command measured, ``docs/results/tables.toml`` how pages show it.
A page of the site has one line for each table, ``[table NAME: FILE]``, and one for the setting in which
a data file was measured, ``[setting NAME: COMMAND]``. ``make results`` completes these lines, and writes
the tables of the README, which is read without the site, between two comments.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- results: (?P<name>(?:about )?[\w-]+) -->\n).*?(<!-- /results -->)", flags=re.S)
MARKER = re.compile(r"^\[(?P<kind>table|setting) (?P<name>[\w-]+)(?:: [^\]\n]*)?\]$", flags=re.M)
"""Line of a page that the table, or the setting of a data file, replaces in the built site."""
FIELD = re.compile(r"\{(?P<column>[^{}|]*)(?:\|(?P<form>[^{}]*))?\}")
MEASURED = ("graphtrack reproduce ", "perception evaluate ", "pytest tests/")
"""Beginnings of commands that write what they measure: with ``--json``, tests with ``--figures``."""
NO_TABLES = ("names", "quotes", "printed")
"""Parts of ``tables.toml`` that are no tables: labels, and texts with figures of the data or of a paper."""
DIGITS = 5
"""Significant digits that are kept of a measured number."""

Record = Mapping[str, Any]
Spec = Mapping[str, Any]


@cache
def specs() -> dict[str, Any]:
    """All of ``tables.toml``."""
    return tomllib.loads((RESULTS / "tables.toml").read_text(encoding="utf-8"))


def stems(spec: Spec) -> list[str]:
    """Names of the data files of a table or quotation."""
    return [spec["data"]] if isinstance(spec["data"], str) else list(spec["data"])


def stored(stem: str) -> dict[str, Any]:
    """Command, setting and tables of a data file, or of a file of records by its path from the root."""
    content = json.loads(stored_at(stem).read_text(encoding="utf-8"))
    if isinstance(content, dict):
        return content
    return {
        "tables": [
            {"title": "", "columns": list(content[0]), "rows": [list(one.values()) for one in content]}
        ]
    }


def stored_at(stem: str) -> Path:
    """Path of a data file."""
    return ROOT / stem if "/" in stem else RESULTS / "data" / f"{stem}.json"


def records(spec: Spec) -> Iterator[Record]:
    """Rows of the measured table that a spec chooses; ``file`` is the data file of a row.

    Raises
    ------
    LookupError
        If a data file has no table, or several, whose title begins with the spec's.
    """
    for stem in stems(spec):
        tables = [table for table in stored(stem)["tables"] if table["title"].startswith(spec["title"])]
        if len(tables) != 1:
            raise LookupError(f"{stem}.json: {len(tables)} tables begin with {spec['title']!r}")
        for row in tables[0]["rows"]:
            record = {"file": stem, **dict(zip(tables[0]["columns"], row, strict=True))}
            if all(record[column] in wanted for column, wanted in _wanted(spec).items()):
                yield record


def _wanted(spec: Spec) -> dict[str, list[Any]]:
    where = spec.get("where", {})
    return {column: value if isinstance(value, list) else [value] for column, value in where.items()}


def filled(text: str, record: Record) -> str:
    """A text with its fields ``{column|format}`` replaced.

    Empty if the first field was not measured; the bracket of an interval that was not measured is left out.

    >>> filled("{error (°)|.1f}° ({low|.1f} … {high|.1f})", {"error (°)": -0.25, "low": None, "high": None})
    '−0.2°'
    """
    columns = [match["column"] for match in FIELD.finditer(text)]
    missing = [record[column] is None for column in columns]
    if any(missing):
        short = text.partition(" ({")[0]
        return "" if missing[0] or short == text else filled(short, record)
    return FIELD.sub(lambda match: _shown(record[match["column"]], match["form"] or ""), text)


def _shown(value: Any, form: str) -> str:
    if isinstance(value, str):
        return value
    text = format(value, form or ",g").replace("%", " %")
    zero = text.startswith("-") and not any(digit in "123456789" for digit in text)
    return text[1:] if zero else text.replace("-", "−")


def block(name: str) -> str:
    """A table as Markdown; of ``about NAME`` setting and command, if there is one, of a data file.

    Raises
    ------
    LookupError
        If the data have no such table, or two rows for one cell.
    """
    if name.startswith("about "):
        about = stored(name.removeprefix("about "))
        return f"{about['setting']} `{about['command']}`\n"
    spec = specs()[name]
    if "lines" in spec:
        lines = [spec["head"], *([line["label"], *map(_told, line["cells"])] for line in spec["lines"])]
    else:
        lines = _pivoted(spec, list(records(spec))) if "cells" in spec else _as_stored(spec)
    return "\n".join(_markdown(lines)) + "\n"


def _as_stored(spec: Spec) -> list[list[str]]:
    (stem,) = stems(spec)
    (one,) = [found for found in stored(stem)["tables"] if found["title"].startswith(spec["title"])]
    return [
        one["columns"],
        *([("" if cell is None else _shown(cell, "")) for cell in row] for row in one["rows"]),
    ]


def _pivoted(spec: Spec, found: Sequence[Record]) -> list[list[str]]:
    names = {**specs()["names"], **spec.get("names", {})}
    rows, columns, cells = spec["rows"], spec.get("columns", []), spec["cells"]
    lines = list(_values(rows, found, spec))
    spread = list(_values(columns, found, spec))
    by_key: dict[tuple[Any, ...], Record] = {}
    for record in found:
        key = tuple(record[column] for column in (*rows, *columns))
        if key in by_key:
            raise LookupError(f"two rows {key} in {spec['data']}")
        by_key[key] = record
    heads = [
        ": ".join(filter(None, [*(_label(value, names) for value in values), cell]))
        for values, cell in product(spread, cells)
    ]
    shown = [[*spec.get("head", ["" for _ in rows]), *heads]]
    for line in lines:
        own = [by_key.get((*line, *values)) for values in spread]
        texts = [filled(cells[cell], one) if one else "" for one, cell in product(own, cells)]
        if any(texts):
            shown.append([*(_label(value, names) for value in line), *texts])
    return shown


def _values(columns: Sequence[str], found: Iterable[Record], spec: Spec) -> Iterator[tuple[Any, ...]]:
    """Combinations of values, in the order in which a spec or else the data has them."""
    kept = list(found)
    wanted = _wanted(spec)
    orders = [wanted.get(column) or list(dict.fromkeys(one[column] for one in kept)) for column in columns]
    there = {tuple(one[column] for column in columns) for one in kept}
    return (values for values in product(*orders) if values in there)


def _label(value: Any, names: Mapping[str, str]) -> str:
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return names.get(text, text)


def _markdown(lines: Sequence[Sequence[str]]) -> Iterator[str]:
    for k, line in enumerate(lines):
        yield f"|{'|'.join(line)}|"
        if k == 0:
            yield "|" + "---|" * len(line)


def pages() -> list[Path]:
    """Pages that may have tables of results or quote them."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def written(text: str) -> str:
    """A page with the tables between comments, and the lines of tables complete."""
    text = BLOCK.sub(lambda match: f"{match[1]}\n{block(match['name'])}\n{match[3]}", text)
    return MARKER.sub(lambda match: marker(match["kind"], match["name"]), text)


def marker(kind: str, name: str) -> str:
    """The line of a table, with the files of its figures, or of a setting, with the command.

    >>> marker("table", "weight")
    '[table weight: docs/results/data/baxter-weight.json]'
    >>> marker("setting", "baxter-weight")
    '[setting baxter-weight: graphtrack reproduce baxter-weight]'
    """
    if kind == "setting":
        return f"[setting {name}: {stored(name)['command']}]"
    spec = specs()[name]
    cells = [spec] if "data" in spec else _measured_cells(spec)
    files = dict.fromkeys(str(stored_at(stem).relative_to(ROOT)) for cell in cells for stem in stems(cell))
    return f"[table {name}: {', '.join(files)}]"


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put the tables and settings of a page into it."""
    return MARKER.sub(lambda match: f"\n{block(_block_name(match))}", markdown)


def _block_name(match: re.Match[str]) -> str:
    return match["name"] if match["kind"] == "table" else f"about {match['name']}"


def quoted(quote: Spec) -> str:
    """The text of a quotation, or of a cell, with the figures of its one row."""
    (record,) = records(quote)
    return filled(quote["text"], record)


def _told(cell: Spec | str) -> str:
    """The text of a cell of a line: words as they are, or with the figures of a quotation."""
    return cell if isinstance(cell, str) else quoted(cell)


def _measured_cells(spec: Spec) -> list[Spec]:
    """Those cells of a table's lines that are quotations, and not words alone."""
    return [cell for line in spec.get("lines", []) for cell in line["cells"] if not isinstance(cell, str)]


def sources() -> list[Spec]:
    """All that names a data file and the title of a table in it: tables, cells of tables and quotations."""
    tables = [spec for name, spec in specs().items() if name not in NO_TABLES]
    cells = [cell for spec in tables for cell in _measured_cells(spec)]
    return [*(spec for spec in tables if "data" in spec), *cells, *specs().get("quotes", [])]


def measure(stem: str) -> None:
    """Run the command of a data file and store what it measured.

    Raises
    ------
    LookupError
        If the command is none of `MEASURED`.
    """
    command = stored(stem)["command"]
    if not command.startswith(MEASURED):
        raise LookupError(f"{stem}.json: {command!r} writes no tables")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "tables.json"
        words = shlex.split(command)
        option = "--figures" if words[0] == "pytest" else "--json"
        out = ["--out", folder] if words[0] == "graphtrack" else []
        subprocess.run([sys.executable, "-m", *words, *out, option, str(path)], check=True)
        store(stem, json.loads(path.read_text(encoding="utf-8")))


def store(stem: str, tables: Sequence[Record]) -> None:
    """Store those of measured tables that pages show or quote, with the command and setting of before."""
    titles = shown_titles(stem)
    kept = [rounded(table) for table in tables if table["title"].startswith(titles)]
    write(stem, {**stored(stem), "tables": kept})


def shown_titles(stem: str) -> tuple[str, ...]:
    """Beginnings of the titles of those tables of a data file that pages show or quote."""
    return tuple(spec["title"] for spec in sources() if stem in stems(spec))


def rounded(table: Record) -> dict[str, Any]:
    """A table with as many digits as are kept."""
    rows = [[float(f"{c:.{DIGITS}g}") if isinstance(c, float) else c for c in row] for row in table["rows"]]
    return {"title": table["title"], "columns": list(table["columns"]), "rows": rows}


def write(stem: str, content: Record) -> None:
    """Write a data file: a line for each row."""
    head = [
        f"{json.dumps(key)}: {json.dumps(content[key], ensure_ascii=False)}"
        for key in content
        if key != "tables"
    ]
    tables = []
    for one in content["tables"]:
        rows = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in one["rows"])
        title, columns = (json.dumps(one[key], ensure_ascii=False) for key in ("title", "columns"))
        tables.append(f'{{"title": {title},\n "columns": {columns},\n "rows": [\n  {rows}]}}')
    body = ",\n".join([*head, f'"tables": [{", ".join(tables)}]'])
    path = stored_at(stem)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{{{body}}}\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, if wanted, and bring the tables and their lines in the pages up to date."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument(
        "--measure", nargs="*", metavar="NAME", help="run the commands of these data files, or of all"
    )
    options = parser.parse_args(arguments)
    if options.measure is not None:
        for stem in options.measure or sorted(path.stem for path in (RESULTS / "data").glob("*.json")):
            measure(stem)
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if written(text) != text:
            page.write_text(written(text), encoding="utf-8")
            print(f"{page.relative_to(ROOT)}: written")


if __name__ == "__main__":
    main()
