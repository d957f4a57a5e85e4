"""People seen from above are turned upright before they are learned from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.io.readers.caviar import LOBBY_HEIGHT, lobby_camera
from perception.evaluation.adapted_lobby import sequences_of, upright


@pytest.mark.parametrize("place", [(-3.0, 0.5), (-1.5, -1.0), (-2.0, 2.5), (0.8, 2.0)])
def test_heads_are_above_feet(place: tuple[float, float]) -> None:
    camera = lobby_camera()
    ground = np.array(place)
    foot = camera.ground_to_image(ground)
    head = camera.ground_to_image(ground * LOBBY_HEIGHT / (LOBBY_HEIGHT - 1.6))
    image = np.zeros((288, 384, 3), np.uint8)
    image[round(head[1]) - 1 : round(head[1]) + 2, round(head[0]) - 1 : round(head[0]) + 2] = 255
    shown, (left, top, width, height) = upright(image, foot, camera, LOBBY_HEIGHT)
    rows, columns = np.nonzero(shown[..., 0] > 60)
    assert len(rows)
    assert abs(columns.mean() - foot[0]) < 2.0 and abs(left + width / 2.0 - foot[0]) < 1e-6
    assert top - 2.0 < rows.mean() < top + 0.5 * height
    assert abs(top + height - foot[1]) < 1e-6


def test_one_sequence_is_too_few(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="0 sequences"):
        sequences_of(tmp_path)
