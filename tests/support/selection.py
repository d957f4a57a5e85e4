"""Which cases of a parametrised test run every time, and which with ``make test-all``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def others_slow(values: Iterable[Any], every_time: Iterable[Any]) -> list[Any]:
    """All values for `parametrize`; those that are not to run every time carry the marker ``slow``."""
    kept = list(every_time)
    return [one if one in kept else pytest.param(one, marks=pytest.mark.slow) for one in values]
