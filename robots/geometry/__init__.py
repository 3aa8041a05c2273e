"""robots/geometry."""
