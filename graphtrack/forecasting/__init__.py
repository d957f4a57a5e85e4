"""Predicted paths of people, with calibrated spread."""
