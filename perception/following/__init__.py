"""Tracking of one target through a video, alone or guided by the graph."""
