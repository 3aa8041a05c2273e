"""Checks of the optional images against depth, parts and poses: normals and coordinates."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import VISIBLE, Sequence
from .checks import CheckResult, check, check_share, merge_checks
from .frames import FLAT, METRES, PixelBlock, VerifiedFrame, decode_frame, deforming_numbers

_UNIT = 1e-4  # of a normal's length; its code alone is good for 3e-5
_ANGLE = 0.06  # rad between a normal and the plane through the depths around it
_FINE = 0.1  # share of pixels at which facets finer than that plane may differ by more
_SMOOTH = 0.02  # of a normal's length, between neighbors on a surface without facets
_TURN = 1e-3  # of a normal's length, where neighbors are equal
_ASTRAY = 0.01  # share of pixels whose normal may turn otherwise; in renders it was 0.0006 at most
_FOLDS = 0.03  # share of pixels at which a surface folds between the pixels
_SIDE = 5  # px of the window of that plane


def verify_layers(sequence: Sequence) -> list[CheckResult]:
    """All checks of the layers `normal` and `coordinates`; none if the sequence has neither."""
    checks: list[CheckResult] = []
    if sequence.normal is None and sequence.coordinates is None:
        return checks
    size = (sequence.meta.height, sequence.meta.width)
    before: dict[str, tuple[VerifiedFrame, Array]] = {}
    rays = _rays(sequence)
    for t in range(sequence.meta.frames):
        frame = decode_frame(sequence, t)
        for name, stack in (("normal", sequence.normal), ("coordinates", sequence.coordinates)):
            if stack is None:
                continue
            image = np.asarray(stack[t], np.float64)
            checks.append(check("image shapes", image.shape != (*size, 3), 0, "frames",
                                f"frame {t} {name}"))
            if not checks[-1].ok:
                return list(merge_checks(checks))
            flat = image.reshape(-1, 3)
            examine = _normals if name == "normal" else _coordinates
            checks += examine(frame, flat, rays)
            if name in before and sequence.flow is not None and sequence.visibility is not None:
                compare = _check_turned if name == "normal" else _check_kept
                checks += compare(*before[name], frame, flat)
            before[name] = frame, flat
    return list(merge_checks(checks))


def _rays(sequence: Sequence) -> Array:
    """[N 3] through the centers of all pixels, z = 1."""
    meta = sequence.meta
    v, u = np.divmod(np.arange(meta.height * meta.width), meta.width)
    pixels = np.stack([u, v, np.ones_like(u)], axis=1).astype(np.float64)
    return pixels @ np.linalg.inv(sequence.state.intrinsics).T


def _check_known(
    name: str, image: Array, wanted: NDArray[np.bool_], frame: VerifiedFrame
) -> tuple[CheckResult, NDArray[np.intp]]:
    """The check that an image [N 3] is known where it is wanted [N]; and where it is."""
    finite = np.isfinite(image).sum(axis=1)
    wrong = np.where(wanted, finite != 3, finite != 0)
    checked = check_share(f"{name}: known where it should be", wrong, 1e-5, frame.name)
    return checked, np.flatnonzero(finite == 3)


def _normals(frame: VerifiedFrame, normal: Array, rays: Array) -> list[CheckResult]:
    """Unit vectors towards the camera, at right angles to the plane that the depth makes."""
    known, pixel = _check_known("normal", normal, frame.depth > 0, frame)
    length = np.linalg.norm(normal[pixel], axis=1)
    away = np.einsum("ni,ni->n", normal[pixel], rays[pixel]) / np.linalg.norm(rays[pixel], axis=1)
    checks = [
        known,
        check("normal: unit", length - 1, _UNIT, "", lambda i: frame.name(int(pixel[i]))),
        check("normal: towards the camera", np.maximum(away, 0), _UNIT, "",
              lambda i: frame.name(int(pixel[i]))),
    ]
    plane, flat, uncertain = _planes(frame)
    flat &= np.isfinite(normal).all(axis=1)
    usable = np.flatnonzero(flat)
    cosine = np.einsum("ni,ni->n", plane[usable], normal[usable]) / np.linalg.norm(
        normal[usable], axis=1)
    off = np.arccos(np.clip(cosine, -1, 1)) > _ANGLE + uncertain[usable]
    # Of the whole image, a room would hide what is wrong on the parts before it.
    on_part = frame.part[usable] > 0
    parts = usable[on_part]
    return [*checks,
            check_share("normal: of the plane that depth makes", off, _FINE,
                        lambda i: frame.name(int(usable[i]))),
            check_share("normal: of the plane that depth makes on parts", off[on_part], _FINE,
                        lambda i: frame.name(int(parts[i])), spare_chance=True)]


def _planes(frame: VerifiedFrame) -> tuple[Array, NDArray[np.bool_], Array]:
    """Unit normals [N 3] of planes through the depths of 5x5 pixels, where [N] these are of one
    part and flat within the rounding, and the angle [N] rad that the rounding may turn them.

    The inverse depth of a plane is linear in the pixel: n K^-1 (u, v, 1) = d / z.
    """
    meta, k = frame.sequence.meta, frame.sequence.state.intrinsics
    shape, half = (meta.height, meta.width), _SIDE // 2
    depth = frame.depth.reshape(shape)
    w = 1.0 / np.where(depth > 0, depth, np.inf)
    ramp = np.arange(-half, half + 1, dtype=np.float64)
    ones, squares = np.ones(_SIDE), _SIDE * float(ramp @ ramp)

    def fit(x: Array, y: Array, by: float) -> Array:
        found = cv2.sepFilter2D(w, cv2.CV_64F, x, y, borderType=cv2.BORDER_REFLECT)
        return np.asarray(found, np.float64) / by

    a, b = fit(ramp, ones, squares), fit(ones, ramp, squares)
    c = fit(ones, ones, _SIDE**2)
    part = np.ascontiguousarray(frame.part.reshape(shape), np.float64)
    window = np.ones((_SIDE, _SIDE), np.uint8)
    alone = cv2.erode(part, window) == cv2.dilate(part, window)
    alone &= cv2.erode(depth, window) > 0
    alone[:half] = alone[-half:] = False
    alone[:, :half] = alone[:, -half:] = False
    worst = np.zeros(shape)
    for dv in range(-half, half + 1):
        for du in range(-half, half + 1):
            there = np.roll(w, (-dv, -du), (0, 1))
            worst = np.maximum(worst, np.abs(there - (a * du + b * dv + c)))
    rounding = meta.depth_unit * w**2  # of the inverse depth, one whole unit
    flat = alone & (worst <= rounding)
    v, u = np.indices(shape)
    plane = np.stack([a, b, c - a * u - b * v], axis=-1).reshape(-1, 3) @ k
    length = np.linalg.norm(plane, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Slopes err by 0.3 units over the root of the sum of squares; four times that is allowed.
        slope = 1.2 * rounding.ravel() / np.sqrt(squares) * max(k[0, 0], k[1, 1])
        return -plane / length[:, None], flat.ravel(), slope / length


def _coordinates(frame: VerifiedFrame, local: Array, rays: Array) -> list[CheckResult]:
    """Of rigid parts, coordinates in the part's pose are the points that depth gives."""
    sequence, t = frame.sequence, frame.t
    known, pixel = _check_known("coordinates", local, frame.part > 0, frame)
    rigid = ~np.isin(frame.part[pixel], [0, *deforming_numbers(sequence)])
    pixel = pixel[rigid]
    s, part = sequence.state, frame.part[pixel] - 1
    assert s.coordinate_box is not None
    pose = (s.cam_from_world[t] @ s.world_from_part[t])[part]
    expected = np.einsum("nij,nj->ni", pose[:, :3, :3], local[pixel]) + pose[:, :3, 3]
    rays, z = rays[pixel], frame.depth[pixel]
    error = np.linalg.norm(expected - rays * z[:, None], axis=1)
    size = np.linalg.norm(s.coordinate_box[:, 1] - s.coordinate_box[:, 0], axis=1)
    rounded = sequence.meta.depth_unit / 2 * np.linalg.norm(rays, axis=1)
    rounded += size[part] / 65534 / 2 + 1e-6 * z
    return [known, check("coordinates: of the point that depth tells",
                         np.maximum(0, error - rounded), METRES, "m",
                         lambda i: frame.name(int(pixel[i])))]


