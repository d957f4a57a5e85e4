"""Online processing of rows, shared by `graphtrack track -` and the service."""
