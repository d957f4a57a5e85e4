"""Front door of smoothing and tracking: all that is done to a recording, in order."""

from graphtrack.smoothing.recording import smooth, solve, solve_tracks, track_online, warm_up

__all__ = ["smooth", "solve", "solve_tracks", "track_online", "warm_up"]
