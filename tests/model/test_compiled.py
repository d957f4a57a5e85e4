"""Declaration of compiled functions, the folder of their machine code, and the log of compiling."""

from __future__ import annotations

import ast
import logging
import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numba
import numpy as np
import pytest
from selection import others_slow

from graphtrack import machine_code
from graphtrack.errors import InputError
from graphtrack.kernels import compilation
from graphtrack.kernels.compilation import Rehearsal, allocating, compiled, machine_code_folder, make_ready

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


@pytest.mark.slow
def test_functions_without_reference_counting_call_none_that_returns_arrays() -> None:
    """They would not release what they got: it would stay in memory for good."""
    functions = [
        (function, {name.id for name in function.decorator_list if isinstance(name, ast.Name)})
        for package in PACKAGES
        for path in package.rglob("*.py")
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(function, ast.FunctionDef)
    ]
    numbers = re.compile(r"(?:None|bool|int|float|tuple\[[\[\], a-z.]+\])")
    counting = [one for one, names in functions if names & {"allocating", "inner_allocating"}]
    handing = {one.name for one in counting if not numbers.fullmatch(ast.unparse(one.returns or ast.Tuple()))}
    assert "chain_of" in handing and "find_other_basin" not in handing
    others = [one for one, names in functions if names & {"compiled", "inner", "merged"}]
    calls = {
        (one.name, call.func.id)
        for one in others
        for call in ast.walk(one)
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
    }
    assert len(others) > 100 and not [pair for pair in calls if pair[1] in handing]


def test_numba_s_own_setting_stays_as_it_was(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    @compiled
    def twice(x: float) -> float:
        return 2.0 * x

    assert str(tmp_path) == numba.config.CACHE_DIR and twice(3.0) == 6.0
    assert list(tmp_path.glob("*/test_compiled-*/*/*.nbc"))


def test_without_a_folder_to_write_to_it_compiles_all_the_same(monkeypatch, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "taken"))
    assert machine_code_folder() is None and compiled(lambda x: 2.0 * x)(3.0) == 6.0


def test_a_numba_that_does_not_compile_is_an_error(monkeypatch) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    with pytest.raises(InputError, match="NUMBA_DISABLE_JIT"):
        compiled(lambda x: x)


@pytest.mark.slow
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


@pytest.mark.slow
def test_at_the_prompt_it_compiles() -> None:
    done = subprocess.run([sys.executable, "-"], input=PROMPT, capture_output=True, text=True, check=True)
    assert done.stdout == "4.0\n"


SOURCES = {
    "kernels/arithmetic": "@compiled\ndef log(x): return x\n",
    "low": "@compiled\ndef low(x): return x\n",
    "model/middle": "from graphtrack.low import low\n@inner\ndef middle(x): return low(x)\n",
    "top": "from graphtrack.model import (\n    plain,\n    middle,\n)\n@allocating\ndef top(x): ...\n",
    "plain": "from graphtrack import low\n",
    "model/plain": "from graphtrack.other import other\n",
    "other": "@compiled\ndef other(x): return x\n",
}


@pytest.mark.parametrize(
    ("edited", "compiled_again"),
    [
        ("kernels/arithmetic", {"kernels/arithmetic", "low", "model/middle", "top", "other"}),
        ("low", {"low", "model/middle", "top"}),
        ("model/middle", {"model/middle", "top"}),
        ("top", {"top"}),
        ("other", {"other"}),
        ("model/plain", set()),
    ],
)
def test_an_edit_compiles_again_what_depends_on_it(monkeypatch, tmp_path, edited, compiled_again) -> None:
    files = {name: tmp_path / "graphtrack" / f"{name}.py" for name in SOURCES}
    for name, path in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(SOURCES[name])
    monkeypatch.setattr(machine_code, "_PACKAGES", tmp_path)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "code"))
    declares = {name: path for name, path in files.items() if "plain" not in name}

    def folders() -> dict[str, Path | None]:
        machine_code._source.cache_clear()
        machine_code._state.cache_clear()
        return {name: machine_code.folder_of(str(path)) for name, path in declares.items()}

    before = folders()
    machine_code.mark("a kind", map(str, declares.values()))
    assert machine_code.is_marked("a kind")
    files[edited].write_text(SOURCES[edited] + "# edited\n")
    after = folders()
    assert {name for name in after if after[name] != before[name]} == compiled_again
    assert machine_code.is_marked("a kind") == (not compiled_again)


