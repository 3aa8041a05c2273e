"""gcpose/rgbd."""
