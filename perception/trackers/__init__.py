"""Trackers of one target on pixels: mixed-state, Sigma-Pi and colour particle filters."""
