"""A second opinion on rendered datasets, from other people's code only.

ZIP, PNG and NPZ are read with the standard library, OpenCV and NumPy; kinematics come from
yourdfpy, meshes from trimesh, rays from Embree. Nothing of gcbench is imported, so that a mistake
made twice is at least not the same mistake.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import trimesh
import yourdfpy
from trimesh.ray.ray_pyembree import RayMeshIntersector

FINE = 1024  # facets of a round primitive: 5e-6 of its radius off the true one


@dataclass
class Robot:
    """Links with their meshes [in the link's frame, m], and yourdfpy for their poses."""

    urdf: yourdfpy.URDF
    meshes: dict[str, trimesh.Trimesh]

    def poses(self, names, positions):
        """base_from_link of each link for joint values by name."""
        self.urdf.update_cfg(dict(zip(names, (float(q) for q in positions), strict=True)))
        base = self.urdf.base_link
        return {name: np.array(self.urdf.get_transform(name, base)) for name in self.urdf.link_map}


def load_robot(path: Path) -> Robot:
    urdf = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    meshes = {}
    for name, link in urdf.link_map.items():
        found = []
        for visual in link.visuals:
            mesh = _mesh(visual.geometry, path)
            if visual.origin is not None:
                mesh.apply_transform(visual.origin)
            found.append(mesh)
        if found:
            meshes[name] = trimesh.util.concatenate(found)
    return Robot(urdf, meshes)


def _mesh(geometry, urdf: Path) -> trimesh.Trimesh:
    if geometry.box is not None:
        return trimesh.creation.box(geometry.box.size)
    if geometry.cylinder is not None:
        c = geometry.cylinder
        return trimesh.creation.cylinder(c.radius, c.length, sections=FINE)
    if geometry.sphere is not None:
        # not uv_sphere: Embree misses its thinnest triangles, at the poles
        return trimesh.creation.icosphere(subdivisions=6, radius=geometry.sphere.radius)
    path = _resolve(geometry.mesh.filename, urdf)
    scene = trimesh.load_scene(path, skip_materials=True)
    mesh = scene.to_mesh()
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if path.suffix.lower() == ".dae":  # trimesh tells the unit but does not apply it
        unit = re.search(r'<unit[^>]*meter="([^"]+)"', path.read_text(encoding="utf-8"))
        mesh.apply_scale(float(unit[1]) if unit else 1.0)
    if geometry.mesh.scale is not None:
        mesh.vertices *= np.broadcast_to(geometry.mesh.scale, 3)
    return mesh


def _resolve(name: str, urdf: Path) -> Path:
    """A mesh beside the URDF, or in the package that one of the URDF's own folders belongs to."""
    if not name.startswith("package://"):
        return urdf.parent / name
    rest = Path(name.removeprefix("package://"))
    for folder in urdf.parents:
        for candidate in (folder / rest, folder / Path(*rest.parts[1:])):
            if candidate.is_file():
                return candidate
    raise FileNotFoundError(name)


@dataclass
class Video:
    """A sequence as the contract describes it."""

    path: Path
    meta: dict = field(init=False)
    state: dict = field(init=False)

    def __post_init__(self):
        with zipfile.ZipFile(self.path) as z:
            self.meta = json.loads(z.read("meta.json"))
            with np.load(io.BytesIO(z.read("state.npz")), allow_pickle=False) as arrays:
                self.state = dict(arrays)

    def image(self, kind: str, t: int) -> np.ndarray:
        with zipfile.ZipFile(self.path) as z:
            data = np.frombuffer(z.read(f"{kind}/{t:06d}.png"), np.uint8)
        return cv2.imdecode(data, cv2.IMREAD_UNCHANGED)

    def flow(self, kind: str, t: int):
        """(du, dv) [H W 2] and validity [H W]; OpenCV gives the channels in reverse."""
        png = self.image(kind, t)[..., ::-1].astype(np.float64)
        return (png[..., :2] - 32768) / 64, png[..., 2] > 0


@dataclass
class Opinion:
    """Residuals of a sequence against the second opinion."""

    depth: np.ndarray
    """m, of interior pixels whose part agrees"""
    part_equal: np.ndarray
    """[interior pixels] bool"""
    flow: np.ndarray
    """px, length of the difference, visible interior pixels"""
    flow_backward: np.ndarray
    """px"""
    position: float
    """m, worst part position"""
    rotation: float
    """rad, worst part rotation"""
    depth_unit: float
    """m"""
    background: np.ndarray
    """[background pixels far from the robot's edge] bool: nothing of the robot is hit"""

    def summary(self) -> str:
        def q(x):
            values = np.quantile(x, [0.5, 0.99, 0.999, 1]) if len(x) else ()
            return " ".join(f"{value:.2e}" for value in values)
        return "\n".join([
            "                 median   99%      99.9%    worst",
            f"depth, m         {q(self.depth)}", f"flow, px         {q(self.flow)}",
            f"backward, px     {q(self.flow_backward)}",
            f"part equal       {self.part_equal.mean():.6f} of {len(self.part_equal)}",
            f"background empty {self.background.mean():.6f} of {len(self.background)}",
            f"poses            {self.position:.1e} m {self.rotation:.1e} rad"])


def examine(path: Path, robot: Robot, rng: np.random.Generator, pixels: int = 5000) -> Opinion:
    """Compare every frame of a sequence at `pixels` random interior pixels."""
    video = Video(path)
    s, names = video.state, video.meta["part_names"]
    frames = video.meta["frames"]
    unit, k = video.meta["depth_unit"], s["intrinsics"]
    poses, position, rotation = [], 0.0, 0.0
    for t in range(frames):
        links = robot.poses(video.meta["joint_names"], s["joint_positions"][t])
        expected = np.stack([links[n] for n in names])
        actual = s["world_from_part"][t]
        root = names.index(robot.urdf.base_link)
        expected = actual[root] @ expected  # where the robot stands is the renderer's choice
        position = max(position, np.abs(actual[:, :3, 3] - expected[:, :3, 3]).max())
        relative = np.swapaxes(actual[:, :3, :3], 1, 2) @ expected[:, :3, :3]
        skew = relative - np.swapaxes(relative, 1, 2)
        rotation = max(rotation, float(np.abs(skew).max() / 2))  # the sine of the angle
        poses.append(expected)
    found = {key: [] for key in ("depth", "part_equal", "flow", "flow_backward", "background")}
    for t in range(frames):
        part = video.image("part", t).astype(int)
        depth = video.image("depth", t) * unit
        cam_from_world = s["cam_from_world"][t]
        rays, owner = _intersector(robot, names, poses[t])

        v, u = _choose(_interior(part, depth) & (part > 0), rng, pixels)
        z, hit_part = _cast(rays, owner, k, cam_from_world, u, v)
        same = hit_part == part[v, u]
        found["part_equal"].append(same)
        found["depth"].append(np.abs(z - depth[v, u])[same])

        points = _unproject(k, cam_from_world, u, v, z)
        if t + 1 < frames:
            seen = video.image("visibility", t)[v, u] == 1
            found["flow"].append(_flow_error(video, "flow", t, t + 1, poses, k, points, hit_part,
                                             u, v, same & seen))
        if t > 0:
            found["flow_backward"].append(_flow_error(video, "flow_backward", t, t - 1, poses, k,
                                                      points, hit_part, u, v, same))

        v, u = _choose(_interior(part, depth) & (part == 0), rng, pixels)
        z, hit_part = _cast(rays, owner, k, cam_from_world, u, v)
        room = depth[v, u]
        found["background"].append((hit_part == 0) | ((room > 0) & (z > room - 2 * unit)))
    return Opinion(position=position, rotation=rotation, depth_unit=unit,
                   **{key: np.concatenate(x) if x else np.zeros(0) for key, x in found.items()})


def _interior(part, depth):
    """Pixels whose 5x5 neighborhood is one part without a jump in depth or slope.

    A polygon of 64 corners and the circle that it stands for have other outlines, and there they
    differ by whatever is behind.
    """
    box = np.ones((5, 5), np.uint8)
    p, d = part.astype(np.float32), depth.astype(np.float32)
    one_part = cv2.erode(p, box, borderValue=-1) == cv2.dilate(p, box, borderValue=-1)
    bend = np.maximum(*(np.abs(cv2.filter2D(d, -1, kernel, borderType=cv2.BORDER_REPLICATE))
                        for kernel in (np.array([[1.0, -2, 1]]), np.array([[1.0], [-2], [1]]))))
    inside = np.zeros(part.shape, bool)
    inside[2:-2, 2:-2] = True
    return inside & one_part & (cv2.dilate(bend, box) <= 0.002 * d)


def _choose(mask, rng, n):
    index = np.flatnonzero(mask)
    index = rng.permutation(index)[:n]
    return np.divmod(index, mask.shape[1])


def _intersector(robot, names, poses):
    """Embree's scene of all links in the world, and the part number of each face."""
    moved, owner = [], []
    for number, (name, pose) in enumerate(zip(names, poses, strict=True), 1):
        if name in robot.meshes:
            mesh = robot.meshes[name].copy()
            moved.append(mesh.apply_transform(pose))
            owner.append(np.full(len(mesh.faces), number))
    whole = trimesh.util.concatenate(moved)
    return RayMeshIntersector(whole), np.concatenate(owner)


def _cast(rays, owner, k, cam_from_world, u, v):
    """Depth (nan: none) and part number (0: none) of the first hit at pixel centers."""
    world_from_cam = np.linalg.inv(cam_from_world)
    directions = np.stack([u, v, np.ones_like(u)], axis=1) @ np.linalg.inv(k).T
    directions = directions @ world_from_cam[:3, :3].T  # z = 1 in the camera: length is depth
    origins = np.broadcast_to(world_from_cam[:3, 3], directions.shape)
    face = rays.intersects_first(origins, directions)
    hit = face >= 0
    corners = rays.mesh.triangles[face]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    z = np.full(len(u), np.nan)  # again, from the plane in float64: Embree works in float32
    z[hit] = (np.sum(normal * (corners[:, 0] - origins), axis=1)[hit]
              / np.sum(normal * directions, axis=1)[hit])
    return z, np.where(hit, owner[face], 0)


def _unproject(k, cam_from_world, u, v, z):
    cam = np.stack([u, v, np.ones_like(u)], axis=1) @ np.linalg.inv(k).T * z[:, None]
    world_from_cam = np.linalg.inv(cam_from_world)
    return cam @ world_from_cam[:3, :3].T + world_from_cam[:3, 3]


def _flow_error(video, kind, t, other, poses, k, points, part, u, v, use):
    """px between stored flow and that of the hit points, moved with their links."""
    flow, valid = video.flow(kind, t)
    use = use & valid[v, u]
    move = (poses[other] @ np.linalg.inv(poses[t]))[part[use] - 1]
    view = video.state["cam_from_world"][other]
    expected = _displaced(k, view, move, points[use], u[use], v[use])
    return np.linalg.norm(flow[v[use], u[use]] - expected, axis=1)


def _displaced(k, cam_from_world, move, points, u, v):
    """[N 2] px from pixels (u, v) to where their points [N 3] are after the motions [N 4 4]."""
    moved = np.einsum("nij,nj->ni", move[:, :3, :3], points) + move[:, :3, 3]
    there = (moved @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]) @ k.T
    return there[:, :2] / there[:, 2:] - np.stack([u, v], axis=1)


