"""The commands `gcbench estimate`, `train` and `craves-images`."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

JointType = Literal["revolute", "prismatic"]


def estimate(
    video: Path, /, fov: float | None = None, axes: tuple[float, ...] = (),
    types: tuple[JointType, ...] = (), distance: float | None = None,
    base: Annotated[tuple[float, float] | None, "U V"] = None, frames: int = 32,
    start: float = 0.0, end: float = math.inf,
    region: Annotated[tuple[int, int, int, int] | None, "U V WIDTH HEIGHT"] = None,
    still: bool = False, foreground: str = "", out: Path | None = None,
    picture: Path | None = None, no_picture: bool = False, quiet: bool = False,
    json: bool = False,
) -> tuple[object, int]:
    """Estimate how the joints in your own video move, by GC-Pose.

    The camera must stand still or nearly so: if it is held by hand, the frames are aligned with the
    first. The straight edges of a door or a drawer show the field of view and the direction of its
    axis. If they do not, the command says which option to give. Joints without straight edges need
    --fov and --axes. An axis is given at the first frame, in the camera's frame: x points to the
    right, y down, z forward. A joint turns about it by the right-hand rule, or slides along it.
    Plain video has no scale, so a joint that slides needs its distance from the camera.

    Writes a table (CSV): the displacement of each joint since the first frame, deg or m, and its
    standard deviation, which leaves out the error of a field of view that was found. Also writes a
    picture (PNG): look at it, because only it shows whether a person was taken for the object.
    "Not reliable" means: do not use this number.

    Examples:
      gcbench estimate door.mp4
      gcbench estimate door.mp4 --fov 42
      gcbench estimate lever.mp4 --fov 42 --axes 0 -0.94 -0.34
      gcbench estimate drawer.mp4 --types prismatic --distance 1.4
      gcbench estimate door.mp4 --region 600 200 900 700
      gcbench estimate arm.mp4 --fov 50 --axes 0 -1 0 1 0 0 1 0 0 --base 320 410 --start 2 --end 4

    Args:
        video: MP4, MOV, MKV, WebM or AVI.
        fov: Vertical field of view of the camera, deg. Default: found from straight edges.
        axes: Direction of each joint's axis, three numbers each, from the base outward. Default:
            one joint, with the axis that the edges of a door show; that of a drawer is also shown
            by its motion.
        types: Of each joint, from the base outward: it turns (`revolute`) or slides (`prismatic`).
            Default: all turn.
        distance: How far what moves is from the camera at the first frame, along the line of sight
            of the middle of the image, m. For joints that slide.
        base: Pixel (u, v) where the base of an arm stands.
        frames: Largest number of frames to use, evenly spaced. Fast turns need many.
        start: Time of the first frame, s.
        end: Time of the last frame, s.
        region: Part of the images to use, px: the pixel (u, v) of its upper left corner, its width
            and its height. Leave out what else moves, but keep still background around the object.
            Field of view and base refer to the whole images. Default: all but black bars.
        still: The camera stands still: do not look for its motion. A door that fills most of the
            images looks as if the camera moved.
        foreground: What finds the moving pixels: `no-people` leaves people out who move the object;
            `network` and `background` take all that moves for the object.
            Default: `no-people` for one joint, `network` for several.
        out: CSV to write. Default: the name of the video, in the current folder.
        picture: PNG to write: some frames with the estimated parts in color. Default: the name of
            the table, with .png.
        no_picture: Write no picture.
        quiet: Show no progress: print the result and errors only.
        json: Print the result as one JSON document.
    """
    from ..renderer.runtime import say
    from . import video as files
    from .images import ImageSettings, find_camera_motion
    from .method import GCPose
    from .settings import Settings

    files.check_joints(axes, types, fov, distance)
    out, picture = files.name_outputs(video, out, picture, no_picture=no_picture)
    one_joint = len(axes) <= 3
    images = ImageSettings(still_share=0.0) if still else ImageSettings()
    method = GCPose(foreground=foreground or ("no-people" if one_joint else "network"),
                    settings=Settings(images=images))
    search = fov is None
    seen = files.read_frames(video, frames, start, end, region)
    # wrong values end it here
    files.observe_video(seen, 1.0 if fov is None else fov, axes, types, base)
    if not quiet:
        say(f"{video}: {len(seen.rgb)} frames; the estimate takes about a minute, of an arm more"
            + ", and the search for the field of view another" * search)
    if fov is None:
        fov = files.find_field_of_view(method, seen, types)
    observation = files.observe_video(seen, fov, axes, types, base)
    if not quiet and (
            motion := find_camera_motion(seen.rgb, observation.intrinsics, images)):
        say(f"{video}: the camera moves, by up to {motion.shift:.0f} px. Its motion is taken out, "
            f"to within {motion.error:.1f} px; a camera on a stand gives smaller errors")
    axis = files.find_axes(method, observation, fov_found=search)
    found = method.estimate(observation, distance)
    files.check_motion(found)
    if axis is None:
        found, axis = files.towards_camera(found)
    found, share = files.doubt_still_texture(seen, found, images)
    reasons = files.explain_doubts(method, observation, found, share)
    joints = files.summarize_estimate(seen, found, axis, observation.joint_types, reasons)
    files.write_table(out, seen, found, observation.joint_types)
    if picture:
        files.draw_parts(picture, seen, found)
        if not quiet:
            say(f"{video}: look at {picture}. All that has color was taken for the object: if a "
                "person or a shadow has color, do not use the numbers")
    if json:
        return {"table": out, "fov": fov, "joints": joints}, 0
    lines = files.describe_joints(joints)
    if search or not axes:
        shown = " ".join(f"{x:g}" for j in joints for x in j["axis"])
        lines.insert(0, f"by the video: --fov {fov:.1f} --axes {shown}")
    return "\n".join([str(out), *lines]), 0


def train_flow(args: Sequence[str]) -> tuple[object, int]:
    """Train the optical flow network of GC-Pose."""
    return _train("flow", args)


def train_foreground(args: Sequence[str]) -> tuple[object, int]:
    """Train the network of GC-Pose that finds what moves in a plain video."""
    return _train("foreground", args)


def train_people(args: Sequence[str]) -> tuple[object, int]:
    """Train the network of GC-Pose that finds people in a plain video."""
    return _train("people", args)


def train_screwnet(args: Sequence[str]) -> tuple[object, int]:
    """Train ScrewNet, a baseline: one joint from depth video."""
    return _train("screwnet", args)


def train_abbatematteo(args: Sequence[str]) -> tuple[object, int]:
    """Train Abbatematteo et al., a baseline: one joint from a depth image."""
    return _train("abbatematteo", args)


def train_dustnet(args: Sequence[str]) -> tuple[object, int]:
    """Train DUST-net, a baseline: a distribution of one joint's motion from depth video."""
    return _train("dustnet", args)


