"""Metrics of estimates, methods behind one protocol, and their comparison."""

from graphtrack.evaluation.compare import Comparison, compare
from graphtrack.evaluation.methods import Method, make_method, registry

__all__ = ["Comparison", "Method", "compare", "make_method", "registry"]
