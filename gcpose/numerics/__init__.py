"""gcpose/numerics."""
