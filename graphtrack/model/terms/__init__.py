"""The terms of the model, one module each: density, kernels and packing."""
