"""Made-up people, and what makes real ones harder to see."""
