"""Groups, looks and forecasts in a report: what was given, its codes for the replay, and its sections."""
