"""Where compiled code is kept: what is inlined from other files must not outlive them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numba
import pytest

from graphtrack.model.kernels import fingerprint as module
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.fingerprint import fingerprint

SOURCES = {
    "__init__": "",
    "leaf": "from math import sin\n",
    "middle": "from kept.leaf import sin\n",
    "top": "from kept.middle import (\n    sin,\n)\nfrom kept.top import sin\n",
    "relative": "from .leaf import sin\n",
    "other": "import math\n",
}


def forget() -> None:
    for cached in (fingerprint, module._source, module.source_file):
        cached.cache_clear()


@pytest.fixture
def digests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Writes a package, its sources changed as told, and gives the digest of each of its modules."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "kept").mkdir()

    def of(**changed: str) -> dict[str, str]:
        for name, source in (SOURCES | changed).items():
            (tmp_path / "kept" / f"{name}.py").write_text(source)
        forget()
        return {name: fingerprint(f"kept.{name}") for name in SOURCES if name != "__init__"}

    yield of
    forget()
    sys.modules.pop("kept", None)


def test_a_change_reaches_all_that_import_it_and_nothing_else(digests):
    before = digests()
    assert len(set(before.values())) == len(before)
    after = digests(leaf="from math import cos\n")
    changed = [name for name in before if before[name] != after[name]]
    assert changed == ["leaf", "middle", "top", "relative"]
    assert digests() == before


def test_the_folder_of_other_compiled_code_stays_as_it_was(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    @compiled
    def twice(x: float) -> float:
        return 2.0 * x

    assert str(tmp_path) == numba.config.CACHE_DIR
    assert twice(3.0) == 6.0
    assert list(tmp_path.glob(f"{fingerprint(__name__)}/*/*.nbc"))


LEAF = (
    "from graphtrack.model.kernels.compiled import compiled\n@compiled\ndef {name}(x):\n    return {value}\n"
)
PROGRAM = (
    "from leaf import times\n"
    + LEAF.format(name="more", value="times(x) + 1.0")
    + "\nprint(more(2.0), more.stats.cache_path is not None, sum(more.stats.cache_hits.values()))\n"
)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Runs Python in a folder with a program and the module beside it that it inlines; gives what it says."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[2]))

    def ended(*arguments: str, leaf: str = "2.0 * x", stdin: str | None = None) -> str:
        (tmp_path / "program.py").write_text(PROGRAM)
        (tmp_path / "leaf.py").write_text(LEAF.format(name="times", value=leaf))
        done = subprocess.run(
            [sys.executable, *arguments],
            input=stdin,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=100,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return ended


@pytest.mark.slow
def test_a_script_keeps_its_machine_code_until_what_it_inlines_changes(run):
    assert run("program.py") == "5.0 True 0"
    assert run("-m", "program") == "5.0 True 1"
    assert run("program.py", leaf="3.0 * x") == "7.0 True 0"


def test_at_the_prompt_it_compiles_and_keeps_nothing(run):
    assert run("-", stdin=PROGRAM) == "5.0 False 0"


def twice_in(file: str) -> object:
    names = {"__name__": __name__}
    exec(compile(LEAF.format(name="twice", value="2.0 * x"), file, "exec"), names)
    return names["twice"]


def test_a_cell_is_not_taken_for_the_file_of_its_module(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    another = tmp_path / "another.py"
    another.write_text("")
    for file in ("<stdin>", str(another)):
        function = twice_in(file)
        assert (function(3.0), function.stats.cache_path) == (6.0, None)


def test_without_a_folder_to_write_to_it_compiles_all_the_same(monkeypatch, tmp_path):
    (tmp_path / "taken").write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "taken"))
    function = twice_in(__file__)
    assert (function(3.0), function.stats.cache_path) == (6.0, None)
