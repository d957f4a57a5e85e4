"""One target followed through a video, alone or guided by the graph."""
