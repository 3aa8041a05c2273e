"""A room around the robot: a closed box seen from inside, with furniture along its walls.

The room is built in a frame of its own (origin on the floor below the robot, walls along x and y)
and finally turned about the world's z. It is only as large as robot and camera require: depth
images have 16 bits, so distant surfaces reduce the precision of near ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...robots.geometry import Array, rotation_about
from .box_mapping import Faces, split_by_axis
from .config import BackgroundConfig
from .image_sources import ImageFolder, draw_image
from .images import TextureImage

_MARGIN = 1.15
"""Least distance of walls and ceiling from the robot, in units of the camera's and the reach."""
_QUAD = np.array([[0, 1, 2], [0, 2, 3]])
_SEGMENTS = 12  # of a cylinder
_Mesh = tuple[Array, Faces, Array]  # vertices, faces, normals
_Piece = tuple[Array, Array, float, bool]  # center [2], half size [2], height, whether it is round


@dataclass(frozen=True)
class RoomSurface:
    """A still surface with one material."""

    name: str
    vertices: Array
    """[V 3] m, world frame."""
    faces: Faces
    """[F 3] counter-clockwise seen from inside the room."""
    normals: Array
    """[V 3] unit, towards the inside."""
    uv: Array
    """[V 2], tiles are repeated."""
    texture: TextureImage
    """[h w 3] sRGB, row 0 is the top of the image (v = 1)."""
    base_color: tuple[float, float, float]
    """Linear RGB in 0..1; multiplies the texture."""
    roughness: float


def draw_room(
    rng: np.random.Generator, config: BackgroundConfig, floor: float, middle: Array, eye: Array,
    reach: float,
) -> tuple[RoomSurface, ...]:
    """Draw floor, four walls, ceiling and 2-6 pieces of furniture: fewer than 300 triangles.

    World frame, m. The robot stays within `reach` of its center `middle` [3]; the camera is at
    `eye` [3]. Furniture stays clear of the upright cylinder with the radius of the robot's reach,
    and of everything between it and the camera. The room's floor is lower than `floor` if the
    camera would be below it. Raises ConfigError if no texture can be drawn.
    """
    distance = float(np.linalg.norm(eye - middle))
    bottom = min(floor, float(eye[2]) - 0.05 * distance)
    origin = np.array([middle[0], middle[1], bottom])
    world_from_room = rotation_about((0.0, 0.0, 1.0), rng.uniform(-np.pi, np.pi))
    eye_xy = ((eye - origin) @ world_from_room)[:2]

    images = ImageFolder(config.folder) if config.folder else None
    towards_eye = np.array([eye_xy[0], -eye_xy[0], eye_xy[1], -eye_xy[1]])  # +x, -x, +y, -y
    space = rng.uniform(*config.room_size, 4) * reach
    walls = _MARGIN * np.maximum(towards_eye, reach) + space
    above = max(reach, float(eye[2] - middle[2])) * rng.uniform(_MARGIN, 2.0)
    height = float(middle[2]) - bottom + above
    low = np.array([-walls[1], -walls[3], 0.0])
    high = np.array([walls[0], walls[2], height])

    def surface(name: str, mesh: _Mesh, tile: float, pixels: int) -> RoomSurface:
        vertices, faces, normals = mesh
        old, faces, uv = split_by_axis(vertices, faces, tile)
        image = draw_image(config.kinds, images, (pixels, pixels), rng, True, config.color)
        red, green, blue = rng.uniform(0.7, 1.0, 3).tolist()
        return RoomSurface(name, vertices[old] @ world_from_room.T + origin, faces,
                           normals[old] @ world_from_room.T, uv, image, (red, green, blue),
                           rng.uniform(0.5, 1.0))

    vertices, faces, normals = _box(low, high, inward=True)
    surfaces: list[RoomSurface] = []
    # Walls are seen from a larger distance than the floor: their tiles are larger.
    for name, first, last, grown in (("floor", 0, 1, 1.0), ("walls", 1, 5, 2.0),
                                     ("ceiling", 5, 6, 2.0)):
        rows, number = slice(4 * first, 4 * last), 2 * (last - first)
        tile = distance * grown * rng.uniform(0.5, 1.0)
        surfaces.append(surface(name, (vertices[rows], faces[:number], normals[rows]), tile, 512))
    for at, half, tall, is_round in _draw_furniture(rng, low, high, eye_xy, distance, reach):
        if is_round:
            mesh = _cylinder(at, float(half.min()), tall)
        else:
            mesh = _box(np.append(at - half, 0.0), np.append(at + half, tall), inward=False)
        surfaces.append(surface("furniture", mesh, distance * rng.uniform(0.2, 0.6), 256))
    return tuple(surfaces)


