"""renderer/export."""
