"""Shared by terms and the compiled engine: the layout of a frame, kernels and their arithmetic.

The chain solver adds kernels up. One takes the states of a frame (or of two that follow each other), adds to
the gradient and to the blocks of the Hessian, and returns its cost; see `Kernel`.
"""

from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import BODY, HEAD, VX, VY, Field, Kernel, X, Y

__all__ = ["BODY", "HEAD", "VX", "VY", "Field", "Kernel", "X", "Y", "compiled"]
