"""Compiling is logged before and after, once, and not where the machine code is cached."""

from __future__ import annotations

import logging
from pathlib import Path

import numba
import pytest

from graphtrack.kernels import compilation
from graphtrack.kernels.compilation import Rehearsal, make_ready


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
    for _ in range(2):  # what failed is not ready
        with pytest.raises(IndexError):
            make_ready("something", failing)
        assert failing.is_cold()


def test_where_nothing_can_be_kept_it_says_so_in_every_process(monkeypatch, tmp_path: Path, caplog) -> None:
    (tmp_path / "taken").write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "taken"))
    for _ in range(2):
        assert "in every process" in logged(caplog, Rehearsal("a kind", list, 12.0))[0]
        compilation._READY.clear()
