"""What `perception observe` and `perception follow` share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from graphtrack.cli.console import console
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera

_SHOWN = 5


def read_camera(homography: Path | None, calibration: Path | None) -> GroundCamera | None:
    """The camera that the options name; None if they name none.

    Raises
    ------
    InputError
        If both are given, or the file cannot be used.
    """
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.io.cameras import read_calibration, read_homography

    if homography is not None and calibration is not None:
        raise InputError("--homography and --calibration", "one of them")
    if calibration is not None:
        return read_calibration(calibration)
    return None if homography is None else GroundCamera.from_homography(read_homography(homography))


def print_skipped(reasons: Sequence[str]) -> None:
    """Say what was left out: the first few reasons, and how many more there are."""
    for reason in reasons[:_SHOWN]:
        console.print(f"  skipped: {reason}", markup=False)
    if len(reasons) > _SHOWN:
        console.print(f"  skipped: {len(reasons) - _SHOWN} more", markup=False)
