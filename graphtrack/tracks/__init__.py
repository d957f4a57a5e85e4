"""Tracks, their columns and units, and their conversion from and to tables."""
