"""The Sigma-Pi person tracker (Yan et al. 2011)."""
