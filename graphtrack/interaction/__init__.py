"""People of a scene together: groups, gaze, and smoothing with both."""
