"""Tracks, their columns and units, and the tables they are read from and written to."""
