"""Draws a scene's frames: the truth of its geometry, and its colours.

One vertex buffer holds the whole model, and everything that does not move is drawn once a sequence
into a layer that each frame starts from. Depth and part numbers come from their own pass, into
float32 and integer targets without multisampling, so that no value is ever a mixture of two
surfaces. Colours are drawn finer and averaged: on a CPU that is half the price of multisampling,
and smooths shading as well as edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ...robots.model import ArticulatedModel
from ..scene import Scene, clip_from_world
from ..types import Camera
from .color_pass import ColorPass
from .context import Context, Programs
from .coverage_pass import CoveragePass
from .targets import NoRendererError
from .truth_pass import TruthPass
from .uploaded_model import DeviceModel, Posed


class Rasterizer:
    """Draws one scene after another at one image size. One per process (lessons 18).

    With `faces`, the truth tells the triangle of each pixel too. Surfaces that deform are drawn
    where `place` put them last.
    """

    def __init__(self, width: int, height: int, finer: int = 2, faces: bool = False) -> None:
        self.context = Context()
        gl = self.context.gl
        self.width, self.height = width, height
        most = int(gl.glGetIntegerv(gl.GL_MAX_RENDERBUFFER_SIZE))
        if finer * max(width, height) > most:
            raise NoRendererError(f"images of {width} x {height} are too large here: "
                                  f"the driver draws at most {most // finer} px a side")
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glCullFace(gl.GL_BACK)
        gl.glDisable(gl.GL_DITHER)
        gl.glFrontFace(gl.GL_CW)
        gl.glVertexAttrib4f(3, 1.0, 1.0, 1.0, 1.0)  # of meshes without vertex colours
        gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 1)
        gl.glPixelStorei(gl.GL_UNPACK_ALIGNMENT, 1)
        self.faces = faces
        programs = Programs(gl, faces)
        self._model = DeviceModel(gl)
        self._color = ColorPass(gl, programs, width, height, finer)
        self._truth = TruthPass(gl, programs, width, height, faces)
        self._coverage = CoveragePass(gl, programs, width, height)

    # -- geometry: truth ----------------------------------------------------------------------

    def begin_truth(
        self, model: ArticulatedModel, camera: Camera, world_from_part: Array,
        bounds: Array | None = None,
    ) -> None:
        """Draw the parts that stand still in all frames; world_from_part [T P 4 4].

        World points `bounds` [N 3] m are around what deforms, in all frames.
        """
        self._model.load(model)
        self._model.begin(camera, world_from_part, bounds)
        self._clip_from_world = clip_from_world(camera, self._model.box(world_from_part))
        self._truth.begin(self._model, world_from_part[0], self._clip_from_world)

    def place(self, surfaces: Posed) -> None:
        """Put the surfaces that deform where they are drawn from now on; after `begin_truth`."""
        self._model.place(surfaces)

    def truth(self, world_from_part: Array) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
        """Depth [H W] m (0: none) and part [H W] of the model alone, from part poses [P 4 4]."""
        self.draw_truth(world_from_part)
        return self.read_truth()

    def draw_truth(self, world_from_part: Array) -> None:
        """Begin to draw what `read_truth` gives.

        The software rasterizer works in threads of its own: what is drawn before something is
        read goes on meanwhile.
        """
        self._truth.draw(self._model, world_from_part, self._clip_from_world)

    def read_truth(self) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
        """Depth [H W] m (0: none) and part [H W] of the model alone."""
        return self._truth.read_depth(), self._truth.read_part()

    def read_faces(self) -> NDArray[np.int32]:
        """[H W] number of the triangle that `read_truth` tells of, through all visuals; -1: none.

        After `room_depth`, through the room's surfaces.
        """
        return self._truth.read_faces()

    def room_depth(self) -> NDArray[np.float32]:
        """Depth [H W] m of the current scene's room alone; 0 where there is none."""
        self._truth.draw_room(self._color.room, self._clip_from_world)
        return self._truth.read_depth()

    def outlines(self, camera: Camera, world_from_part: Array) -> NDArray[np.int64]:
        """[P 4] px: a box that holds each part of the model in the image, from poses [P 4 4].

        First column and row, and those after the last; parts without a surface have none.
        """
        part, corners = self._model.boxes(world_from_part)
        low, high = np.full((2, len(world_from_part), 2), [[[np.inf]], [[-np.inf]]])
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = camera.project(corners)
        behind = uv[..., 2].min(1) <= 0  # then it may be anywhere
        uv[behind] = [[-np.inf, -np.inf, 0.0]] * 4 + [[np.inf, np.inf, 0.0]] * 4
        np.minimum.at(low, part, np.floor(uv[..., :2].min(1)) - 1)
        np.maximum.at(high, part, np.ceil(uv[..., :2].max(1)) + 2)
        out = np.clip(np.concatenate([low, high], axis=1), 0, [self.width, self.height] * 2)
        out[np.isinf(low).all(1) & np.isinf(high).all(1) & (low > high).all(1)] = 0
        return out.astype(np.int64)

    # -- appearance: colours ------------------------------------------------------------------

    def begin_color(
        self, scene: Scene, world_from_part: Array, bounds: Array | None = None
    ) -> None:
        """Take a scene in and draw what stands still in all frames (see `begin_truth`)."""
        self._color.take(scene)
        self._model.load(scene.model, scene.texture_size > 0)
        self._model.begin(scene.camera, world_from_part, bounds)
        points = [self._model.box(world_from_part), *(s.vertices for s in scene.room)]
        self._clip_from_world = clip_from_world(scene.camera, np.concatenate(points))
        self._color.begin(self._model, world_from_part[0], self._clip_from_world)

    def draw_color(self, world_from_part: Array) -> None:
        """Begin to draw the colours of one frame from part poses [P 4 4] (see `draw_truth`)."""
        self._color.draw(self._model, world_from_part, self._clip_from_world)

    def read_color(self) -> NDArray[np.uint8]:
        """RGB [H W 3] of the frame that `draw_color` began."""
        return self._color.read()

    def draw_coverage(
        self, world_from_part: Array, group: NDArray[np.int64], where: NDArray[np.int64]
    ) -> None:
        """Begin to draw what `read_coverage` gives; `begin_truth` was before it.

        Poses are [P 4 4], `group` [P] is 0..31, or -1 for parts that are left out. Each part is
        drawn in its box `where` [P 4] px alone: first column and row, and those after the last.
        """
        self._coverage.draw(self._model, world_from_part, self._clip_from_world, group, where)

    def read_coverage(self) -> NDArray[np.uint32]:
        """[H W] bits: bit g is set where a part of group g would be seen with nothing before it
        (and its box allows).
        """
        return self._coverage.read()

    def close(self) -> None:
        """Free everything that OpenGL holds."""
        self._color.forget()
        self.context.close()
