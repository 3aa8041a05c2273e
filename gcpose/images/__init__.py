"""gcpose/images."""
