"""Docstrings: their examples run, and the reference has each parameter's own type and default."""

import doctest
import json
import re
import subprocess
import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

import griffe
import pytest
from documents import ROOT, Block, blocks

import graphtrack as gt
from graphtrack.io.options import FileReading, Reading, ReadOptions

ENTRIES = re.findall(
    r"^::: ([\w.]+)$",
    "".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs/reference").glob("*.md"))),
    flags=re.M,
)
WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for package in ("graphtrack", "perception")
    for path in (ROOT / package).rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_run(module):
    found = doctest.testmod(import_module(module))
    assert found.attempted and not found.failed


@pytest.fixture(scope="module")
def packages():
    """The packages as the reference sees them."""
    extensions = griffe.load_extensions(str(ROOT / "docs" / "hooks" / "docstrings.py"))
    loader = griffe.GriffeLoader(extensions=extensions, docstring_parser="numpy", search_paths=[ROOT])
    found = {name: loader.load(name) for name in ("graphtrack", "perception")}
    loader.resolve_aliases()
    return found


def with_members(entry):
    """A function or class, and those in it."""
    yield entry
    if entry.is_class:
        for member in entry.members.values():
            if not member.is_alias and (member.is_function or member.is_class):
                yield from with_members(member)


def sections(entry, kind):
    parsed = [] if entry.docstring is None else entry.docstring.parse("numpy")
    return [item for section in parsed if section.kind.value == kind for item in section.value]


def test_each_parameter_has_its_own_type_and_default(packages):
    assert len(ENTRIES) > 50
    checked, wrong = 0, []
    for entry in ENTRIES:
        package, _, path = entry.partition(".")
        found = packages[package][path]
        for one in with_members(found.final_target if found.is_alias else found):
            for item in sections(one, "parameters"):
                own = one.parameters[item.name.lstrip("*")]
                checked += 1
                if (str(item.annotation), str(item.default)) != (str(own.annotation), str(own.default)):
                    wrong.append(f"{one.path}({item.name}: {item.annotation} = {item.default})")
            for item in sections(one, "attributes"):
                own = one.members.get(item.name)
                checked += 1
                if own is not None and own.is_attribute and str(item.annotation) != str(own.annotation):
                    wrong.append(f"{one.path}.{item.name}: {item.annotation}")
    assert checked > 300 and not wrong


