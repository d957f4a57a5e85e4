"""The compiled engine for the chain that one person is."""
