"""gcpose/rgb."""
