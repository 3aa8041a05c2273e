"""Models by name: the robots that gcbench knows, and `microwave:17` or `partnet:7310`."""

from __future__ import annotations

from .entries import load
from .listing import RobotInfo, fetch_robot, list_robots
from .names import is_category

__all__ = ["RobotInfo", "fetch_robot", "is_category", "list_robots", "load"]
