"""Fixtures that all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real recordings: ``GRAPHTRACK_DATA``, else ``../shared/data`` beside the repository."""
    given = os.environ.get("GRAPHTRACK_DATA")
    folder = Path(given) if given else Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}; set GRAPHTRACK_DATA to your copy")
    return folder
