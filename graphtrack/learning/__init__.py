"""Learning the parameters of a model from tracks, with or without their truth, and those of a scene."""

from graphtrack.learning.fit import Criterion, Fit, Learned, fit
from graphtrack.learning.scene import SceneFit, fit_scene

__all__ = ["Criterion", "Fit", "Learned", "SceneFit", "fit", "fit_scene"]