PAGES = ["README.md", *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md"))]
FRAGMENT = re.compile(r"<!-- fragment: (.+?) -->\n+```python\n")
"""Comment above a block that is not checked, with the reason."""
FRAGMENTS: dict[str, int] = {}
"""Blocks of each page that are marked so."""


def module_name(page: str) -> str:
    return re.sub(r"\W", "_", page.removesuffix(".md").lower())


def checked(page: str) -> list[Block]:
    """The Python blocks of a page but fragments."""
    text = (ROOT / page).read_text(encoding="utf-8")
    left_out = {text[found.end() :].split("```", 1)[0] for found in FRAGMENT.finditer(text)}
    return [block for block in blocks(page) if block.kind == "python" and block.text not in left_out]


STRICT = """
disallow_any_generics = true
disallow_subclassing_any = true
disallow_untyped_calls = true
disallow_incomplete_defs = true
disallow_untyped_decorators = true
warn_return_any = true
implicit_reexport = false
strict_equality = true
extra_checks = true
"""
"""What ``--strict`` adds to this repository's settings, for single modules."""


def mypy(folder: Path, modules: Iterable[str]) -> list[tuple[str, str]]:
    """The module and the text of each line that mypy writes.

    With this repository's settings for its packages, whose results it has from `make lint`.
    """
    settings = (ROOT / "pyproject.toml").read_text("utf-8")
    pages = f"\n[[tool.mypy.overrides]]\nmodule = {json.dumps(list(modules))}\n{STRICT}"
    (folder / "pyproject.toml").write_text(settings + pages, "utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--no-error-summary", "--config-file", folder / "pyproject.toml"]
        + [str(folder / f"{name}.py") for name in modules],
        cwd=ROOT,
        env={"PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=1200,
    )
    assert done.returncode in (0, 1), done.stderr
    lines = [(ROOT / line.split(":", 1)[0], line) for line in done.stdout.splitlines()]
    # The cache has the errors of an earlier run's folder of the same name.
    return [(path.stem, line) for path, line in lines if path.parent.name == folder.name]


WRONG = {
    "an option of reading that is none": "gt.read('x.csv', nonsense=3)",
    "an option of another type": "gt.read('x.csv', fps='25')",
    "an option of smoothing that is none": "gt.smooth('x.csv', nonsense=3)",
    "an option of tracking that is none": "gt.track_online('x.csv', nonsense=3)",
    "an option of an adapter that is none": "gt.from_supervision([], fps=25, nonsense=3)",
    "a label in brackets": "gt.read('x.csv')['anna']",
    "half a number": "gt.read('x.csv').by_id(7.5)",
}
RIGHT = """
import graphtrack as gt
import numpy as np
import numpy.typing as npt

def of_track(track: gt.Track) -> npt.NDArray[np.float64]:
    smoothed: gt.Track = gt.smooth(track, fill=True, engine="chain")
    return smoothed.std("x")

def of_file(path: str) -> gt.TrackSet:
    online: gt.TrackSet = gt.track_online(path, lag=1.0, fps=25.0)
    return gt.smooth(online[:2], resample=5.0)
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The errors of each module, of one run of mypy on all of them."""
    folder = tmp_path_factory.mktemp("typed")
    sources = {
        module_name(page): "\n\n".join(b.text for b in checked(page)) for page in PAGES if checked(page)
    }
    wrong = [f"def case_{k}() -> object:\n    return {line}\n" for k, line in enumerate(WRONG.values())]
    sources |= {"right": RIGHT, "wrong": "import graphtrack as gt\n\n" + "\n".join(wrong)}
    for name, text in sources.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    found: dict[str, list[str]] = {name: [] for name in sources}
    for name, line in mypy(folder, sources):
        found[name].append(line)
    return found


@pytest.mark.parametrize("page", [page for page in PAGES if checked(page)])
def test_the_python_of_a_page_is_typed(page: str, told: dict[str, list[str]]) -> None:
    assert told[module_name(page)] == []


def test_what_is_wrong_is_an_error_of_mypy(told: dict[str, list[str]]) -> None:
    errors = [line for line in told["wrong"] if " error: " in line]
    assert {int(line.split(":")[1]) for line in errors} == {4 + 3 * k for k in range(len(WRONG))}
    assert told["right"] == []


def test_blocks_that_are_not_checked_are_known() -> None:
    marked = {
        page: len(found) for page in PAGES if (found := FRAGMENT.findall((ROOT / page).read_text("utf-8")))
    }
    assert marked == FRAGMENTS


def test_names_of_options_are_the_fields_of_read_options() -> None:
    fields = {name: one.type for name, one in ReadOptions.__dataclass_fields__.items()}
    assert {name: str(kind.__forward_arg__) for name, kind in Reading.__annotations__.items()} == fields
    assert set(FileReading.__annotations__) - set(fields) == {"format"}


@pytest.mark.parametrize(
    "call",
    [
        lambda: gt.read("x.csv", nonsense=3),  # type: ignore[call-arg]
        lambda: gt.smooth("x.csv", nonsense=3),  # type: ignore[call-overload]
        lambda: gt.track_online("x.csv", nonsense=3),  # type: ignore[call-overload]
        lambda: gt.associate("x.csv", nonsense=3),  # type: ignore[call-arg]
        lambda: gt.from_supervision([], fps=25.0, nonsense=3),  # type: ignore[call-arg]
        lambda: gt.from_ultralytics([], fps=25.0, nonsense=3),  # type: ignore[call-arg]
        lambda: gt.from_movement(None, nonsense=3),  # type: ignore[call-arg]
    ],
)
def test_unknown_options_are_errors_at_run_time(call: object) -> None:
    assert callable(call)
    with pytest.raises(gt.InputError, match="unknown options nonsense"):
        call()
