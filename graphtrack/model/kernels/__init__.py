"""What terms and the compiled engine share: the layout of a frame, kernels, packing, the frame program."""
