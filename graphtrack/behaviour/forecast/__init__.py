"""Where people will be: forecasts with the uncertainty that holds (docs/forecast.md)."""
