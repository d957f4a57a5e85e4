"""Conversational groups, visual attention and forecasts."""
