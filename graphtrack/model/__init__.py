"""The model: terms, parameters and presets."""

from graphtrack.model.costs import Cost, FrameSymbols, chord
from graphtrack.model.function_term import FunctionTerm, term
from graphtrack.model.model import Model, presets
from graphtrack.model.observation import Observation, States, Step
from graphtrack.model.parameters import (
    CouplingParameters,
    LikelihoodParameters,
    MotionParameters,
    OrientationParameters,
    Parameters,
)
from graphtrack.model.term import Term

__all__ = [
    "Cost",
    "CouplingParameters",
    "FrameSymbols",
    "FunctionTerm",
    "LikelihoodParameters",
    "Model",
    "MotionParameters",
    "Observation",
    "OrientationParameters",
    "Parameters",
    "States",
    "Step",
    "Term",
    "chord",
    "presets",
    "term",
]
