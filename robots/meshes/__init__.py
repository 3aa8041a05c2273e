"""robots/meshes."""
