"""How the parts hang together: who imports whom, how long a module is, and that paths in documents exist."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted(ROOT.glob("docs/*.md"))
PACKAGES = ("graphtrack", "perception")
LONGEST = 400
LONGER = {
    "graphtrack/inference/online.py": "one class, of which a third is what its arguments and results mean",
}
"""Modules of more lines than `LONGEST`, and why."""

Imports = dict[str, set[str]]


def name_of(path: Path) -> str:
    """What a module of a package is imported as."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def at_module_level(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Statements that run when a module is imported: those in functions do not, nor those for the checker."""
    for statement in body:
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        yield statement
        if isinstance(statement, ast.If) and "TYPE_CHECKING" in ast.unparse(statement.test):
            yield from at_module_level(statement.orelse)
            continue
        for name in ("body", "orelse", "finalbody"):
            yield from at_module_level(getattr(statement, name, []))
        for handler in getattr(statement, "handlers", []):
            yield from at_module_level(handler.body)


def imported(statements: Iterator[ast.AST]) -> Iterator[str]:
    """Names of the modules that statements import, and of what they import from them."""
    for statement in statements:
        if isinstance(statement, ast.Import):
            yield from (alias.name for alias in statement.names)
        elif isinstance(statement, ast.ImportFrom):
            assert statement.level == 0, ast.unparse(statement)
            assert statement.module is not None
            yield statement.module
            yield from (f"{statement.module}.{alias.name}" for alias in statement.names)


def trees(folder: str) -> dict[Path, ast.Module]:
    """The syntax trees of all modules below a folder."""
    return {path: ast.parse(path.read_text("utf-8")) for path in sorted((ROOT / folder).rglob("*.py"))}


def within(name: str) -> list[str]:
    """The packages that a module is in, the innermost last, and itself."""
    parts = name.split(".")
    return [".".join(parts[: k + 1]) for k in range(len(parts))]


def imports_when_loaded(package: str) -> Imports:
    """Module → modules of the package that are loaded for it, with the packages that they are in."""
    found = {name_of(path): tree for path, tree in trees(package).items()}
    edges: Imports = {}
    for name, tree in found.items():
        edges[name] = set()
        for statement in at_module_level(tree.body):
            names = [one for one in imported(iter([statement])) if one in found]
            # From a package its modules may be wanted, and nothing that it has itself.
            if isinstance(statement, ast.ImportFrom) and len(names) == 1 + len(statement.names):
                names = names[1:]
            around = {package for one in names for package in within(one)[:-1]}
            # The packages that the module is in itself are being loaded already.
            edges[name] |= set(names) | (around - set(within(name)))
    return edges


def circle(edges: Imports) -> list[str]:
    """A way through the modules that ends where it began; [] if there is none."""
    done: set[str] = set()

    def visit(name: str, way: list[str]) -> list[str]:
        if name in way:
            return [*way[way.index(name) :], name]
        if name in done:
            return []
        for target in sorted(edges[name]):
            if found := visit(target, [*way, name]):
                return found
        done.add(name)
        return []

    return next((found for name in sorted(edges) if (found := visit(name, []))), [])


def test_a_circle_is_found_where_there_is_one() -> None:
    assert circle({"a": {"b"}, "b": {"c", "d"}, "c": set(), "d": {"b"}}) == ["b", "d", "b"]
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_imports_go_in_circles(package: str) -> None:
    edges = imports_when_loaded(package)
    assert sum(map(len, edges.values())) > len(edges)
    assert circle(edges) == []


def test_graphtrack_knows_nothing_of_perception() -> None:
    def users(of: str, folder: str) -> set[str]:
        return {
            name_of(path)
            for path, tree in trees(folder).items()
            if any(name.partition(".")[0] == of for name in imported(ast.walk(tree)))
        }

    assert users("perception", "graphtrack") == set()
    assert users("graphtrack", "perception")


def test_test_modules_are_imported_by_nobody() -> None:
    found = trees("tests")
    modules = {path.stem for path in found if path.stem.startswith("test_") or path.stem == "conftest"}
    assert len(modules) > 50
    for path, tree in found.items():
        parts = chain.from_iterable(name.split(".") for name in imported(ast.walk(tree)))
        assert not modules & set(parts), path


def test_modules_are_short() -> None:
    lines = {
        str(path.relative_to(ROOT)): len(path.read_text("utf-8").splitlines())
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
    }
    assert {name for name, count in lines.items() if count > LONGEST} == set(LONGER)


def test_paths_in_documents_exist() -> None:
    known = 0
    for document in DOCUMENTS:
        for code in re.findall(r"`([^`\n]+)`", document.read_text("utf-8")):
            for path in re.findall(rf"(?<![\w./-])(?:{'|'.join(PACKAGES)}|tests)/[\w./*-]*", code):
                known += 1
                assert any(ROOT.glob(path.rstrip("/."))), f"{path} in {document.name}"
    assert known > 5
