"""Draws frames: the truth of their geometry, and their colours.

Each call returns a value. What stands still in a sequence is drawn once, into a layer that each
frame starts from; the rasterizer recognizes a sequence by the identity of its arguments. A camera
that moves is another one in each frame. Colours are drawn finer than the image and averaged: on a
CPU this costs half as much as multisampling, and it smooths shading as well as edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene import PosedModel, Scene
from ..types import Camera
from .color_pass import ColorPass, DrawnColor
from .context import GLContext, Programs
from .framebuffers import NoRendererError
from .truth_pass import CoveragePass, DrawnTruth, TruthPass
from .uploaded_model import Shot, UploadedModel, upload_model


class Rasterizer:
    """Draws images of one size. A process must hold only one.

    The software rasterizer works in threads of its own: between a draw and the first access to
    its images, the caller can do other work. Frames may be drawn in any order.
    """

    def __init__(
        self, width: int, height: int, finer: int = 2, faces: bool = False,
        copies_ahead: bool | None = None,
    ) -> None:
        """Colour has `finer` samples along each side of a pixel; with `faces`, the truth includes
        triangles. `copies_ahead`: as of `Programs`; by default, GPUs do. Raises NoRendererError if
        no EGL device can draw images of this size.
        """
        self.context = GLContext()
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
        ahead = not self.context.is_software if copies_ahead is None else copies_ahead
        programs = Programs(gl, faces, ahead)
        self._uploaded: UploadedModel | None = None
        self._truth_shot: Shot | None = None
        self._color_shot: Shot | None = None
        self._placed: tuple[Shot, int] | None = None
        self._color = ColorPass(programs, width, height, finer)
        self._truth = TruthPass(programs, width, height)
        self._coverage = CoveragePass(programs, width, height)

    def draw_truth(self, posed: PosedModel, camera: Camera, t: int = 0) -> DrawnTruth:
        """Draw depth, part numbers (and triangles) of the model alone in frame t."""
        shot = self._take_truth_shot(posed, camera)
        self._place(shot, t)
        return self._truth.draw(shot, t)

    def draw_room(self, scene: Scene, posed: PosedModel, t: int = 0) -> DrawnTruth | None:
        """Draw depth (and triangles) of a scene's room alone in frame t; None if it has no room."""
        shot = self._take_color_shot(scene, posed, t)
        room = self._color.room
        return None if room is None else self._truth.draw_room(room, shot.clip_from_world)

    def draw_color(self, scene: Scene, posed: PosedModel, t: int = 0) -> DrawnColor:
        """Draw the colours of frame t of a scene, before noise and blur."""
        shot = self._take_color_shot(scene, posed, t)
        self._place(shot, t)
        return self._color.draw(shot, t)

    def draw_coverage(
        self, posed: PosedModel, camera: Camera, t: int, group: NDArray[np.int64],
        where: NDArray[np.int64],
    ) -> NDArray[np.uint32]:
        """Return bits [H W]: bit g is set where parts of group g would be visible with nothing in
        front of them. `group` [P] is 0..31, or -1 for a part that is left out; a part is drawn in
        its box `where` [P 4] px (as `outlines`) only.
        """
        shot = self._take_truth_shot(posed, camera)
        self._place(shot, t)
        return self._coverage.draw(shot, t, group, where)

    def outlines(self, posed: PosedModel, camera: Camera, t: int = 0) -> NDArray[np.int64]:
        """Return a box [P 4] px that holds each part in frame t: first column and row, and those
        after the last; zeros for parts without a surface.
        """
        part, corners = self._take_truth_shot(posed, camera).boxes(t)
        parts = posed.world_from_part.shape[1]
        low, high = np.full((2, parts, 2), [[[np.inf]], [[-np.inf]]])
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = camera.project(corners)
        behind = uv[..., 2].min(1) <= 0  # then it may be anywhere
        uv[behind] = [[-np.inf, -np.inf, 0.0]] * 4 + [[np.inf, np.inf, 0.0]] * 4
        np.minimum.at(low, part, np.floor(uv[..., :2].min(1)) - 1)
        np.maximum.at(high, part, np.ceil(uv[..., :2].max(1)) + 2)
        out = np.clip(np.concatenate([low, high], axis=1), 0, [self.width, self.height] * 2)
        out[np.isinf(low).all(1) & np.isinf(high).all(1) & (low > high).all(1)] = 0
        return out.astype(np.int64)

    def close(self) -> None:
        """Free everything on the device; images of earlier draws can still be accessed."""
        self._truth.finish()
        self._color.finish()
        self._color.delete_scene()
        self.context.close()

    def _take_truth_shot(self, posed: PosedModel, camera: Camera) -> Shot:
        """The shot of the truth, which is kept while the arguments stay the same."""
        shot, uploaded = self._truth_shot, self._upload(posed, None)
        if shot is None or shot.uploaded is not uploaded or (
                shot.posed is not posed or shot.camera is not camera):
            shot = self._truth_shot = Shot(uploaded, posed, camera, np.zeros((0, 3)))
        return shot

    def _take_color_shot(self, scene: Scene, posed: PosedModel, t: int) -> Shot:
        """The shot of a scene's colours in frame t, likewise."""
        shot, camera = self._color_shot, scene.cameras[t]
        if self._color.scene is not scene:
            self._color.upload(scene)
            shot = None
        uploaded = self._upload(posed, scene.texture_size > 0)
        if shot is None or shot.uploaded is not uploaded or (
                shot.posed is not posed or shot.camera is not camera):
            room = np.concatenate([np.zeros((0, 3)), *(s.vertices for s in scene.room)])
            shot = self._color_shot = Shot(uploaded, posed, camera, room)
        return shot

    def _upload(self, posed: PosedModel, projected: NDArray[np.bool_] | None) -> UploadedModel:
        self._uploaded = upload_model(self.context.gl, posed.model, projected, self._uploaded)
        return self._uploaded

    def _place(self, shot: Shot, t: int) -> None:
        """Put the surfaces that deform where they are in frame t."""
        placed = self._placed
        if placed is None or placed[0] is not shot or placed[1] != t:
            shot.place(self.context.gl, t)
            self._placed = shot, t
