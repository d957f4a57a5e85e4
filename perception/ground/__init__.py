"""Estimation of the ground plane of an uncalibrated camera from the boxes of people."""
