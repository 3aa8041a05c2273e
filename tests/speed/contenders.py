"""What `render_speed.py` compares: each class renders shots of one robot, in its own process.

They use the public names of the renderer only.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from gcbench.renderer.dataset import SequenceWriter
from gcbench.renderer.generate import stream
from gcbench.renderer.generate.sequence_renderer import SequenceRenderer
from gcbench.renderer.gl import Rasterizer
from gcbench.renderer.scene import RenderConfig, Scene, Streams, draw_scene, model_source, resolve
from gcbench.renderer.truth import Draw, DrawSampler, SequenceTruth
from gcbench.renderer.types import Frame
from gcbench.robots.catalog import robot_urdf

DEPTH_UNIT = 0.0001
"""m"""


@dataclass
class Shot:
    """A sampled sequence without images: the input of every contender."""

    scene: Scene
    draw: Draw
    """Motion and camera."""
    depth_unit: float = DEPTH_UNIT

    @property
    def world_from_part(self) -> np.ndarray:
        """[T P 4 4]"""
        return self.draw.motion.world_from_part


def draw_shots(config: RenderConfig, n: int) -> list[Shot]:
    """Sample the first n sequences of a config."""
    config = resolve(config)
    source = model_source(config, 0)
    rasterizer = Rasterizer(config.width, config.height)
    sampler = DrawSampler(source.model, source.scored, config, rasterizer, source.fixed_motion)
    shots = []
    for index in range(n):
        streams = Streams(config, index)
        draw, _ = sampler.draw(streams)
        motion = draw.motion
        outline = sampler.motions.outline(motion.posed)
        scene, _ = draw_scene(
            streams, source.model, motion.trajectory, draw.cameras, outline, motion.floor)
        shots.append(Shot(scene, replace(draw, depth=[], part=[], face=[])))
    rasterizer.close()
    return shots


class Shipped:
    """`SequenceRenderer.render` with all frames: samples, tests observability, renders."""

    def __init__(self, config: RenderConfig, shots: list[Shot]) -> None:
        self.renderer = SequenceRenderer(config)

    def frames(self, index: int) -> Iterator[Frame]:
        yield from self.renderer.render(index).frames

    def versions(self) -> str:
        rendered = self.renderer.render(0)
        for _ in rendered.frames:
            pass
        used = rendered.finish()[0].renderer
        return f"{used['renderer']}; OpenGL {used['version']}"


class Encoded(Shipped):
    """The same, written to disk."""

    def __init__(self, config: RenderConfig, shots: list[Shot]) -> None:
        super().__init__(config, shots)
        self.folder = tempfile.TemporaryDirectory()

    def frames(self, index: int) -> Iterator[Frame]:
        rendered = self.renderer.render(index)
        with SequenceWriter(Path(self.folder.name), index, rendered.depth_unit) as writer:
            for frame in rendered.frames:
                writer.add(frame)
                yield frame
            writer.finish(*rendered.finish())


class Streamed:
    """`gb.stream`: tensors of all images, rounded as those that are stored."""

    def __init__(self, config: RenderConfig, shots: list[Shot]) -> None:
        import torch  # missing, it is the reason to leave this out

        self.version, self.length = torch.__version__, config.frames
        self.items = iter(stream(config, pairs=False))

    def frames(self, index: int) -> Iterator[int]:
        item = next(self.items)
        assert item["sequence"] == index, "sequences are streamed in order"
        yield from range(self.length)

    def versions(self) -> str:
        return f"torch {self.version}"


class Pure:
    """Rendering alone: scenes are given, nothing is sampled or tested."""

    def __init__(self, config: RenderConfig, shots: list[Shot]) -> None:
        self.config, self.shots = resolve(config), shots
        self.rasterizer = Rasterizer(
            config.width, config.height, round(self.config.samples**0.5))

    def frames(self, index: int) -> Iterator[Frame]:
        shot, draw = self.shots[index], self.draw(index)
        truth = SequenceTruth(
            self.config, index, shot.scene.model, draw, shot.depth_unit, ())
        for t in range(len(draw.depth)):
            color = self.rasterizer.draw_color(shot.scene, draw.motion.posed, t)
            yield truth.frame(t, lambda color=color: color.rgb)

    def draw(self, index: int) -> Draw:
        """Depth and parts of all frames, in the room if the scene has one."""
        shot, posed = self.shots[index], self.shots[index].draw.motion.posed
        drawn = [self.rasterizer.draw_truth(posed, shot.scene.cameras[t], t)
                 for t in range(len(shot.world_from_part))]
        depth, part = [d.depth for d in drawn], [d.part for d in drawn]
        room = self.rasterizer.draw_room(shot.scene, posed)
        if room is not None:
            part = [np.where(room.depth < d, np.uint16(0), p)
                    for d, p in zip(depth, part, strict=True)]
            depth = [np.where(p == 0, room.depth, d) for d, p in zip(depth, part, strict=True)]
        return replace(shot.draw, depth=depth, part=part)

    def versions(self) -> str:
        context = self.rasterizer.context
        return f"{context.renderer}; OpenGL {context.version}"


class Images(Pure):
    """RGB, depth and parts only."""

    def frames(self, index: int) -> Iterator[tuple[np.ndarray, ...]]:  # type: ignore[override]
        shot, draw = self.shots[index], self.draw(index)
        for t, (depth, part) in enumerate(zip(draw.depth, draw.part, strict=True)):
            yield self.rasterizer.draw_color(shot.scene, draw.motion.posed, t).rgb, depth, part


class Pyrender:
    """The script `plain_pyrender.py`."""

    def __init__(self, config: RenderConfig, shots: list[Shot]) -> None:
        from plain_pyrender import PyrenderScript

        names = shots[0].scene.model.part_names
        self.shots = shots
        self.script = PyrenderScript(urdf(config.robot), names, config.width, config.height)

    def frames(self, index: int):
        yield from self.script.frames(self.shots[index])

    def versions(self) -> str:
        from importlib.metadata import version

        return f"scikit-robot-pyrender {version('scikit-robot-pyrender')}"


class Bullet:
    """PyBullet's TinyRenderer: RGB, depth and link numbers in one call, without shadows."""

    def __init__(self, config: RenderConfig, shots: list[Shot]) -> None:
        import pybullet

        self.p, self.shots = pybullet, shots
        self.size = config.width, config.height
        pybullet.connect(pybullet.DIRECT)
        path = urdf(config.robot)
        pybullet.setAdditionalSearchPath(str(path.parent))
        self.body = pybullet.loadURDF(str(path), useFixedBase=True)
        number = pybullet.getNumJoints(self.body)
        self.joint = {pybullet.getJointInfo(self.body, j)[1].decode(): j for j in range(number)}

    def frames(self, index: int):
        p, shot = self.p, self.shots[index]
        camera, motion, (w, h) = shot.scene.cameras[0], shot.draw.motion, self.size
        k, near, far = camera.intrinsics, 0.05, 50.0
        flip = np.diag([1.0, -1.0, -1.0, 1.0])
        view = np.linalg.inv(camera.world_from_cam @ flip).T.ravel().tolist()
        clip = np.zeros((4, 4))
        clip[0, 0], clip[0, 2] = 2 * k[0, 0] / w, 1 - 2 * (k[0, 2] + 0.5) / w
        clip[1, 1], clip[1, 2] = 2 * k[1, 1] / h, 2 * (k[1, 2] + 0.5) / h - 1
        clip[2, 2], clip[2, 3] = -(far + near) / (far - near), -2 * far * near / (far - near)
        clip[3, 2] = -1.0
        light, names = shot.scene.lights[0], shot.scene.model.joint_names
        for positions in motion.trajectory.positions:
            for name, value in zip(names, positions, strict=True):
                p.resetJointState(self.body, self.joint[name], value)
            _, _, rgba, depth, seg = p.getCameraImage(
                w, h, view, clip.T.ravel().tolist(), shadow=0, renderer=p.ER_TINY_RENDERER,
                lightDirection=(-light.direction).tolist(), lightColor=light.color,
                lightAmbientCoeff=shot.scene.ambient,
                flags=p.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
            )
            rgb = np.reshape(rgba, (h, w, 4))[..., :3]
            z = far * near / (far - (far - near) * np.reshape(depth, (h, w)))
            seg = np.reshape(seg, (h, w))
            yield rgb, z, np.where(seg < 0, 0, (seg >> 24) + 1).astype(np.uint16)

    def versions(self) -> str:
        from importlib.metadata import version

        return f"pybullet {version('pybullet')}"


