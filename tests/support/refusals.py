"""Inputs that are refused."""

from typing import Any

import pytest

from graphtrack import io
from graphtrack.errors import InputError


def refused(given: Any, **options: Any) -> InputError:
    """Return the error for an input that cannot be read, which is one line."""
    with pytest.raises(InputError) as caught:
        io.read_identified(given, **options)
    assert "\n" not in str(caught.value)
    return caught.value
