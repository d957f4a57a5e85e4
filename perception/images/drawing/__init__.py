"""Observed and estimated people, drawn into their frames."""
