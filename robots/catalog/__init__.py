"""robots/catalog."""
