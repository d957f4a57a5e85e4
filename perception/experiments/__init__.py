"""Experiments of the papers on pixels, for `graphtrack reproduce`."""
