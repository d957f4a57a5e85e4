"""The structure of the packages: the order in which rooms import each other, circles, sizes, and the map."""

import ast
import re
import runpy
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from itertools import chain
from pathlib import Path

import code_tables
import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted(ROOT.glob("docs/**/*.md"))
PACKAGES = ("graphtrack", "perception")
MAP = (ROOT / "docs" / "architecture.md").read_text("utf-8")
MODULES_OF_A_FOLDER, SHORTEST = 15, 40
ENTRY_POINTS = ("main", "commands")


def name_of(path: Path) -> str:
    """Return the name that a module is imported by."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_by(tree: ast.AST) -> Iterator[str]:
    """Return the names that a module imports: at its top, in functions and for a type checker."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{name.name}" for name in node.names)


@cache
def imports(folder: str) -> dict[Path, list[str]]:
    """Return the imports of each module below a folder."""
    modules = sorted((ROOT / folder).rglob("*.py"))
    return {path: list(imported_by(ast.parse(path.read_text("utf-8")))) for path in modules}


@cache
def graph(package: str) -> dict[str, set[str]]:
    """Return the modules of a package that each of its modules imports."""
    known = {name_of(path): names for path, names in imports(package).items()}
    found: dict[str, set[str]] = {}
    for name, names in known.items():
        modules = {one if one in known else one.rpartition(".")[0] for one in names}
        found[name] = (modules & set(known)) - {name, package}
    del found[package]  # its names are those of the rooms, taken when they are asked for
    return found


def order(package: str) -> list[str]:
    """Return the rooms of a package as the map orders them, the uppermost first.

    Rooms on one line stand in an order too: those on the left may import those on the right.
    """
    block = re.search(rf"^    {package}:((?:\n      .+)+)", MAP, re.MULTILINE)
    assert block
    return re.findall(r"\w+", block[1])


@pytest.mark.parametrize("package", PACKAGES)
def test_modules_do_not_import_each_other_in_a_circle(package: str) -> None:
    needed = graph(package)
    assert len(needed) > 50
    TopologicalSorter(needed).prepare()  # or CycleError, which names the circle


@pytest.mark.parametrize("package", PACKAGES)
def test_rooms_import_only_rooms_below(package: str) -> None:
    rooms = order(package)
    wrong = []
    for name, names in graph(package).items():
        above = name.split(".")[1]
        if above.startswith("__"):
            continue
        wrong += [
            f"{name} imports {one}"
            for one in names
            if one.split(".")[1] != above and rooms.index(one.split(".")[1]) <= rooms.index(above)
        ]
    assert wrong == []


@pytest.mark.parametrize("package", PACKAGES)
def test_the_map_has_every_room(package: str) -> None:
    folder = ROOT / package
    rooms = {path.name for path in folder.iterdir() if (path / "__init__.py").exists()}
    rooms |= {path.stem for path in folder.glob("*.py") if not path.stem.startswith("__")}
    assert set(order(package)) == rooms and len(order(package)) == len(rooms)
    picture = (ROOT / "docs" / "images" / "rooms.svg").read_text("utf-8")
    for room in rooms:
        assert f">{room}<" in picture, room
        assert re.search(rf"`{package}/{room}(/|\.py)` \| \w", code_tables.rooms()), room


def test_graphtrack_knows_nothing_of_perception() -> None:
    def users(of: str, folder: str) -> set[str]:
        return {
            name_of(path)
            for path, names in imports(folder).items()
            if any(name.partition(".")[0] == of for name in names)
        }

    assert users("perception", "graphtrack") == set() and users("graphtrack", "perception")


def test_test_modules_are_imported_by_nobody() -> None:
    found = imports("tests")
    modules = {path.stem for path in found if path.stem.startswith("test_") or path.stem == "conftest"}
    assert len(modules) > 50
    for path, names in found.items():
        parts = chain.from_iterable(name.split(".") for name in names)
        assert not modules & set(parts), path


@pytest.mark.parametrize("package", PACKAGES)
def test_folders_and_modules_have_a_size_that_can_be_taken_in(package: str) -> None:
    files = [path for path in (ROOT / package).rglob("*.py") if not path.stem.startswith("__")]
    folders = Counter(path.parent for path in files)
    assert {str(path): n for path, n in folders.items() if n > MODULES_OF_A_FOLDER} == {}
    modules = [path for path in files if path.stem not in ENTRY_POINTS]
    assert [str(path) for path in modules if len(path.read_text("utf-8").splitlines()) < SHORTEST] == []


def test_paths_in_documents_exist() -> None:
    known = 0
    for document in DOCUMENTS:
        for code in re.findall(r"`([^`\n]+)`", document.read_text("utf-8")):
            for path in re.findall(rf"(?<![\w./-])(?:{'|'.join(PACKAGES)}|tests)/[\w./*-]*", code):
                known += 1
                assert any(ROOT.glob(path.rstrip("/."))), f"{path} in {document.name}"
    assert known > 5


def test_every_mutant_matches_one_piece_of_the_packages() -> None:
    mutants = runpy.run_path(str(ROOT / "tests" / "mutants" / "run.py"))["mutants"]()
    text = "".join(path.read_text("utf-8") for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    assert len(mutants) > 40 and {one.name for one in mutants if text.count(one.old) != 1} == set()
    assert all((ROOT / folder).exists() for one in mutants for folder in one.tests)
