"""gcpose/paper."""
