"""renderer/truth."""
