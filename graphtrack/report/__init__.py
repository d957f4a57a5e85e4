"""Figures, and the one-file HTML report with its replay from above.

Nothing is imported here, so that ``import graphtrack`` does not load matplotlib.
"""
