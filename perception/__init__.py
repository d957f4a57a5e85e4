"""From pixels to the observations that `graphtrack` smooths: people, heads, body and head pose."""
