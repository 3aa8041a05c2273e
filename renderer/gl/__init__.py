"""renderer/gl."""
