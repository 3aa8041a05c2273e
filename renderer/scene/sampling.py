"""All randomness of a sequence, in one stream per factor: instance, motion, camera, lights,
materials, textures, background, image. Streams are independent: datasets can differ in one factor.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, rotation_about, transform
from ...robots.model import ArticulatedModel, Material
from ...robots.motion import JointTrajectory
from ..runtime import named_rng
from ..types import Camera, intrinsics_from_fov, look_at
from .config import (
    BackgroundConfig,
    CameraConfig,
    ImageConfig,
    LightsConfig,
    MaterialsConfig,
    RenderConfig,
    TexturesConfig,
)
from .image_sources import ImageFolder, draw_image
from .room import RoomSurface, draw_room
from .scene import Light, Scene


@dataclass(frozen=True)
class Streams:
    """Random generators of one sequence by factor: functions of (config, index, factor) only.

    Of the config only `seed`, `stream`, `twin_of` and `vary` matter.
    """

    config: RenderConfig
    index: int

    def rng(self, factor: str, attempt: int = 0) -> np.random.Generator:
        """Return a new generator; `attempt` counts the draws that observability rejected."""
        index = self.index if factor in self.config.vary else 0
        return self._rng(index, factor, attempt)

    def tracks_rng(self) -> np.random.Generator:
        """Return a new generator for the choice of tracks, which always varies."""
        return self._rng(self.index, "tracks")

    def _rng(self, index: int, name: str, *more: int) -> np.random.Generator:
        config = self.config
        if config.twin_of:
            name = f"{name} of {config.twin_of}"
        return named_rng(config.seed, config.stream, index, name, *more)


def _direction(azimuth: float, elevation: float) -> Array:
    """Return the unit vector [3] at an angle about z and one above the horizon, rad."""
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def draw_camera(
    rng: np.random.Generator, config: CameraConfig, width: int, height: int,
    points: Array, floor: float,
) -> Camera:
    """Draw a camera on a shell around the robot with points [N 3] m (world) in the first frame.

    The camera is never below the plane z = `floor`, m. The distance makes the projected
    bounding box fill the drawn share of the image's smaller side; jitter of the look-at point is
    reduced until the box lies inside the image.
    """
    low, high = points.min(0), points.max(0)
    center, size = (low + high) / 2.0, max(float(np.linalg.norm(high - low)), 1e-6)
    azimuth = np.radians(rng.uniform(*config.azimuth_or_default()))
    elevation = np.radians(rng.uniform(*config.elevation))
    fov, fill = np.radians(rng.uniform(*config.fov)), rng.uniform(*config.fill)
    roll = np.radians(rng.uniform(*config.roll))
    jitter = rng.uniform(-1.0, 1.0, 3) * config.jitter * size
    k = intrinsics_from_fov(width, height, float(fov))
    away = _direction(azimuth, elevation)

    if center[2] + 1.5 * size * away[2] < floor:
        away = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    for scale in (1.0, 0.5, 0.25, 0.0):
        target = center + scale * jitter
        world_from_cam = look_at(target + away, target, float(roll))
        local = (points - target) @ world_from_cam[:3, :3]  # the camera moves along its z

        x, y, z = np.ascontiguousarray(local.T)  # minima over rows are several times faster

        def box(distance: float, x: Array = x, y: Array = y, z: Array = z) -> Array:
            """Return the least and greatest (u, v) for a distance of the camera from the target."""
            u, v = k[:2] @ np.stack([x, y, z + distance]) / (z + distance)
            return np.array([[u.min(), v.min()], [u.max(), v.max()]])

        near = 1.05 * max(-float(z.min()), 0.01 * size)
        far = max(200.0 * size, 2.0 * near)
        if np.ptp(box(near), axis=0).max() > fill * min(width, height):
            for _ in range(14):  # to 0.05 %
                middle = float(np.sqrt(near * far))
                too_near = np.ptp(box(middle), axis=0).max() > fill * min(width, height)
                near, far = (middle, far) if too_near else (near, middle)
        else:
            far = near
        world_from_cam[:3, 3] = target + far * away
        found = Camera(width, height, k, world_from_cam)
        low_uv, high_uv = box(far)
        if low_uv.min() >= 0 and high_uv[0] <= width - 1 and high_uv[1] <= height - 1:
            break
    return found


def shake_camera(
    rng: np.random.Generator, config: CameraConfig, camera: Camera, frames: int
) -> tuple[Camera, ...]:
    """Return the cameras of all frames: one and the same, or moved as if held by hand.

    Turns about the axes of the camera and shifts along them are random walks that begin at
    frame 0.
    """
    ranges = (config.shake_turn, config.shake_shift)
    if not any(map(any, ranges)):
        return (camera,) * frames
    walk = np.cumsum(rng.standard_normal((frames, 2, 3)), axis=0)
    walk -= walk[0]
    size = [rng.uniform(*limits) for limits in ranges]
    rms = np.sqrt((walk**2).mean(axis=(0, 2), keepdims=True))
    walk *= np.array(size)[:, None] / np.maximum(rms, 1e-12)
    moved: list[Camera] = [camera]
    for turn, shift in walk[1:]:
        angle = float(np.linalg.norm(turn))
        rotation = rotation_about(turn / angle, np.radians(angle)) if angle else np.eye(3)
        pose = camera.world_from_cam @ transform(rotation, shift)
        moved.append(replace(camera, world_from_cam=pose))
    return tuple(moved)


def draw_lights(rng: np.random.Generator, config: LightsConfig) -> tuple[tuple[Light, ...], float]:
    """Draw directional lights, and the radiance of the ambient light."""
    number = int(rng.integers(max(config.number[0], 1), max(config.number[1], 1) + 1))
    shares = rng.dirichlet(np.full(number, 3.0)) * rng.uniform(*config.intensity)
    lights: list[Light] = []
    for share in shares:
        azimuth, elevation = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(*config.elevation))
        warmth = rng.uniform(*config.warmth)
        away = _direction(azimuth, elevation)
        color = np.clip([1.0 + warmth, 1.0, 1.0 - warmth], 0.0, 1.0)
        lights.append(Light(-away, (float(color[0]), 1.0, float(color[2])), float(share)))
    return tuple(lights), float(rng.uniform(*config.ambient))


def draw_materials(
    rng: np.random.Generator, config: MaterialsConfig, model: ArticulatedModel
) -> tuple[Material, ...]:
    """Return materials, one per visual; each distinct colour is changed by its own draw."""
    drawn: dict[tuple[object, ...], dict[str, Any]] = {}
    out: list[Material] = []
    for visual in model.visuals:
        m = visual.material
        key = (m.name, m.base_color, m.metallic, m.roughness, id(m.texture))
        if key not in drawn:
            chance, hue = rng.random(), rng.uniform(-1, 1) * config.hue
            value = rng.uniform(*config.value)
            rough, metal = rng.uniform(*config.roughness), rng.uniform(*config.metallic)
            drawn[key] = {}
            if chance < config.probability:
                h, s, v = colorsys.rgb_to_hsv(*m.base_color[:3])
                rgb = colorsys.hsv_to_rgb((h + hue) % 1.0, s, min(v * float(value), 1.0))
                drawn[key] = {"base_color": (*rgb, m.base_color[3]), "metallic": float(metal),
                              "roughness": float(rough)}
        out.append(replace(m, **drawn[key]))
    return tuple(out)


def draw_textures(
    rng: np.random.Generator, config: TexturesConfig, model: ArticulatedModel,
    materials: tuple[Material, ...], size: float,
) -> tuple[tuple[Material, ...], Array, dict[str, str]]:
    """Return materials with drawn textures, tile sizes [visuals] m (0: none), and kinds by part.

    `size` is that of the robot, m. A drawn texture replaces the colour of all surfaces of its part.
    """
    tile = np.zeros(len(materials))
    out, kinds = list(materials), dict[str, str]()
    images = ImageFolder(config.folder) if config.folder else None
    for part in sorted({v.part for v in model.visuals}):
        chance, scale = rng.random(), rng.uniform(*config.scale)
        kind = str(rng.choice(config.kinds))
        child = np.random.default_rng(rng.integers(2**63))
        if chance >= (config.probability or 0.0):
            continue
        shape = (config.size, config.size)
        image = draw_image((kind,), images, shape, child, tileable=True)
        kinds[model.part_names[part]] = config.folder or kind
        for k, visual in enumerate(model.visuals):
            # a surface with holes from its alpha channel keeps its texture
            if visual.part == part and out[k].alpha_cutoff is None:
                m = out[k]
                out[k] = Material(m.name, (1.0, 1.0, 1.0, 1.0), m.metallic, m.roughness, image)
                tile[k] = scale * size
    return tuple(out), tile, kinds


def draw_background(
    rng: np.random.Generator, config: BackgroundConfig, camera: Camera, floor: float,
    center: Array, reach: float,
) -> tuple[NDArray[np.uint8] | None, tuple[RoomSurface, ...], str]:
    """Draw a background image [H W 3] or the surfaces of a room; also return its name."""
    is_room, kind = rng.random() < config.room, str(rng.choice(config.kinds))
    if is_room:
        eye = camera.world_from_cam[:3, 3]
        return None, draw_room(rng, config, floor, center, eye, reach), "room"
    shape = (camera.height, camera.width)
    images = ImageFolder(config.folder) if config.folder else None
    image = draw_image((kind,), images, shape, rng, False, config.color)
    return image, (), config.folder or kind


def draw_imperfections(
    rng: np.random.Generator, config: ImageConfig
) -> tuple[dict[str, float], int]:
    """Draw noise (grey levels), blur (px), exposure and its drift (stops); and a seed of noise."""
    found = {n: float(rng.uniform(*getattr(config, n))) for n in ("noise", "blur", "exposure")}
    noise_seed = int(rng.integers(2**62))
    found["exposure_drift"] = float(rng.uniform(*config.exposure_drift))
    return found, noise_seed


def draw_scene(
    streams: Streams, model: ArticulatedModel, trajectory: JointTrajectory,
    cameras: tuple[Camera, ...], points: Array, floor: float,
) -> tuple[Scene, dict[str, Any]]:
    """Draw the scene for a motion and the cameras of its frames; also return a record of the drawn
    values.

    `points` [N 3] m (world) bound the robot over all frames.
    """
    config, camera = streams.config.randomization, cameras[0]
    low, high = points.min(0), points.max(0)
    center, size = (low + high) / 2.0, float(np.linalg.norm(high - low))
    reach = float(np.linalg.norm((points - center)[:, :2], axis=1).max())
    lights, ambient = draw_lights(streams.rng("lights"), config.lights)
    materials = draw_materials(streams.rng("materials"), config.materials, model)
    materials, tile, kinds = draw_textures(
        streams.rng("textures"), config.textures, model, materials, size
    )
    backdrop, room, background = draw_background(
        streams.rng("background"), config.background, camera, floor, center, reach
    )
    image, noise_seed = draw_imperfections(streams.rng("image"), config.image)
    exposure = image["exposure"] + np.linspace(0, image["exposure_drift"], len(trajectory.times))
    scene = Scene(
        model, trajectory, cameras, lights, ambient, config.lights.shadows, materials, tile,
        backdrop, room, image["noise"], noise_seed, image["blur"], exposure,
    )
    record = {
        "vertical_fov_deg": float(
            np.degrees(2 * np.arctan(camera.height / 2 / camera.intrinsics[1, 1]))
        ),
        "world_from_cam": camera.world_from_cam.tolist(),
        "floor": floor,
        "lights": [
            {"direction": l.direction.tolist(), "color": list(l.color), "intensity": l.intensity}
            for l in lights
        ],
        "ambient": ambient,
        "materials": [
            {"part": model.part_names[v.part], "name": m.name, "base_color": list(m.base_color),
             "metallic": m.metallic, "roughness": m.roughness, "texture_size": float(s)}
            for v, m, s in zip(model.visuals, materials, tile, strict=True)
        ],
        "textures": kinds,
        "background": background,
        "image": image,
    }
    return scene, record
