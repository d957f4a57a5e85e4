"""Experiments on groups, gaze and forecasts."""
