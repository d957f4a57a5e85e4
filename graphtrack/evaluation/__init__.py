"""Metrics of estimates, methods behind one protocol, and their comparison."""

from graphtrack.evaluation.compare import Comparison, compare, make_method, registry
from graphtrack.evaluation.methods import Method

__all__ = ["Comparison", "Method", "compare", "make_method", "registry"]
