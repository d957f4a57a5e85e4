"""Whether observations are as noisy as they are said to be."""

from graphtrack.trust.verdict import ChannelNoise, Noise, Trust, declared_noise, trusted

__all__ = ["ChannelNoise", "Noise", "Trust", "declared_noise", "trusted"]
