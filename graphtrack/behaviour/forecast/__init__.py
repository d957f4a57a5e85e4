"""Forecasts of positions with calibrated covariance (docs/forecast.md)."""
