"""Predicted paths of people, with calibrated uncertainty."""
