"""Made-up people, and what makes real ones harder to see."""

WALKING_PACE = 1.3
"""m/s, the median speed of pedestrians."""
