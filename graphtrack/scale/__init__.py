"""Association and smoothing of Parquet data sets that do not fit into memory, here or on a Dask cluster."""

from graphtrack.scale.blocks import AssociationOutcome, associate_dataset
from graphtrack.scale.dataset import Dataset, open_dataset
from graphtrack.scale.job import Outcome, smooth_dataset

__all__ = [
    "AssociationOutcome",
    "Dataset",
    "Outcome",
    "associate_dataset",
    "open_dataset",
    "smooth_dataset",
]