def test_compiled_functions_call_only_what_their_digest_covers() -> None:
    compiled_modules = [
        import_module(".".join(path.relative_to(PACKAGES[0].parent).with_suffix("").parts))
        for path in sorted(PACKAGES[0].rglob("*.py"))
        if machine_code._DECLARES.search(path.read_bytes()) and path.name != "compilation.py"
    ]
    assert len(compiled_modules) > 15
    for module in compiled_modules:
        covered = machine_code.dependencies(Path(str(module.__file__)))
        for function in [one for one in vars(module).values() if hasattr(one, "py_func")]:
            for name in function.py_func.__code__.co_names:
                called = getattr(vars(module).get(name), "py_func", None)
                assert called is None or Path(called.__code__.co_filename) in covered, (module, name)


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
    assert before == "compiling something, once on this machine: from 10 s on …"
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


TWO_JOBS = """
from graphtrack.kernels.compilation import compiled
@compiled
def one(x: float) -> float:
    return 2.0 * x
@compiled
def two(x: float) -> float:
    return 3.0 * x
def run_one():
    one(1.0)
def run_two():
    two(1.0)
"""
TOGETHER = """
from jobs import one, run_one, run_two, two
from graphtrack.kernels.compilation import Rehearsal, make_ready
some = Rehearsal("one", run_one, 2.0), Rehearsal("two", run_two, 2.0), Rehearsal("three", lambda: 0, 1.0)
make_ready("something", *some)
print([len(function.stats.cache_hits) for function in (one, two)])
"""


@pytest.mark.slow
@pytest.mark.skipif(compilation.processors() < 2, reason="one process compiles alone")
def test_independent_work_is_compiled_by_several_processes(tmp_path) -> None:
    (tmp_path / "jobs.py").write_text(TWO_JOBS)
    (tmp_path / "program.py").write_text(TOGETHER)
    status, output, log = run_with(tmp_path / "code", tmp_path / "program.py")
    assert (status, output) == (0, "[0, 1]"), log
    assert len(log) == 2 and log[0].endswith("from 5 s on …")
    assert run_with(tmp_path / "code", tmp_path / "program.py") == (0, "[1, 1]", [])


