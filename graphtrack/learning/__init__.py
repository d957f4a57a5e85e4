"""Fitting the parameters of a model to the truth of tracks, and learning those of a scene."""

from graphtrack.learning.fit import Fit, Learned, fit
from graphtrack.learning.scene import SceneFit, fit_scene

__all__ = ["Fit", "Learned", "SceneFit", "fit", "fit_scene"]
