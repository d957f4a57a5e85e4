"""No module needs itself, by whatever way round."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import graphtrack

ROOT = Path(graphtrack.__file__).parent


def modules() -> dict[str, Path]:
    """Name → file; a package's is its ``__init__``."""
    found = {}
    for path in ROOT.rglob("*.py"):
        parts = (ROOT.name, *path.relative_to(ROOT).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(node: ast.AST) -> Iterator[str]:
    """Names that are imported when a module runs, in its functions too; not for a type checker alone."""
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        return
    if isinstance(node, ast.Import):
        yield from (name.name for name in node.names)
    if isinstance(node, ast.ImportFrom) and node.module:
        yield from (f"{node.module}.{name.name}" for name in node.names)
    for child in ast.iter_child_nodes(node):
        yield from imported(child)


def packages(name: str) -> set[str]:
    """What has to run before a module: all packages that it lies in, and itself."""
    parts = name.split(".")
    return {".".join(parts[:k]) for k in range(1, len(parts) + 1)}


def test_modules_do_not_import_each_other_in_a_circle() -> None:
    known = modules()
    assert len(known) > 100
    needed = {}
    for name, path in known.items():
        names = set().union(*map(packages, imported(ast.parse(path.read_text()))))
        # The packages around a module have begun before it, and it does not wait for their end.
        needed[name] = {other for other in names if other in known} - packages(name)
    TopologicalSorter(needed).prepare()  # or CycleError, which names the circle