class Mujoco:
    """MuJoCo's renderer: three passes; parts are bodies whose poses are set."""

    def __init__(self, config: RenderConfig, shots: list[Shot]) -> None:
        import os

        os.environ["MUJOCO_GL"] = "egl"
        import mujoco

        self.mujoco, self.shots = mujoco, shots
        model = shots[0].scene.model
        parts = sorted({v.part for v in model.visuals})
        self.parts = np.array(parts)
        assets, bodies, files = [], dict.fromkeys(parts, ""), {}
        for i, visual in enumerate(model.visuals):
            files[f"{i}.obj"] = _obj(visual.vertices, visual.faces)
            color = " ".join(f"{c ** (1 / 2.2):.3f}" for c in visual.material.base_color[:3])
            assets.append(f'<mesh name="m{i}" file="{i}.obj" inertia="shell"/>')
            bodies[visual.part] += (f'<geom type="mesh" mesh="m{i}" rgba="{color} 1" '
                                    'contype="0" conaffinity="0"/>')
        body = "".join(f'<body name="p{part}" mocap="true">{geoms}</body>'
                       for part, geoms in bodies.items())
        lights = "".join(
            f'<light directional="true" castshadow="false" dir="{x} {y} {z}" pos="0 0 5"/>'
            for x, y, z in (light.direction for light in shots[0].scene.lights))
        self.model = mujoco.MjModel.from_xml_string(f"""<mujoco>
          <visual><global offwidth="{config.width}" offheight="{config.height}"/>
            <headlight active="0"/><map znear="0.01" zfar="50"/></visual>
          <statistic extent="1" center="0 0 0.5"/>
          <asset>{''.join(assets)}</asset>
          <worldbody>{lights}{body}<camera name="c" mode="fixed"/></worldbody></mujoco>""", files)
        # MuJoCo moves meshes into their own inertial frames; geoms undo it, for bodies at identity.
        self.data = mujoco.MjData(self.model)
        self.renderer = mujoco.Renderer(self.model, config.height, config.width)
        self.part_of_geom = np.append(
            [parts[b - 1] + 1 for b in self.model.geom_bodyid], 0).astype(np.uint16)

    def frames(self, index: int):
        shot, mujoco = self.shots[index], self.mujoco
        camera = shot.scene.cameras[0]
        flip = np.diag([1.0, -1.0, -1.0])
        self.model.cam_pos[0] = camera.world_from_cam[:3, 3]
        turned = camera.world_from_cam[:3, :3] @ flip
        mujoco.mju_mat2Quat(self.model.cam_quat[0], turned.ravel())
        fovy = 2 * np.arctan(camera.height / 2 / camera.intrinsics[1, 1])
        self.model.cam_fovy[0] = np.degrees(fovy)
        for poses in shot.world_from_part:
            for k, part in enumerate(self.parts):
                self.data.mocap_pos[k] = poses[part][:3, 3]
                mujoco.mju_mat2Quat(self.data.mocap_quat[k], poses[part][:3, :3].ravel())
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_camlight(self.model, self.data)
            self.renderer.update_scene(self.data, camera=0)
            rgb = self.renderer.render()
            self.renderer.enable_depth_rendering()
            depth = self.renderer.render()
            self.renderer.disable_depth_rendering()
            self.renderer.enable_segmentation_rendering()
            geom = self.renderer.render()[..., 0]
            self.renderer.disable_segmentation_rendering()
            yield rgb, depth, self.part_of_geom[geom]

    def versions(self) -> str:
        return f"mujoco {self.mujoco.__version__}"


def _obj(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    lines = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    return "\n".join(lines).encode()


def urdf(robot: str) -> Path:
    """Return the URDF file of a robot of the catalogue, or that path."""
    path = robot_urdf(robot)
    if path is None:
        raise ValueError(f"{robot} has no URDF file")
    return path


CONTENDERS = {c.__name__: c for c in (
    Shipped, Streamed, Encoded, Pure, Images, Pyrender, Bullet, Mujoco)}
