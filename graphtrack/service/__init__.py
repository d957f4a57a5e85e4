"""Service of `graphtrack serve`: streams over WebSocket and HTTP, one process each."""
