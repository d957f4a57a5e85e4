"""Statements that can be looked up, papers by author and year, and words in the field's terms."""

import ast
import io
import re
import tokenize
from itertools import pairwise
from pathlib import Path

import nbformat
import pytest
from documents import ROOT

from graphtrack.io.registry import HOMES
from graphtrack.model.model import presets

NUMBER = re.compile(r"(?<![\d.,:#\w{])(?<!\d )00[0-4](?!\.\w|[\d\w]|[.,]\d)")
"""000 to 004 where they stand for a paper, and not for a part of a number or of a file's name."""


def texts():
    yield from (ROOT / name for name in ("README.md", "CHANGELOG.md", "CITATION.cff"))
    yield from (ROOT / "docs").rglob("*.md")
    for package in ("graphtrack", "perception"):
        yield from (ROOT / package).rglob("*.py")


def readable(path: Path) -> str:
    if path.suffix == ".ipynb":
        return "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells)
    return path.read_text(encoding="utf-8")


def test_papers_are_cited_by_author_and_year():
    found = []
    for path in (*texts(), *(ROOT / "notebooks").glob("*.ipynb")):
        for number, line in enumerate(readable(path).splitlines(), 1):
            if NUMBER.search(line) or re.search(r"\bMODEL (term|\()|^\"\"\"Term \d|\(MODEL\b", line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert not found


@pytest.mark.parametrize("anchor", ["baxter-2014", "chen-2011", "yan-2011", "ba-odobez-2003"])
def test_every_paper_has_a_reference_that_pages_link_to(anchor):
    assert f'id="{anchor}"' in (ROOT / "docs/references.md").read_text(encoding="utf-8")
    assert f"references.md#{anchor}" in (ROOT / "docs/papers.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", ["CHANGELOG.md", "docs/formats.md"])
def test_the_stated_number_of_formats_is_theirs(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    assert re.search(rf"\b{len(HOMES)} (?:file )?formats", text)
    assert not re.search(r"\bten formats", text)


def test_code_that_docstrings_and_comments_name_is_there():
    paths = [path for package in ("graphtrack", "perception") for path in (ROOT / package).rglob("*.py")]
    tokens = {p: list(tokenize.generate_tokens(io.StringIO(readable(p)).readline)) for p in paths}
    names: dict[str, set[str]] = {}
    for path in paths:
        of_module = names.setdefault(path.stem if path.stem != "__init__" else path.parent.name, set())
        of_module |= {token.string for token in tokens[path] if token.type == tokenize.NAME}
    known = set(names).union(*names.values(), ["io", "load_dataset", "marginalizeLeaves"])
    gone = []
    for path, all_tokens in tokens.items():
        text = "".join(
            token.string for token in all_tokens if token.type in (tokenize.STRING, tokenize.COMMENT)
        )
        for reference in re.findall(r"(?<![`\w])`([A-Za-z_]\w*(?:\.\w+)*)(?:\(\))?`(?!`)", text):
            parts = reference.split(".")
            there = all(b in names.get(a, known) | set(names) for a, b in pairwise(parts))
            if not (there or parts[0] == "movement") or not set(parts) <= known:
                gone.append(f"{path.relative_to(ROOT)}: {reference}")
    assert not gone


def test_every_preset_stands_in_the_table():
    text = (ROOT / "docs/model.md").read_text(encoding="utf-8")
    assert set(presets) <= set(re.findall(r"^\| ?`([\w-]+)` ?\|", text, flags=re.M))


def test_the_notebook_on_gait_says_what_its_outputs_have():
    notebook = nbformat.read(ROOT / "notebooks/04-gait.ipynb", as_version=4)
    (at,) = (k for k, cell in enumerate(notebook.cells) if cell.source.startswith("Mean errors in degrees."))
    (output,) = notebook.cells[at - 1].outputs
    rows = {
        line.split()[0]: [float(value) for value in line.split()[1:]]
        for line in output.data["text/plain"].splitlines()
        if re.match(r"(ahead|side-stepping|backwards) ", line)
    }
    assert len(rows) == 3
    text = " ".join(notebook.cells[at].source.split())
    assert "the body has a lower error than with `separate` in every row, and so has the head" in text
    # Body, then head: separate, joint, learned.
    assert all(row[2] < row[0] and row[5] < row[3] for row in rows.values())
    assert all(rows[kind][1] > 5.0 * rows[kind][0] for kind in ("side-stepping", "backwards"))
    printed = "".join(output.text for output in notebook.cells[-1].outputs)
    assert re.search(r"^ahead: .*body follows path", printed, flags=re.M)
    assert not re.search(r"^(side-stepping|backwards): .*body follows path", printed, flags=re.M)


MODULES = sorted(path for name in ("graphtrack", "perception") for path in (ROOT / name).rglob("*.py"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

NAMES = {
    *("told", "tell", "tells", "said", "say", "says"),  # report, emit
    *("foresee", "foretell", "foretold"),  # predict
    *("stated", "stating"),  # calibrated covariance
    *("sway", "who", "whom", "whoever", "seen", "beside", "anew", "mend", "mended", "restart", "late"),
    *("looks", "whole", "marks", "ones", "others"),  # appearance or gaze, offline, the noun that is meant
}
OF_OTHERS = {"ones", "ones_like", "tell", "_BYTE_ORDER_MARKS"}  # NumPy, files, Unicode
WORDS = re.compile(
    r"\b(?:whoever|foretell|foretold|thereof|anew|who is who|mend|mended|made-up|beside)\b", re.IGNORECASE
)
QUESTIONS = ("What", "Whether", "How", "Where", "Who", "Whoever")


def words(name):
    return {part.lower() for part in re.split(r"_|(?<=[a-z])(?=[A-Z])", name)}


def text_of(path):
    return path.read_text(encoding="utf-8")


def findings(path):
    """What a reader would have to translate in a module: names, text, first words of docstrings."""
    tokens = list(tokenize.generate_tokens(io.StringIO(text_of(path)).readline))
    for name in {token.string for token in tokens if token.type == tokenize.NAME} - OF_OTHERS:
        if words(name) & NAMES:
            yield name
    for token in tokens:
        if token.type in (tokenize.STRING, tokenize.COMMENT):
            yield from (f"line {token.start[0]}: {word}" for word in WORDS.findall(token.string))
    for node in ast.walk(ast.parse(text_of(path))):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = (ast.get_docstring(node) or "-").split()[0]
            if first in QUESTIONS:
                yield f"{getattr(node, 'name', 'module')}: {first}"


def test_modules_and_pages_use_the_terms_of_the_field():
    found = {path: list(findings(path)) for path in MODULES} | {p: WORDS.findall(text_of(p)) for p in PAGES}
    assert len(found) > 300
    assert not {str(path.relative_to(ROOT)): words for path, words in found.items() if words}
