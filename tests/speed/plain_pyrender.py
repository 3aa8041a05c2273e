"""The arrays of a `Frame` as a pyrender user would make them: two passes, then NumPy.

Nothing is slowed down: the scene is built once, poses are set from frame to frame, the default
multisampling and one pass each for colour with depth and for segmentation are pyrender's own way.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np


def resolve(fname: str, urdf: Path) -> str:
    """The file that a mesh's name in the URDF means; `package://` is a folder above it."""
    rest = fname.removeprefix("package://")
    for folder in (urdf.parent, *urdf.parents):
        for candidate in (folder / rest, folder / rest.partition("/")[2]):
            if candidate.is_file():
                return str(candidate)
    raise FileNotFoundError(fname)


class PyrenderScript:
    """Renders shots (`contenders.Shot`) of the robot of a URDF."""

    def __init__(self, urdf: Path, part_names: tuple[str, ...], width: int, height: int) -> None:
        import pyrender
        import yourdfpy

        self.pyrender = pyrender
        self.renderer = pyrender.OffscreenRenderer(width, height)
        self.scene = pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 1.0])
        robot = yourdfpy.URDF.load(str(urdf), filename_handler=partial(resolve, urdf=urdf))
        graph = robot.scene.graph
        self.nodes, self.colors = [], {}
        for name in graph.nodes_geometry:
            link_from_mesh, geometry = graph.get(name, graph.transforms.parents[name])
            mesh = pyrender.Mesh.from_trimesh(robot.scene.geometry[geometry])
            part = part_names.index(graph.transforms.parents[name])
            node = self.scene.add(mesh)
            self.nodes.append((node, part, link_from_mesh))
            self.colors[node] = (part + 1, 0, 0)
        v, u = np.mgrid[:height, :width].astype(np.float64)
        self.u, self.v = u, v

    def frames(self, shot):
        """(rgb, depth, part, flow, flow_backward, visibility) of each frame of a shot."""
        scene, extra = self.scene, self._dress(shot.scene)
        colors = dict(self.colors)
        colors |= {node: (0, 0, 0) for node in extra if node.mesh is not None}
        cam_from_world = np.linalg.inv(shot.scene.cameras[0].world_from_cam)
        k, unit = shot.scene.cameras[0].intrinsics, shot.depth_unit
        images, last = [], len(shot.world_from_part) - 1
        for poses in shot.world_from_part:
            for node, part, link_from_mesh in self.nodes:
                scene.set_pose(node, poses[part] @ link_from_mesh)
            rgb, depth = self.renderer.render(scene)
            seg, _ = self.renderer.render(scene, self.pyrender.RenderFlags.SEG, colors)
            if shot.scene.backdrop is not None:
                rgb = np.where(depth[..., None] == 0, shot.scene.backdrop, rgb)
            images.append((rgb, depth, seg[..., 0].astype(np.uint16)))
        for t, (rgb, depth, part) in enumerate(images):
            points = self._points(depth, k)
            flow = backward = seen = None
            if t > 0:
                backward, _ = self._flow(points, part, shot, cam_from_world, t, t - 1, k)
            if t < last:
                flow, depth_there = self._flow(points, part, shot, cam_from_world, t, t + 1, k)
                seen = self._visibility(flow, depth_there, part, *images[t + 1][1:], unit)
            yield rgb, depth, part, flow, backward, seen
        for node in extra:
            scene.remove_node(node)

    def _dress(self, given):
        """Camera, lights and room of a shot; returns the nodes, to be removed after it."""
        pyrender, scene, camera = self.pyrender, self.scene, given.camera
        scene.ambient_light = [given.ambient] * 3
        k = camera.intrinsics  # pyrender's pixel centers lie at j + 0.5
        flip = np.diag([1.0, -1.0, -1.0, 1.0])
        far = 4.0 * np.linalg.norm(camera.world_from_cam[:3, 3]) + 10.0
        extra = [scene.add(pyrender.IntrinsicsCamera(
            k[0, 0], k[1, 1], k[0, 2] + 0.5, k[1, 2] + 0.5, 0.05, far
        ), pose=camera.world_from_cam @ flip)]
        scene.main_camera_node = extra[0]
        for light in given.lights:
            z = -light.direction / np.linalg.norm(light.direction)
            x = np.cross([0.0, 0.0, 1.0] if abs(z[2]) < 0.99 else [0.0, 1.0, 0.0], z)
            x /= np.linalg.norm(x)
            pose = np.eye(4)
            pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
            extra.append(scene.add(
                pyrender.DirectionalLight(light.color, light.intensity), pose=pose))
        for s in given.room:
            texture = pyrender.Texture(source=s.texture[::-1], source_channels="RGB")
            material = pyrender.MetallicRoughnessMaterial(
                baseColorFactor=[*s.base_color, 1.0], baseColorTexture=texture,
                metallicFactor=0.0, roughnessFactor=s.roughness,
            )
            extra.append(scene.add(pyrender.Mesh([pyrender.Primitive(
                s.vertices, s.normals, texcoord_0=s.uv, indices=s.faces, material=material)])))
        return extra

    def _points(self, depth, k):
        z = depth.astype(np.float64)
        return np.stack([(self.u - k[0, 2]) / k[0, 0] * z, (self.v - k[1, 2]) / k[1, 1] * z, z], -1)

    def _flow(self, points, part, shot, cam_from_world, t, other, k):
        """Flow [H W 2] px to another frame, NaN without depth, and depth there [H W] m."""
        moved = points.copy()
        for p in sorted({part for _, part, _ in self.nodes}):
            mask = part == p + 1
            if mask.any():
                here, there = shot.world_from_part[t][p], shot.world_from_part[other][p]
                m = cam_from_world @ there @ np.linalg.inv(here) @ np.linalg.inv(cam_from_world)
                moved[mask] = points[mask] @ m[:3, :3].T + m[:3, 3]
        with np.errstate(invalid="ignore", divide="ignore"):
            u = k[0, 0] * moved[..., 0] / moved[..., 2] + k[0, 2]
            v = k[1, 1] * moved[..., 1] / moved[..., 2] + k[1, 2]
        return np.stack([u - self.u, v - self.v], -1).astype(np.float32), moved[..., 2]

    def _visibility(self, flow, depth_there, part, next_depth, next_part, unit):
        """0 background, 1 visible, 2 occluded, 3 out of the image (the rule of flow.visibility)."""
        height, width = part.shape
        v, u = np.nonzero(part)
        x, y = u + flow[v, u, 0], v + flow[v, u, 1]
        z, number = depth_there[v, u], part[v, u]
        inside = (x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5)
        left = np.floor(np.where(inside, x, 0)).astype(int)
        top = np.floor(np.where(inside, y, 0)).astype(int)
        low, high = np.full(len(v), np.inf), np.full(len(v), -np.inf)
        for dy in (0, 1):
            for dx in (0, 1):
                row, column = (left + dx).clip(0, width - 1), (top + dy).clip(0, height - 1)
                same = next_part[column, row] == number
                there = next_depth[column, row]
                low = np.minimum(low, np.where(same, there, np.inf))
                high = np.maximum(high, np.where(same, there, -np.inf))
        tolerance = np.maximum(2 * unit, 0.002 * z)
        seen = (z >= low - tolerance) & (z <= high + tolerance)
        out = np.zeros(part.shape, np.uint8)
        out[v, u] = np.where(inside, np.where(seen, 1, 2), 3)
        return out
