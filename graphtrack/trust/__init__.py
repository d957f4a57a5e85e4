"""Checks whether observations are as noisy as declared."""
