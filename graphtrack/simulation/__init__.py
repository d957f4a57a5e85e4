"""Simulated people, detectors, and degraded observations."""

WALKING_PACE = 1.3
"""m/s, the median speed of pedestrians."""
