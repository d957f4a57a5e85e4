"""The formats that are read and written, one module each."""
