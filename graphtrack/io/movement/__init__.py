"""Datasets of the package movement: xarray, with the dimensions time, space, keypoints and individuals."""
