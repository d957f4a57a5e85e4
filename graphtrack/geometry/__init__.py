"""Angles, homographies and the camera above the ground."""
