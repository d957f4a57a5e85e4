"""Measures of pose classifiers and detectors."""
