"""Rows in, answers out: what `graphtrack track -` and the service share."""
