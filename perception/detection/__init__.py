"""Detection of people in frames, and boxes of other detectors."""

from __future__ import annotations

from perception.detection.boxes import from_supervision, from_ultralytics

__all__ = ["from_supervision", "from_ultralytics"]
