"""renderer/show."""
