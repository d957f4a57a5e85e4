"""The evaluation on CAVIAR's lobby says what it lacks."""

from __future__ import annotations

from pathlib import Path

import pytest

from graphtrack.errors import InputError
from perception.evaluation.adapted_cameras import sequences_of


def test_one_sequence_is_too_few(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="0 sequences"):
        sequences_of(tmp_path)
