"""The experiments of the papers, with their own numbers beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from types import MappingProxyType

from graphtrack.evaluation.reproduce import (
    baxter_caviar,
    baxter_occlusion,
    baxter_simulated,
    baxter_statistics,
    baxter_weight,
    chen_classes,
    chen_joint,
    gaits,
    honesty,
    meetings,
    strangers,
    unseen_people,
)
from graphtrack.evaluation.reproduce.experiment import Experiment, Reproduction, Settings, Table

__all__ = ["EXPERIMENTS", "Experiment", "Reproduction", "Settings", "Table", "all_experiments"]

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType(
    {
        module.EXPERIMENT.name: module.EXPERIMENT
        for module in (
            baxter_simulated,
            baxter_caviar,
            baxter_occlusion,
            baxter_statistics,
            baxter_weight,
            chen_joint,
            chen_classes,
            gaits,
            honesty,
            meetings,
            strangers,
            unseen_people,
        )
    }
)
"""Name → experiment on tables."""

GROUP = "graphtrack.experiments"
"""Entry points under which other packages, such as ``perception``, add experiments."""


def all_experiments() -> dict[str, Experiment]:
    """Those on tables, and those that installed packages add, by name."""
    added: list[Experiment] = [
        point.load() for point in sorted(entry_points(group=GROUP), key=lambda p: p.name)
    ]
    return {**EXPERIMENTS, **{experiment.name: experiment for experiment in added}}
