"""robots/appliances."""
