"""Declaration of compiled functions, the folder of their machine code, and the log of compiling."""

from __future__ import annotations

import logging
import os
import re
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.kernels import compilation
from graphtrack.kernels.compilation import Rehearsal, allocating, compiled, machine_code_folder, make_ready

module = sys.modules["graphtrack.kernels.compilation"]  # the package has the function under that name
PACKAGES = [Path(__file__).parents[2] / name for name in ("graphtrack", "perception")]


def test_what_makes_arrays_or_hands_them_back_has_to_say_so(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))  # both forms of a function share its entry

    def total(n: int) -> float:
        return float(np.ones(n).sum())

    with pytest.raises(numba.core.errors.NumbaError, match=r"NRT required|Only accept returning"):
        compiled(total)(3)
    of_arrays = allocating(total)
    assert compiled(lambda n: 2.0 * of_arrays(n))(3) == 6.0

    def rest(values: np.ndarray) -> np.ndarray:
        return values[1:]

    np.testing.assert_array_equal(allocating(rest)(np.arange(3.0)), [1.0, 2.0])
    with pytest.raises(TypeError, match=r"rest returns np\.ndarray"):
        compiled(rest)


def test_numba_s_own_setting_stays_as_it_was(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    @compiled
    def twice(x: float) -> float:
        return 2.0 * x

    assert str(tmp_path) == numba.config.CACHE_DIR and twice(3.0) == 6.0
    assert list(tmp_path.glob(f"{module._digest()}/*/*.nbc"))


def test_without_a_folder_to_write_to_it_compiles_all_the_same(monkeypatch, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "taken"))
    assert machine_code_folder() is None and compiled(lambda x: 2.0 * x)(3.0) == 6.0


def test_a_numba_that_does_not_compile_is_an_error(monkeypatch) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    with pytest.raises(InputError, match="NUMBA_DISABLE_JIT"):
        compiled(lambda x: x)


@pytest.mark.parametrize("threads", ["0", "-2"])
def test_settings_that_numba_refuses_are_one_error(threads: str, tmp_path: Path) -> None:
    table = tmp_path / "tracks.csv"
    table.write_text("track_id,frame,t,x,y\n1,0,0.0,0.0,0.0\n1,1,0.1,0.1,0.0\n")
    done = subprocess.run(
        [sys.executable, "-m", "graphtrack", "smooth", table, "-o", tmp_path / "out.csv"],
        env={**os.environ, "NUMBA_NUM_THREADS": threads},
        capture_output=True,
        text=True,
    )
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2
    assert line.startswith("error: ") and f"NUMBA_NUM_THREADS={threads}" in line


PROMPT = """
from graphtrack.kernels.compilation import compiled
@compiled
def twice(x):
    return 2.0 * x
print(twice(2.0))
"""


def test_at_the_prompt_it_compiles() -> None:
    done = subprocess.run([sys.executable, "-"], input=PROMPT, capture_output=True, text=True, check=True)
    assert done.stdout == "4.0\n"


def test_the_folder_changes_with_every_source_of_compiled_functions(monkeypatch, tmp_path: Path) -> None:
    kernels, others = tmp_path / "graphtrack" / "kernels", tmp_path / "graphtrack"
    kernels.mkdir(parents=True)
    monkeypatch.setattr(module, "__file__", str(kernels / "compiled.py"))
    plain, compiling = "a = 1", "@compiled\ndef one() -> int:\n    return 1\n"
    digests = [module._digest.__wrapped__()]
    for path, text in (
        (others / "two.py", plain),
        (others / "two.py", compiling),
        (kernels / "one.py", plain),
        (kernels / "one.py", "a = 2"),
    ):
        path.write_text(text)
        digests.append(module._digest.__wrapped__())
    assert digests[0] == digests[1] and len(set(digests)) == 4


def test_nothing_stands_on_undocumented_parts_of_numba() -> None:
    """Public: decorators, `numba.extending`, and what its extension guide uses of `numba.core`."""
    private = re.compile(
        r"numba\.core\.(caching|compiler|dispatcher|registry|runtime|cpu|typed_passes)|llvmlite\.binding"
        r"|from numba\.core import .*\b(caching|compiler|dispatcher|registry|runtime|cpu)\b"
    )
    sources = [path for package in PACKAGES for path in package.rglob("*.py")]
    assert len(sources) > 100
    assert [path.name for path in sources if private.search(path.read_text(encoding="utf-8"))] == []


@pytest.fixture(autouse=True)
def new_process(monkeypatch, caplog) -> None:
    monkeypatch.setattr(compilation, "_READY", set())
    caplog.set_level(logging.WARNING, "graphtrack")


def logged(caplog: pytest.LogCaptureFixture, rehearsal: Rehearsal) -> list[str]:
    """The log of making something ready."""
    caplog.clear()
    make_ready("something", rehearsal)
    # Other packages log when garbage is collected, which may be now.
    return [record.getMessage() for record in caplog.records if record.name == "graphtrack"]


def test_it_is_logged_once_on_a_machine_and_run_once_in_a_process(
    monkeypatch, tmp_path: Path, caplog
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    runs: list[int] = []
    rehearsal = Rehearsal("a kind", lambda: runs.append(1), 12.0)
    assert rehearsal.is_cold()
    before, after = logged(caplog, rehearsal)
    assert before == "compiling something, once on this machine: about 10 s …"
    assert after.startswith("compiled in ") and logged(caplog, rehearsal) == [] and len(runs) == 1
    compilation._READY.clear()
    assert not rehearsal.is_cold() and logged(caplog, rehearsal) == [] and len(runs) == 2
    assert logged(caplog, Rehearsal("a short one", list, 2.0)) == []
    failing = Rehearsal("another", lambda: [][0], 1.0)
    for _ in range(2):  # a failed rehearsal is not ready
        with pytest.raises(IndexError):
            make_ready("something", failing)
        assert failing.is_cold()


def test_where_nothing_can_be_kept_it_says_so_in_every_process(monkeypatch, tmp_path: Path, caplog) -> None:
    (tmp_path / "taken").write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "taken"))
    for _ in range(2):
        assert "in every process" in logged(caplog, Rehearsal("a kind", list, 12.0))[0]
        compilation._READY.clear()
