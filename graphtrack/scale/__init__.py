"""Smoothing of Parquet data sets that do not fit into memory, on this machine or on a Dask cluster."""

from graphtrack.scale.dataset import Dataset, open_dataset
from graphtrack.scale.job import Outcome, smooth_dataset

__all__ = ["Dataset", "Outcome", "open_dataset", "smooth_dataset"]
