"""The service of `graphtrack serve`: streams over WebSocket and HTTP, each answered by a process."""
