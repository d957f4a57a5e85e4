"""The structure of the packages: the order in which rooms import each other, circles, sizes, and the map."""

import ast
import re
import runpy
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from itertools import chain
from pathlib import Path

import code_tables
import pytest

import graphtrack as gt
import graphtrack.io
from graphtrack.evaluation.compare import compare
from graphtrack.simulation.sampling import simulate

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


HEAVY = ("gtsam", "matplotlib", "pandas", "scipy", "scipy.special")


def modules_after(code, *arguments):
    """The heavy modules that are loaded when a program ends; ``LOADED()`` within it are those by then."""
    program = f"""
import atexit, sys
LOADED = lambda: [name for name in {HEAVY!r} if name in sys.modules]
atexit.register(lambda: print("LOADED", *LOADED(), file=sys.stderr))
{code}"""
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stderr.split("LOADED")[-1].split()


def test_every_public_name_is_there_and_listed():
    for name in gt.__all__:
        assert getattr(gt, name) is not None, name
    assert dir(gt) == sorted([*gt.__all__, "__version__"])
    assert gt.write is graphtrack.io.write and gt.ReadOptions is graphtrack.io.ReadOptions
    assert gt.compare is compare and gt.simulate is simulate
    with pytest.raises(AttributeError, match="nonsense"):
        _ = gt.nonsense


def test_the_package_itself_and_commands_that_need_no_solver_load_none(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("track_id,frame,t,x,y\n1,0,0,0,0\n1,1,0.1,,\n1,2,0.2,0.2,0\n")
    code = "import graphtrack; graphtrack.read\nfrom graphtrack.cli import main\n"
    for line in ("--version", "--help", "smooth --help", "score --help", "formats", f"info {path}"):
        code += f"sys.argv[1:] = {line.split()}\n"
        code += "try: main()\nexcept SystemExit as ended: assert not ended.code\n"
    assert modules_after(code) == []


def test_gtsam_is_loaded_where_a_graph_is_built_alone():
    code = """
import numpy as np
import graphtrack as gt
from graphtrack import constants, inference, simulation
import graphtrack.cli.commands

graphtrack.cli.commands.program()
track = gt.Track(0, np.arange(4), np.arange(4) * 0.1, np.zeros((4, 2)))
gt.solve(track, "position", engine="chain")
# SciPy itself comes with numba, but its slow modules do not.
assert LOADED() == ["scipy"], LOADED()
import graphtrack.evaluation.compare, graphtrack.simulation.sampling
assert all(map(callable, (gt.compare, gt.simulate, gt.smooth, gt.read, gt.io.read_identified)))
assert "gtsam" not in LOADED()
gt.solve(track, "position", engine="gtsam")
"""
    assert "gtsam" in modules_after(code)


def test_reading_smoothing_tracking_and_scoring_need_no_package_for_pictures_or_learning(tmp_path):
    code = "sys.modules.update(dict.fromkeys(('matplotlib', 'PIL', 'sklearn')))\n"  # importing them fails
    code += "import graphtrack as gt, numpy as np\nfrom graphtrack.simulation.sampling import simulate\n"
    code += "people = simulate('position', n_tracks=2, n_steps=12, rng=np.random.default_rng(0))\n"
    code += "gt.write(people, sys.argv[1])\nread = gt.read(sys.argv[1])\n"
    code += "for found in (gt.smooth(read, 'position'), gt.track_online(read, 'position')):\n"
    code += "    gt.score(found, people), gt.score_states(found, people)\n"
    modules_after(code, tmp_path / "people.csv")


@pytest.mark.parametrize("module", ["json", "duckdb"])
def test_a_command_ends_without_looking_for_garbage_where_nobody_minds(module):
    pytest.importorskip(module)
    code = f"import atexit, gc, sys, {module}\nfrom graphtrack.cli import main\n"
    code += "atexit.register(lambda: print(gc.get_freeze_count() > 0))\n"
    code += "sys.argv[1:] = ['--version']\nmain()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.split()[-1] == str(module != "duckdb")
    assert done.stderr == ""  # nanobind, with which duckdb is bound, would speak of leaks
