"""The layout of a frame, kernels and their arithmetic, for terms and for the compiled engine.

The chain solver sums kernels. A kernel takes the states of a frame (or of two consecutive frames), adds to
the gradient and to the blocks of the Hessian, and returns its cost; see `Kernel`.
"""

from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import BODY, HEAD, VX, VY, Field, Kernel, X, Y

__all__ = ["BODY", "HEAD", "VX", "VY", "Field", "Kernel", "X", "Y", "compiled"]
