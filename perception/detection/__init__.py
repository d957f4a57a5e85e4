"""People found in frames, and boxes that others found."""

from __future__ import annotations

from perception.detection.boxes import from_supervision, from_ultralytics

__all__ = ["from_supervision", "from_ultralytics"]
