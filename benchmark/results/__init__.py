"""benchmark/results."""
