"""The committed baseline: the ratios, and their tolerances.

`make bench` compares with it; ``pytest tests/benchmarks -m benchmark --update-baseline`` updates it.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

BASELINE = Path(__file__).with_name("baseline.json")
MEASURED = pytest.StashKey[dict[str, float]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-baseline", action="store_true", help="write what was measured to baseline.json"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.stash[MEASURED] = {}


@pytest.fixture
def record(request: pytest.FixtureRequest) -> Callable[[str, float], None]:
    """Hand in a ratio under a name that baseline.json knows."""
    return request.config.stash[MEASURED].__setitem__


def verdict(entry: dict[str, Any] | None, value: float) -> tuple[str, bool]:
    """Compare a value with the baseline's: the result in words, and True if it is as good, to a tolerance."""
    if entry is None:
        return "not in baseline.json", False
    worse = (entry["value"] - value) * (1 if entry["direction"] == "higher" else -1)
    good = worse <= entry["tolerance"] * abs(entry["value"])
    said = "ok" if good else f"REGRESSED (tolerance {entry['tolerance']:.0%}, {entry['direction']} is better)"
    return f"baseline {entry['value']:.3g}   {said}", good


def pytest_sessionfinish(session: pytest.Session) -> None:
    measured, entries = session.config.stash[MEASURED], json.loads(BASELINE.read_text(encoding="utf-8"))
    known = {entry["name"]: entry for entry in entries}
    for name, value in measured.items():
        said, good = verdict(known.get(name), value)
        print(f"\n{name:60s}{value:10.3g}   {said}", end="")
        if not good:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
    if measured and session.config.getoption("--update-baseline"):
        for name, value in measured.items():
            fresh = {"name": name, "value": value, "direction": "higher", "tolerance": 0.3}
            known.setdefault(name, fresh)["value"] = float(f"{value:.3g}")
        BASELINE.write_text(json.dumps(list(known.values()), indent=2) + "\n", encoding="utf-8")
        if session.testsfailed == 0:
            session.exitstatus = pytest.ExitCode.OK
