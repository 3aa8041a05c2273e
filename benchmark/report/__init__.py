"""benchmark/report."""
