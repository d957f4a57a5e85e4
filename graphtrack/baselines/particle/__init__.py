"""The joint particle filter (Chen et al. 2011) and its smoother."""
