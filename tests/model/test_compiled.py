"""Where compiled code is kept: what is inlined from other files must not outlive them."""

from __future__ import annotations

import sys
from pathlib import Path

import numba
import pytest

from graphtrack.model.kernels import compiled as module
from graphtrack.model.kernels.compiled import compiled, fingerprint

SOURCES = {
    "__init__": "",
    "leaf": "from math import sin\n",
    "middle": "from kept.leaf import sin\n",
    "top": "from kept.middle import (\n    sin,\n)\nfrom kept.top import sin\n",
    "other": "import math\n",
}


@pytest.fixture
def digests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Writes a package, its sources changed as told, and gives the digest of each of its modules."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "kept").mkdir()

    def of(**changed: str) -> dict[str, str]:
        for name, source in (SOURCES | changed).items():
            (tmp_path / "kept" / f"{name}.py").write_text(source)
        fingerprint.cache_clear()
        module._source.cache_clear()
        return {name: fingerprint(f"kept.{name}") for name in ("leaf", "middle", "top", "other")}

    yield of
    fingerprint.cache_clear()
    module._source.cache_clear()
    sys.modules.pop("kept", None)


def test_a_change_reaches_all_that_import_it_and_nothing_else(digests):
    before = digests()
    assert len(set(before.values())) == 4
    after = digests(leaf="from math import cos\n")
    assert [name for name in before if before[name] != after[name]] == ["leaf", "middle", "top"]
    assert digests() == before


def test_the_folder_of_other_compiled_code_stays_as_it_was(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    @compiled
    def twice(x: float) -> float:
        return 2.0 * x

    assert str(tmp_path) == numba.config.CACHE_DIR
    assert twice(3.0) == 6.0
    assert list(tmp_path.glob(f"{fingerprint(__name__)}/*/*.nbc"))
