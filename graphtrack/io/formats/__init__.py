"""Readers and writers of file formats, a module for each family; `graphtrack.io.registry` lists them."""
