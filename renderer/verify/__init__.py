"""renderer/verify."""
