"""gcpose/chain."""
