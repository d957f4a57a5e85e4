"""Compilation, the layout of a frame, and arithmetic in compiled code."""
