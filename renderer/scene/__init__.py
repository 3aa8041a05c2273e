"""renderer/scene."""
