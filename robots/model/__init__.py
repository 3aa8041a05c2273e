"""robots/model."""
