"""benchmark/methods."""
