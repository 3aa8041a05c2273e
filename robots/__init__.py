"""Articulated models: shape, joints, motion. Imports nothing of the other rooms."""
