"""robots/files."""
