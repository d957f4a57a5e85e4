"""What another process compiles is there for this one, and what it is not done with hinders nobody."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numba
import pytest

from graphtrack.model.kernels.beside import compiled_beside
from graphtrack.readiness import is_cold

SOURCE = """
from graphtrack.model.kernels.compiled import apart

@apart
def twice(x):
    return 2.0 * x

@apart
def thrice(x):
    return 3.0 * x
"""


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """A module with compiled functions, none of which has machine code."""
    name = f"made_for_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kept"))
    monkeypatch.setattr("graphtrack.model.kernels.beside.processors", lambda: 2)
    yield importlib.import_module(name)
    del sys.modules[name]


def test_what_is_asked_for_is_there_once_it_was_waited_for(made: ModuleType) -> None:
    assert is_cold(made.twice) and is_cold(made.thrice)
    with compiled_beside([f"import {made.__name__} as made", "made.twice(1.0)"]) as taken_over:
        taken_over()
        assert not is_cold(made.twice)
        assert made.twice(4.0) == 8.0
        assert sum(made.twice.stats.cache_hits.values()) == 1
    assert is_cold(made.thrice)


def test_spare_work_is_taken_over_as_far_as_it_came(made: ModuleType, tmp_path: Path) -> None:
    came = tmp_path / "came"
    spare = [
        "made.thrice(1.0)",
        f"open({str(came)!r}, 'w').close()",
        "import time; time.sleep(600.0)",
        "made.thrice(1)",
    ]
    with compiled_beside([f"import {made.__name__} as made; made.twice(1.0)"], spare) as taken_over:
        taken_over()
        assert not is_cold(made.twice)
        deadline = time.monotonic() + 60.0
        while not came.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
    # Nobody has waited ten minutes.
    assert made.thrice(4.0) == 12.0
    assert sum(made.thrice.stats.cache_hits.values()) == 1
    assert [path.name for path in (tmp_path / "kept").glob("compiling-*")] == []


def test_what_fails_there_is_compiled_here(made: ModuleType, tmp_path: Path) -> None:
    with compiled_beside(["raise SystemExit(3)", f"import {made.__name__} as made; made.twice(1.0)"]) as wait:
        wait()
        assert is_cold(made.twice)
    assert made.twice(4.0) == 8.0
    assert [path.name for path in (tmp_path / "kept").glob("compiling-*")] == []


def test_spare_work_ends_with_whoever_it_is_for(made: ModuleType, tmp_path: Path) -> None:
    """A process that is killed has no time to end the other one."""
    came = tmp_path / "came"
    killed = f"""
import os, signal, time
from graphtrack.model.kernels import beside
beside.processors = lambda: 2
spare = ["import time; time.sleep(0.5)", "open({str(came)!r}, 'w').close()"]
with beside.compiled_beside(["pass"], spare) as wait:
    wait()
    os.kill(os.getpid(), signal.SIGKILL)
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    done = subprocess.run([sys.executable, "-c", killed], env=environment, check=False)
    assert done.returncode == -signal.SIGKILL
    time.sleep(1.0)
    assert not came.exists()


def test_what_killed_processes_left_is_removed_after_a_while(made: ModuleType, tmp_path: Path) -> None:
    old, new = tmp_path / "kept" / "compiling-old", tmp_path / "kept" / "compiling-new"
    for folder in (old, new):
        folder.mkdir(parents=True)
    (old / "code.nbc").touch()
    os.utime(old, (0.0, 0.0))
    with compiled_beside(["pass"]) as taken_over:
        taken_over()
    assert not old.exists() and new.exists()
