"""The experiments of the papers, with their own numbers beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from graphtrack.evaluation.reproduce import (
    baxter_occlusion,
    baxter_simulated,
    baxter_statistics,
    chen_joint,
)
from graphtrack.evaluation.reproduce.experiment import Experiment, Reproduction, Settings, Table

__all__ = ["EXPERIMENTS", "Experiment", "Reproduction", "Settings", "Table"]

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType(
    {
        module.EXPERIMENT.name: module.EXPERIMENT
        for module in (baxter_simulated, baxter_occlusion, baxter_statistics, chen_joint)
    }
)
"""Name → experiment."""
