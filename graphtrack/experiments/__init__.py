"""Experiments of the papers, with published and own numbers."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from types import MappingProxyType

from graphtrack.experiments.baxter_caviar import EXPERIMENT as _baxter_caviar
from graphtrack.experiments.baxter_occlusion import EXPERIMENT as _baxter_occlusion
from graphtrack.experiments.baxter_simulated import EXPERIMENT as _baxter_simulated
from graphtrack.experiments.baxter_statistics import EXPERIMENT as _baxter_statistics
from graphtrack.experiments.baxter_weight import EXPERIMENT as _baxter_weight
from graphtrack.experiments.behaviour.context import EXPERIMENT as _context
from graphtrack.experiments.behaviour.forecasts import EXPERIMENT as _forecasts
from graphtrack.experiments.behaviour.parties import EXPERIMENT as _parties
from graphtrack.experiments.chen_classes import EXPERIMENT as _chen_classes
from graphtrack.experiments.chen_joint import EXPERIMENT as _chen_joint
from graphtrack.experiments.gaits import EXPERIMENT as _gaits
from graphtrack.experiments.harness import Experiment, Reproduction, Settings, Table
from graphtrack.experiments.honesty import EXPERIMENT as _honesty
from graphtrack.experiments.meetings import EXPERIMENT as _meetings
from graphtrack.experiments.robustness import EXPERIMENT as _robustness
from graphtrack.experiments.strangers import EXPERIMENT as _strangers
from graphtrack.experiments.unseen_people import EXPERIMENT as _unseen_people

__all__ = ["EXPERIMENTS", "Experiment", "Reproduction", "Settings", "Table", "all_experiments"]

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType(
    {
        experiment.name: experiment
        for experiment in (
            *(_baxter_simulated, _baxter_caviar, _baxter_occlusion, _baxter_statistics, _baxter_weight),
            *(_chen_joint, _chen_classes),
            *(_context, _gaits, _honesty, _unseen_people, _robustness),
            *(_meetings, _strangers, _parties, _forecasts),
        )
    }
)
"""Name → experiment on tables."""

GROUP = "graphtrack.experiments"
"""Entry points under which other packages, such as ``perception``, add experiments."""


def all_experiments() -> dict[str, Experiment]:
    """Those on tables, and those that installed packages add, by name."""
    points = sorted(entry_points(group=GROUP), key=lambda point: point.name)
    added: list[Experiment] = [point.load() for point in points]
    return {**EXPERIMENTS, **{experiment.name: experiment for experiment in added}}
