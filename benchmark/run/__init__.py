"""benchmark/run."""
