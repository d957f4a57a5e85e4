"""``python -m graphtrack`` is the command line."""

from graphtrack.cli import main

main()
