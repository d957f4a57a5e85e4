"""GTSAM's factors: custom ones, native ones under the model's names, and those derived from kernels."""
