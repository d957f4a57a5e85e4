"""The models of the package, learned."""
