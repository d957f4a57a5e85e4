"""The joint particle filter (002) and its smoother."""
