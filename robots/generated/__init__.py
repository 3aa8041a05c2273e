"""robots/generated."""
