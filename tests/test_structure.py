"""How the parts hang together: who imports whom, how long a module is, and that paths in documents exist."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted(ROOT.glob("docs/**/*.md"))
PACKAGES = ("graphtrack", "perception")
LONGEST = 800


def name_of(path: Path) -> str:
    """What a module of a package is imported as."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_by(node: ast.AST) -> Iterator[str]:
    """Names that are imported when a module runs, in its functions too; not for a type checker alone."""
    left = [node]
    while left:
        one = left.pop()
        if isinstance(one, ast.Import):
            yield from (name.name for name in one.names)
        elif isinstance(one, ast.ImportFrom) and one.module:
            yield from (f"{one.module}.{name.name}" for name in one.names)
        for_checker = isinstance(one, ast.If) and isinstance(one.test, ast.Name)
        if not (for_checker and one.test.id == "TYPE_CHECKING") and not isinstance(one, ast.expr):
            left += ast.iter_child_nodes(one)


@cache
def imports(folder: str) -> dict[Path, list[str]]:
    """What each module below a folder imports."""
    modules = sorted((ROOT / folder).rglob("*.py"))
    return {path: list(imported_by(ast.parse(path.read_text("utf-8")))) for path in modules}


def within(name: str) -> set[str]:
    """What has to run before a module: all packages that it lies in, and itself."""
    parts = name.split(".")
    return {".".join(parts[: k + 1]) for k in range(len(parts))}


@pytest.mark.parametrize("package", PACKAGES)
def test_modules_do_not_import_each_other_in_a_circle(package: str) -> None:
    known = {name_of(path): names for path, names in imports(package).items()}
    assert len(known) > 50
    needed = {}
    for name, imported in known.items():
        names: set[str] = set().union(*map(within, imported))
        # The packages around a module have begun before it, and it does not wait for their end.
        needed[name] = (names & set(known)) - within(name)
    TopologicalSorter(needed).prepare()  # or CycleError, which names the circle


def test_graphtrack_knows_nothing_of_perception() -> None:
    def users(of: str, folder: str) -> set[str]:
        return {
            name_of(path)
            for path, names in imports(folder).items()
            if any(name.partition(".")[0] == of for name in names)
        }

    assert users("perception", "graphtrack") == set()
    assert users("graphtrack", "perception")


def test_test_modules_are_imported_by_nobody() -> None:
    found = imports("tests")
    modules = {path.stem for path in found if path.stem.startswith("test_") or path.stem == "conftest"}
    assert len(modules) > 50
    for path, names in found.items():
        parts = chain.from_iterable(name.split(".") for name in names)
        assert not modules & set(parts), path


def test_modules_are_short() -> None:
    lines = {
        str(path.relative_to(ROOT)): len(path.read_text("utf-8").splitlines())
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
    }
    assert {name for name, count in lines.items() if count > LONGEST} == set()


def test_paths_in_documents_exist() -> None:
    known = 0
    for document in DOCUMENTS:
        for code in re.findall(r"`([^`\n]+)`", document.read_text("utf-8")):
            for path in re.findall(rf"(?<![\w./-])(?:{'|'.join(PACKAGES)}|tests)/[\w./*-]*", code):
                known += 1
                assert any(ROOT.glob(path.rstrip("/."))), f"{path} in {document.name}"
    assert known > 5
