"""The Sigma-Pi person tracker (003)."""
