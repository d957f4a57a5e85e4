"""``python -m perception`` is the command line."""

from perception.cli import main

main()
