"""The confidence of MOT text is the score of its detections, whatever a detector means by it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import rows_of_file
from graphtrack.tracks.table import Rows

NEGATIVE = "some confidences are negative"


def rows_of(confidences: list[float], identity: int = -1) -> Rows:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "det.txt"
        path.write_text(
            "".join(f"{k},{identity},{k},10,20,50,{c!r}\n" for k, c in enumerate(confidences, start=1))
        )
        return rows_of_file(path, None, ReadOptions(metres_per_pixel=0.02))


@settings(deadline=None, max_examples=20)
@given(
    st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=9).filter(lambda found: set(found) - {0.0, -1.0})
)
def test_scores_keep_the_order_and_are_never_negative(confidences: list[float]) -> None:
    rows = rows_of(confidences)
    if min(confidences) < 0.0:
        np.testing.assert_allclose(rows.channels["score"], expit(confidences), rtol=1e-12, atol=1e-16)
        assert any(note.startswith(NEGATIVE) for note in rows.notes)
    else:
        np.testing.assert_array_equal(rows.channels["score"], [c for c in confidences if c != 0.0])
        assert not any(note.startswith(NEGATIVE) for note in rows.notes)


@pytest.mark.parametrize(("confidences", "identity"), [([-1.0, -1.0], -1), ([0.3, -0.7], 4)])
def test_confidences_that_say_nothing_much_or_too_much(confidences: list[float], identity: int) -> None:
    assert "score" not in rows_of(confidences, identity).channels
    np.testing.assert_array_equal(rows_of([-1e9, 0.0, 1e9]).channels["score"], [0.0, 0.5, 1.0])  # log odds
    with pytest.raises(InputError, match="line 2, column confidence"):
        rows_of([1.0, 1e30])


def test_scores_come_with_the_tracks_that_are_associated(tmp_path: Path) -> None:
    path = tmp_path / "det.txt"
    path.write_text("".join(f"{k},-1,{2 * k},10,20,50,{0.5 + k / 100}\n" for k in range(1, 9)))
    (track,) = gt.read(path, metres_per_pixel=0.02)
    np.testing.assert_allclose(track.score, 0.5 + track.frame / 100)