def visibility(path: Path, robot: Robot) -> dict[str, tuple[float, int, float, float]]:
    """By scored joint: displacement, and of what it carries the fewest pixels and the smallest
    share of those it would show alone in a frame, and how far its own step moves them, px."""
    video, out = Video(path), {}
    s, names, joints = video.state, video.meta["part_names"], video.meta["joint_names"]
    size = video.meta["height"], video.meta["width"]
    v, u = np.divmod(np.arange(size[0] * size[1]), size[1])
    root = names.index(robot.urdf.base_link)
    for joint in video.meta["scored_joints"]:
        carried = _carried(robot.urdf, robot.urdf.joint_map[joint].child)
        number = [i + 1 for i, name in enumerate(names) if name in carried]
        alone = Robot(robot.urdf, {n: m for n, m in robot.meshes.items() if n in carried})
        q = s["joint_positions"][:, joints.index(joint)]
        pixels, share, motion = [], [], []
        for t, view in enumerate(s["cam_from_world"]):
            standing, values = s["world_from_part"][t][root], s["joint_positions"][t].copy()
            here = _posed(robot, names, joints, values, standing)
            z, part = _cast(*_intersector(robot, names, here), s["intrinsics"], view, u, v)
            _, bare = _cast(*_intersector(alone, names, here), s["intrinsics"], view, u, v)
            mine = np.isin(part, number)
            pixels.append(int(mine.sum()))
            share.append(mine.sum() / max(1, (bare > 0).sum()))
            if t + 1 == len(q):
                break
            values[joints.index(joint)] = q[t + 1]
            stepped = _posed(robot, names, joints, values, standing)
            move = (stepped @ np.linalg.inv(here))[part[mine] - 1]
            points = _unproject(s["intrinsics"], view, u[mine], v[mine], z[mine])
            away = _displaced(s["intrinsics"], view, move, points, u[mine], v[mine])
            motion.append(np.median(np.linalg.norm(away, axis=1)) if mine.any() else 0.0)
        out[joint] = q[-1] - q[0], min(pixels), min(share), float(np.mean(motion))
    return out


def _posed(robot, names, joints, values, standing):
    """world_from_part of each name, where the base link stands so."""
    links = robot.poses(joints, values)
    return np.stack([standing @ links[n] for n in names])


def _carried(urdf, link):
    """The names of a link and all that hang on it."""
    out = {link}
    for joint in urdf.robot.joints:
        if joint.parent == link:
            out |= _carried(urdf, joint.child)
    return out
