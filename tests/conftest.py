"""Fixtures that all tests share."""

import importlib.util
import json
import os
import re
import sys
from collections.abc import Callable, Generator
from pathlib import Path

import pytest
from hypothesis import settings

from graphtrack.errors import InputError

# Parallel tests, or the other work of a shared machine, use all processors: more threads would wait for each
# other, which makes association ten times as slow. Here, since libraries look at it when they are loaded.
if "tests/benchmarks" not in sys.argv:
    for library in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(library, "1")

# CI has the same examples at every run, so that it fails on a change and not by chance. ``nightly`` (make
# test-all) has new and more examples; those that fail are kept in .hypothesis and tried first next time.
settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=25)
settings.register_profile("nightly", deadline=None, max_examples=400, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


Row = dict[str, str | int | float | None]
FIGURES = pytest.StashKey[dict[str, list[Row]]]()
"""Title of a table → its rows."""


def pytest_addoption(parser: pytest.Parser) -> None:
    help_text = "write what tests measure (fixture `figures`) to this file, as `--json` of an experiment"
    parser.addoption("--figures", metavar="FILE", help=help_text)


def pytest_configure(config: pytest.Config) -> None:
    config.stash[FIGURES] = {}
    if config.getoption("--figures") and getattr(config.option, "numprocesses", None):
        raise pytest.UsageError("--figures: without --numprocesses, whose workers measure apart")


@pytest.fixture
def figures(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Record a row of a named table: ``figures(title, {column: value})``; all rows have the same columns."""

    def record(title: str, row: Row) -> None:
        request.config.stash[FIGURES].setdefault(title, []).append(row)

    return record


def pytest_sessionfinish(session: pytest.Session) -> None:
    path = session.config.getoption("--figures")
    if path:
        from graphtrack.experiments.harness import Table  # loads what must find the number of threads set

        tables = [Table.of(title, rows).to_dict() for title, rows in session.config.stash[FIGURES].items()]
        Path(path).write_text(json.dumps(tables), encoding="utf-8")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Documents and notebooks come first: at the end one worker would wait while the other runs them."""
    items.sort(key=lambda item: item.path.parent != Path(__file__).parent)


if importlib.util.find_spec("gtsam") is None:  # Windows: there is no wheel
    collect_ignore_glob = ["benchmarks/*"]
    for test_file in Path(__file__).parent.rglob("*.py"):
        if re.search(r"^(import gtsam|from (gtsam|costs) )", test_file.read_text("utf-8"), re.MULTILINE):
            collect_ignore_glob.append(str(test_file))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
        """Skip tests that turn out to need GTSAM."""
        try:
            return (yield)
        except InputError as error:
            if error.found != "no package gtsam":
                raise
            pytest.skip("needs GTSAM")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real recordings: ``GRAPHTRACK_DATA``, else ``../shared/data`` next to the repository."""
    given = os.environ.get("GRAPHTRACK_DATA")
    folder = Path(given) if given else Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}; set GRAPHTRACK_DATA to your copy")
    return folder


@pytest.fixture
def cwd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temporary folder, in which the test runs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
