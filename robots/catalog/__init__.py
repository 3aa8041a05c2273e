"""Models by name or path: robots of the catalogue, `microwave:17`, `partnet:7310`, files."""

from __future__ import annotations

from .entries import CATALOG, find_robot, is_local
from .listing import RobotInfo, fetch_robot, list_robots, records_table
from .loading import is_file, load_robot, robot_urdf, select_default_scored
from .names import instance_numbers, is_category, is_object, parse_object_name

__all__ = [
    "CATALOG", "RobotInfo", "fetch_robot", "find_robot", "instance_numbers", "is_category",
    "is_file", "is_local", "is_object", "list_robots", "load_robot", "parse_object_name",
    "records_table", "robot_urdf", "select_default_scored",
]