def train_craves(args: Sequence[str]) -> tuple[object, int]:
    """Train CRAVES, a baseline: keypoints of the OWI-535 in an image."""
    return _train("craves", args)


def craves_images(
    path: Path, /, weights: str, device: str = "auto", limit: int = 0
) -> tuple[object, int]:
    """Score CRAVES on single images: of its Lab data, or of a dataset of the OWI-535.

    The errors are those of absolute angles, in all images and in the better half of them, which is
    what CRAVES publishes.

    Examples:
      gcbench craves-images ~/craves/test_20181024 --weights craves/craves.safetensors
      gcbench craves-images data/owi535 --weights craves/craves.safetensors --limit 100

    Args:
        path: Folder of the Lab data (angles/, joint/, FusionCameraActor3_2/), or of a dataset.
        weights: File of `gcbench train craves`.
        device: `cpu`, `cuda`, ...; `auto`: a GPU if there is one.
        limit: Score the first images only; 0: all.
    """
    from .learned.craves_images import score_images

    return score_images(path, weights, device, limit).table(), 0


def _train(name: str, args: Sequence[str]) -> tuple[object, int]:
    from ..renderer.runtime import command_line, interrupt_on_sigterm
    from .training.config import CONFIGS

    config = CONFIGS[name]
    options = command_line.parse_options(args, f"train {name}", config, config.__doc__)
    from .training.tasks import run_training

    with interrupt_on_sigterm():
        return run_training(options), 0
