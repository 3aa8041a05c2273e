"""robots/gltf."""
