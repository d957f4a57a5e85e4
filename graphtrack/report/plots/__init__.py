"""Static figures. Every function returns a `matplotlib.figure.Figure` and touches no pyplot state."""

from graphtrack.report.plots.comparison import plot_angles, plot_errors, plot_reliability
from graphtrack.report.plots.scene import plot_tracks

__all__ = ["plot_angles", "plot_errors", "plot_reliability", "plot_tracks"]
