"""robots/motion."""
