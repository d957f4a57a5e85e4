"""Which cases of a parametrised test run every time, and which with ``make test-all``."""

from collections.abc import Iterable
from typing import Any

import pytest


def others_slow(values: Iterable[Any], every_time: Iterable[Any]) -> list[Any]:
    """All values for `parametrize`; those that are not to run every time carry the marker ``slow``.

    A tuple is a value for each of several arguments.
    """
    kept = list(every_time)
    found = []
    for one in values:
        arguments = one if isinstance(one, tuple) else (one,)
        found.append(one if one in kept else pytest.param(*arguments, marks=pytest.mark.slow))
    return found
