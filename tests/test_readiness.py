"""What is said of compiling: before and after, once, and nothing where the machine code is there."""

from __future__ import annotations

import gc
import logging
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import pytest

from graphtrack.model.kernels.compiled import apart
from graphtrack.readiness import Rehearsal, collecting_rarely, is_cold, make_ready


def kernel():
    """A compiled function that knows nothing of those made before, as in a new process."""

    @apart
    def half(x: float) -> float:
        return 0.5 * x

    return half


def said(caplog: pytest.LogCaptureFixture, half) -> list[str]:
    """The log of making a function ready, which it is then."""
    caplog.clear()
    make_ready("something", Rehearsal(lambda: half(1.0), {half: 12.0}))
    assert half.signatures and not is_cold(half)
    # Other packages log when garbage is collected, which may be now.
    return [record.getMessage() for record in caplog.records if record.name == "graphtrack"]


def test_it_is_said_once_on_a_machine(monkeypatch, tmp_path: Path, caplog) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    caplog.set_level(logging.WARNING, "graphtrack")
    half = kernel()
    assert is_cold(half)
    before, after = said(caplog, half)
    assert before == "compiling something, once on this machine: about 10 s …"
    assert after.startswith("compiled in ")
    assert said(caplog, half) == []
    again = kernel()
    assert not is_cold(again)
    assert said(caplog, again) == []


def test_machine_code_of_another_compiler_is_none(monkeypatch, tmp_path: Path, caplog) -> None:
    from graphtrack.model.kernels import fingerprint

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    said(caplog, kernel())
    monkeypatch.setattr(fingerprint, "_machine", lambda: "another")
    fingerprint.fingerprint.cache_clear()
    assert is_cold(kernel())
    fingerprint.fingerprint.cache_clear()


def test_where_nothing_can_be_kept_it_says_so_every_time(monkeypatch, tmp_path: Path, caplog) -> None:
    (tmp_path / "taken").write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "taken"))
    for _ in range(2):
        assert "in every process" in said(caplog, kernel())[0]


def test_functions_that_are_not_compiled_at_all_are_ready() -> None:
    assert not is_cold(len)
    make_ready("something", Rehearsal(pytest.fail, {len: 1.0}))


def test_garbage_is_collected_as_before_whatever_happens() -> None:
    before = gc.get_threshold()
    with pytest.raises(ValueError, match="meanwhile"), collecting_rarely():
        assert gc.get_threshold()[0] > before[0]
        raise ValueError("meanwhile")
    assert gc.get_threshold() == before


def test_garbage_is_collected_rarely_until_the_last_thread_is_done() -> None:
    before, inside, may_end = gc.get_threshold(), threading.Event(), threading.Event()

    def other() -> None:
        with collecting_rarely():
            inside.set()
            may_end.wait()

    with ThreadPoolExecutor(1) as pool:
        try:
            with collecting_rarely():
                pool.submit(other)
                assert inside.wait(60.0)
            assert gc.get_threshold()[0] > before[0]
        finally:
            may_end.set()
    assert gc.get_threshold() == before


@pytest.mark.parametrize("wanted", [(0, 10, 10), (200_000, 10, 10)])
def test_who_wants_fewer_collections_yet_has_them(wanted: tuple[int, int, int]) -> None:
    before = gc.get_threshold()
    try:
        gc.set_threshold(*wanted)
        with collecting_rarely():
            assert gc.get_threshold() == wanted
    finally:
        gc.set_threshold(*before)
