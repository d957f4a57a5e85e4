"""The terms of the model, a file each: its density, its kernels, and what is packed for them."""
