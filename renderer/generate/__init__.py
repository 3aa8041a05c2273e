"""renderer/generate."""
