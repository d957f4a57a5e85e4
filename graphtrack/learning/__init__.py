"""Learning the parameters of a model from tracks, with or without their truth."""

from graphtrack.learning.fit import Criterion, Fit, Learned, fit

__all__ = ["Criterion", "Fit", "Learned", "fit"]
