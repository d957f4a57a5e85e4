"""Metrics of estimates, methods behind one protocol, and their comparison."""

from graphtrack.evaluation.compare import Comparison, Method, compare, make_method, registry

__all__ = ["Comparison", "Method", "compare", "make_method", "registry"]