DAMAGES = {
    "empty": lambda content: b"",
    "cut": lambda content: content[: len(content) // 2],
    "zeros": lambda content: bytes(len(content)),
    "noise": lambda content: np.random.default_rng(0).bytes(len(content)),
}
PROGRAM = """
import logging, sys
from graphtrack.kernels.compilation import Rehearsal, compiled, make_ready
@compiled
def inner(x: float) -> float:
    return 2.0 * x
@compiled
def outer(x: float) -> float:
    return inner(x) + 1.0
if __name__ == "__main__":
    make_ready("something", Rehearsal("a kind", lambda: outer(2.0), 1.0))
    print(outer(2.0), sum(len(one.stats.cache_hits) for one in (inner, outer)))
"""


@pytest.fixture(scope="module")
def kept_code(tmp_path_factory):
    """A program that has run once, and the folder of its machine code."""
    folder = tmp_path_factory.mktemp("kept")
    (folder / "program.py").write_text(PROGRAM)
    assert run_with(folder / "code", folder / "program.py") == (0, "5.0 0", [])
    return folder


def run_with(code: Path, program: Path, **environment: str) -> tuple[int, str, list[str]]:
    """Run the program with a folder of machine code: status, output and log."""
    done = subprocess.run(
        [sys.executable, program],
        env={**os.environ, "NUMBA_CACHE_DIR": str(code), **environment},
        capture_output=True,
        text=True,
        timeout=600,
    )
    return done.returncode, done.stdout.strip(), done.stderr.splitlines()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damage", "ending"),
    others_slow(
        [(one, ending) for one in DAMAGES for ending in (".nbi", ".nbc")],
        [("noise", ".nbc")],
    ),
)
def test_damaged_machine_code_is_replaced_with_one_line(kept_code, tmp_path, ending, damage) -> None:
    code, program = tmp_path / "code", kept_code / "program.py"
    shutil.copytree(kept_code / "code", code)
    files = list(code.rglob(f"*{ending}"))
    assert len(files) == 2
    for path in files:
        path.write_bytes(DAMAGES[damage](path.read_bytes()))
    status, output, log = run_with(code, program)
    assert (status, output) == (0, "5.0 0")
    assert len(log) == 1 and log[0].startswith(f"machine code in {code}") and "compiling again" in log[0]
    assert run_with(code, program) == (0, "5.0 1", []), "loaded, as outer has inner within it"


@pytest.mark.slow
def test_machine_code_that_was_deleted_is_compiled_again(kept_code, tmp_path) -> None:
    code = tmp_path / "code"
    shutil.copytree(kept_code / "code", code)
    for path in code.rglob("*.nbc"):
        path.unlink()
    assert run_with(code, kept_code / "program.py") == (0, "5.0 0", [])


FULL_DISK = """
import builtins, errno, runpy, sys
from pathlib import Path
opened, code = builtins.open, sys.argv[2]
def full(path, mode="r", *args, **kwargs):
    if "w" in mode and str(path).startswith(code):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))
    return opened(path, mode, *args, **kwargs)
builtins.open = full
runpy.run_path(sys.argv[1], run_name="__main__")
"""


@pytest.mark.slow
def test_a_full_disk_of_machine_code_ends_no_run(kept_code, tmp_path) -> None:
    code, other = tmp_path / "code", tmp_path / "other"
    other.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, kept_code / "program.py", code],
        env={**os.environ, "NUMBA_CACHE_DIR": str(code), "TMPDIR": str(other)},
        capture_output=True,
        text=True,
        timeout=600,
    )
    (line,) = done.stderr.splitlines()
    assert done.returncode == 0 and done.stdout == "5.0 0\n"
    assert "No space left on device" in line and "compiling for this process" in line
    assert not list(other.iterdir()), "the folder of the process is gone"


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o720])
@pytest.mark.parametrize("inner", [False, True])
def test_a_folder_in_which_others_may_write_is_not_used(monkeypatch, tmp_path, caplog, mode, inner) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    folder = machine_code_folder()
    assert folder is not None and folder.stat().st_mode & 0o777 == 0o700
    (folder if inner else tmp_path).chmod(mode)
    assert machine_code_folder() is None
    assert "others can write to" in logged(caplog, Rehearsal("a kind", list, 12.0))[0]


def test_a_shared_temporary_folder_may_hold_it(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    tmp_path.chmod(0o1777)
    assert machine_code_folder() is not None


@pytest.mark.skipif(not hasattr(os, "chown") or os.getuid() != 0, reason="only root gives files away")
def test_a_folder_of_another_user_is_not_used(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    folder = machine_code_folder()
    assert folder is not None
    os.chown(folder, 12345, -1)
    assert machine_code_folder() is None


def test_errors_elsewhere_are_no_damage(monkeypatch, tmp_path, caplog) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def early() -> None:
        raise EOFError("a file that ends")

    with pytest.raises(EOFError):
        make_ready("something", Rehearsal("a kind", early, 1.0))
    assert not caplog.records
