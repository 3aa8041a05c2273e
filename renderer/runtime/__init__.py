"""renderer/runtime."""
