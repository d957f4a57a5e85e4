"""Which way bodies and heads point, from pictures of them."""
