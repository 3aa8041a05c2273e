"""benchmark/protocol."""
