"""gcpose/training."""
