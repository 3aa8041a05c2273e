"""gcpose/networks."""
