"""Articulated models: shape, joints, motion. Imports no other room."""
