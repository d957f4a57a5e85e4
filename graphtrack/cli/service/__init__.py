"""`graphtrack serve`: streams of rows over WebSocket and HTTP, a process for each."""
