"""robots/urdf."""
