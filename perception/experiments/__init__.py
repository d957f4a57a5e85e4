"""The papers' experiments on pixels, for `graphtrack reproduce`."""