def _check_kept(frame: VerifiedFrame, local: Array, there: VerifiedFrame, local_there: Array
          ) -> list[CheckResult]:
    """A point keeps its coordinates [N 3] where the forward flow of its frame leads."""
    pixel, around = _follow_flow(frame, there)
    found = local_there[around.index]
    mean = np.einsum("bm,bmi->mi", around.weight, found)
    error = np.linalg.norm(mean - local[pixel], axis=1)
    # Less than a pixel's step on the surface: where it folds within the four pixels, they differ.
    astray = (error > 0.75 * _spread(found, mean) + 1e-4 * np.linalg.norm(mean, axis=1)
              + frame.sequence.meta.depth_unit)
    return [check_share("coordinates: kept where the flow leads", astray, _FOLDS,
                        lambda i: frame.name(int(pixel[i])))]


def _check_turned(frame: VerifiedFrame, normal: Array, there: VerifiedFrame, normal_there: Array
                  ) -> list[CheckResult]:
    """A normal [N 3] turns with its rigid part, where the surface is smooth in both frames."""
    (pixel, around), s, t = _follow_flow(frame, there), frame.sequence.state, frame.t
    part, found = frame.part[pixel], normal_there[around.index]
    mean = np.einsum("bm,bmi->mi", around.weight, found)
    spread = _spread(found, mean)
    smooth = ~np.isin(part, deforming_numbers(frame.sequence)) & (spread < _SMOOTH)
    for side in (-0.5, 0.5):  # the pixels above and to the left, and those below and to the right
        beside = frame.around(frame.positions(pixel) + side, part)
        bend = _spread(normal[beside.index], normal[pixel])
        smooth &= beside.same.all(axis=0) & (bend < _SMOOTH)
        spread += bend
    before, after = (s.cam_from_world[k, :3, :3] @ s.world_from_part[k, :, :3, :3]
                     for k in (t, t + 1))
    turn = (after @ np.linalg.inv(before))[part - 1]
    error = np.linalg.norm(mean - np.einsum("mij,mj->mi", turn, normal[pixel]), axis=1)
    astray, places = (error > spread + _TURN)[smooth], pixel[smooth]
    return [check_share("normal: kept where the flow leads", astray, _ASTRAY,
                        lambda i: frame.name(int(places[i])), spare_chance=True)]


def _follow_flow(frame: VerifiedFrame, there: VerifiedFrame) -> tuple[NDArray[np.intp], PixelBlock]:
    """The pixels [M] of parts that are seen where the forward flow leads, and the pixels there, all
    of the part and without an edge."""
    sequence, t = frame.sequence, frame.t
    assert sequence.flow is not None and sequence.visibility is not None
    flow = sequence.flow[t].reshape(-1, 2).astype(np.float64)
    seen = sequence.visibility[t].ravel() == VISIBLE
    pixel = np.flatnonzero(seen & np.isfinite(flow).all(axis=1) & (frame.part > 0))
    target, part = frame.positions(pixel) + flow[pixel].T, frame.part[pixel]
    around = there.around(target, part)
    whole = around.same.all(axis=0) & (around.far - around.near < FLAT * around.near)
    return pixel[whole], there.around(target[:, whole], part[whole])


def _spread(around: Array, middle: Array) -> Array:
    """[M] the largest distance of vectors [4 M 3] from a middle [M 3]."""
    return np.asarray(np.linalg.norm(around - middle, axis=-1).max(axis=0), np.float64)
