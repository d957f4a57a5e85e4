"""The committed baseline: what each ratio was, and how far it may fall.

`make bench` compares with it; ``pytest tests/benchmarks -m benchmark --update-baseline`` states it anew.
"""

from __future__ import annotations

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
    measured = request.config.stash[MEASURED]

    def put(name: str, value: float) -> None:
        measured[name] = value

    return put


def regressed(entry: dict[str, Any], value: float) -> bool:
    """Return True if a value is worse than the baseline's by more than the tolerance, a share of it."""
    allowed = entry["tolerance"] * abs(entry["value"])
    worse = entry["value"] - value if entry["direction"] == "higher" else value - entry["value"]
    return bool(worse > allowed)


def pytest_sessionfinish(session: pytest.Session) -> None:
    measured, entries = session.config.stash[MEASURED], json.loads(BASELINE.read_text(encoding="utf-8"))
    if not measured:
        return
    known = {entry["name"]: entry for entry in entries}
    lines = []
    for name, value in measured.items():
        entry = known.get(name)
        if entry is None:
            lines.append(f"{name:60s}{value:10.3g}   not in baseline.json")
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
            continue
        verdict = "ok"
        if regressed(entry, value):
            verdict = f"REGRESSED (tolerance {entry['tolerance']:.0%}, {entry['direction']} is better)"
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
        lines.append(f"{name:60s}{value:10.3g}   baseline {entry['value']:.3g}   {verdict}")
    print("\n" + "\n".join(lines))
    if session.config.getoption("--update-baseline"):
        for name, value in measured.items():
            fresh = {"name": name, "value": value, "direction": "higher", "tolerance": 0.3}
            entry = known.setdefault(name, fresh)
            entry["value"] = float(f"{value:.3g}")
        BASELINE.write_text(json.dumps(list(known.values()), indent=2) + "\n", encoding="utf-8")
        if session.testsfailed == 0:
            session.exitstatus = pytest.ExitCode.OK