def _draw_furniture(rng: np.random.Generator, low: Array, high: Array, eye_xy: Array,
                    distance: float, reach: float) -> list[_Piece]:
    """Draw pieces along the walls of the room from corner `low` [3] to `high` [3], room frame."""
    # The region to keep free, from above: discs that shrink from the robot's reach to the camera.
    share = np.linspace(0, 1, 65)
    free_at = share[:, None] * eye_xy
    free_radius = 1.05 * reach + share * (0.15 * distance - 1.05 * reach)
    pieces: list[_Piece] = []
    wanted = int(rng.integers(2, 7))
    for attempt in range(60 * wanted):
        if len(pieces) == wanted:
            break
        # Each attempt is smaller than the one before: the last ones fit into any corner.
        size = distance * 0.985 ** attempt
        half = size * np.array([rng.uniform(0.15, 0.4), rng.uniform(0.1, 0.25)])
        tall = min(size * rng.uniform(0.3, 1.3), 0.8 * float(high[2]))
        is_round = bool(rng.random() < 0.3)
        axis, up = int(rng.integers(2)), bool(rng.integers(2))
        half = half if axis == 1 else half[::-1]  # the long side along the wall
        gap = 0.01 * distance
        inner_low, inner_high = low[:2] + half + gap, high[:2] - half - gap
        if (inner_high <= inner_low).any():
            continue
        at = rng.uniform(inner_low, inner_high)
        at[axis] = inner_high[axis] if up else inner_low[axis]
        radius = np.linalg.norm(half)
        free = (np.linalg.norm(free_at - at, axis=1) - free_radius).min() > radius
        if free and all((np.abs(at - a) > half + h + gap).any() for a, h, _, _ in pieces):
            pieces.append((at, half, tall, is_round))
    return pieces


def _box(low: Array, high: Array, inward: bool) -> _Mesh:
    """Return six quads of four vertices each: bottom, sides, top.

    An outward box (furniture) has no bottom: it would lie in the plane of the floor, invisible.
    """
    def quad(origin: ArrayLike, a: ArrayLike, b: ArrayLike) -> Array:
        o, a, b = np.asarray(origin), np.asarray(a), np.asarray(b)
        return np.array([o, o + a, o + a + b, o + b])

    x, y, z = np.eye(3)
    # Counter-clockwise from outside.
    quads = np.array([quad(0 * x, y, x), quad(0 * x, x, z), quad(y, z, x), quad(0 * x, z, y),
                      quad(x, y, z), quad(z, x, y)])
    normals = np.repeat([-z, -y, y, -x, x, z], 4, 0)
    kept = 0 if inward else 1
    vertices = low + quads[kept:].reshape(-1, 3) * (high - low)
    faces = np.concatenate([_QUAD + 4 * i for i in range(6 - kept)]).astype(np.int32)
    if inward:
        return vertices, faces[:, ::-1].copy(), -normals
    return vertices, faces, normals[4:]


def _cylinder(at: Array, radius: float, height: float) -> _Mesh:
    """Return an upright cylinder without bottom; `at` [2] is the position of its axis."""
    angle = np.linspace(0, 2 * np.pi, _SEGMENTS, False)
    outward = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    ring = np.append(at, 0.0) + radius * outward
    up = np.array([0.0, 0.0, height])
    i = np.arange(_SEGMENTS)
    j, n = (i + 1) % _SEGMENTS, _SEGMENTS
    side = np.concatenate([np.stack([i, j, j + n], -1), np.stack([i, j + n, i + n], -1)])
    top = 2 * n + np.stack([0 * i[2:], i[1:-1], i[2:]], -1)
    normals = np.concatenate([outward, outward, np.tile([0.0, 0.0, 1.0], (n, 1))])
    vertices = np.concatenate([ring, ring + up, ring + up])
    return vertices, np.concatenate([side, top]).astype(np.int32), normals
