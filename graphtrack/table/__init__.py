"""The native table: what its columns are, its rows in memory, and what is checked of them. Below `tracks`."""
