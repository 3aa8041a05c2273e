"""renderer/types."""
