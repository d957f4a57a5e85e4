"""The compiled engine for the chain of one person's states."""
