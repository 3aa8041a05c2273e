"""The configuration of a dataset: options of `gcbench render`, and `config` in `dataset.json`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, cast, get_args

from tyro.conf import arg

from ...errors import ConfigError
from ..runtime import convert_fields, field_types

Range = tuple[float, float]
FACTORS = (
    "motion", "camera", "lights", "materials", "textures", "background", "image", "instance",
)
"""Each factor draws from its own random stream, so that two datasets can differ in one only."""
LAYERS = ("normal", "coordinates", "keypoints", "tracks")
"""Optional layers of ground truth."""
AROUND: Range = (-180.0, 180.0)
"""deg: azimuths of the camera all around a robot."""
FRONT: Range = (110.0, 250.0)
"""deg: azimuths from which the front of an object is visible. Objects look along -x, as in
PartNet-Mobility; from behind, the motion of a door is not visible."""
OWN = "own"
"""`twin_of` of a robot that shares its draws with no other."""
_UNUSABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
"""Control characters, and bytes of a file name that are not UTF-8."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of a numeric field, in its annotation: of the number, or of each number of a tuple."""

    low: float
    high: float = math.inf
    ordered: bool = True
    """Whether the numbers of a tuple must ascend."""

    def problem(self, value: object) -> str | None:
        """Return what is wrong with a value: "-1: give 0 or more"; None if nothing is."""
        numbers = cast("tuple[float, ...]", value if isinstance(value, tuple) else (value,))
        given = " ".join(f"{x:g}" if isinstance(x, float) else str(x)[:40] for x in numbers)
        if not all(self.low <= x <= self.high for x in numbers):
            most = "or more" if self.high == math.inf else f"to {self.high:.9g}"
            return f"{given}: give {self.low:.9g} {most}"
        if self.ordered and list(numbers) != sorted(numbers):
            return f"{given}: give the smaller number first"
        return None


@dataclass(frozen=True)
class MotionConfig:
    """Joint motion (angles in degrees here, radians everywhere else)."""

    total: Annotated[Range, Bounds(0, 360)] = (10.0, 70.0)
    """|displacement| of a scored revolute joint over the sequence, deg."""
    total_prismatic: Annotated[Range, Bounds(0, 1)] = (0.1, 0.9)
    """|displacement| of a scored prismatic joint, as a share of its range."""
    max_step: Annotated[float, Bounds(0, 360)] = 6.0
    """Largest motion of a joint between two frames, deg."""
    fps: Annotated[float, Bounds(1e-6, 1e6)] = 30.0
    """Frames per second of `times`."""
    file: str = ""
    """CSV or NPZ of joint positions over time, which every sequence replays from its beginning, in
    place of a random motion."""


@dataclass(frozen=True)
class CameraConfig:
    """Camera position on a shell around the robot, looking at it."""

    azimuth: Annotated[
        Range | None, Bounds(-720, 720), arg(metavar="FLOAT FLOAT", help_behavior_hint="")
    ] = None
    """deg about the world's z; default: all around a robot, -180 180; the front of an object,
    110 250."""
    elevation: Annotated[Range, Bounds(-90, 90)] = (5.0, 50.0)
    """deg above the horizon; 0 where the camera would be below the floor."""
    fov: Annotated[Range, Bounds(1, 170)] = (35.0, 55.0)
    """Vertical field of view, deg."""
    fill: Annotated[Range, Bounds(0.01, 10)] = (0.5, 0.9)
    """Size of the robot's projected bounding box in the first frame, as a share of the image's
    smaller side; sets the distance."""
    jitter: Annotated[float, Bounds(0, 10)] = 0.08
    """The look-at point moves by up to this share of the robot's size."""
    roll: Annotated[Range, Bounds(-360, 360)] = (-5.0, 5.0)
    """deg about the optical axis."""
    shake_turn: Annotated[Range, Bounds(0, 10)] = (0.0, 0.0)
    """A camera held by hand turns at random by so much about each of its axes (root mean square
    over the video), deg."""
    shake_shift: Annotated[Range, Bounds(0, 1)] = (0.0, 0.0)
    """The same for its place: m along each of its axes."""

    def azimuth_or_default(self, of_object: bool = False) -> Range:
        """Return the azimuth, or its default for a robot or an object, deg."""
        return self.azimuth or (FRONT if of_object else AROUND)


@dataclass(frozen=True)
class StudioCameraConfig(CameraConfig):
    """A camera whose default azimuth is one view."""

    def azimuth_or_default(self, of_object: bool = False) -> Range:
        """Return the azimuth, or its default for a robot or an object, deg."""
        return self.azimuth or ((215.0, 215.0) if of_object else (45.0, 45.0))


@dataclass(frozen=True)
class LightsConfig:
    """Directional lights and a constant ambient light."""

    number: Annotated[tuple[int, int], Bounds(1, 8)] = (1, 3)
    """Number of lights, both ends included."""
    elevation: Annotated[Range, Bounds(-90, 90)] = (20.0, 80.0)
    """deg above the horizon."""
    intensity: Annotated[Range, Bounds(0, 1e3)] = (2.0, 5.0)
    """Sum over all lights (radiance factor, as in pyrender)."""
    warmth: Annotated[Range, Bounds(-1, 1)] = (-0.15, 0.15)
    """Color of each light: positive is red, negative is blue."""
    ambient: Annotated[Range, Bounds(0, 1e3)] = (0.15, 0.4)  # Light from all directions.
    shadows: bool = False
    """Shadows of directional lights (about twice the time)."""


@dataclass(frozen=True)
class MaterialsConfig:
    """Changes of the model's own materials; each distinct material is drawn separately."""

    probability: Annotated[float, Bounds(0, 1)] = 1.0
    """Probability that a material is changed."""
    hue: Annotated[float, Bounds(0, 1)] = 0.03
    """Hue shift of up to this share of the color circle."""
    value: Annotated[Range, Bounds(0, 100)] = (0.8, 1.2)
    """Factor on the brightness."""
    roughness: Annotated[Range, Bounds(0, 1)] = (0.35, 0.9)  # 0 mirrors, 1 is matt.
    metallic: Annotated[Range, Bounds(0, 1)] = (0.0, 0.4)  # 1 reflects like metal.


@dataclass(frozen=True)
class TexturesConfig:
    """Textures on the robot's parts; UVs are made by box projection where a mesh has none."""

    probability: Annotated[
        float | None, Bounds(0, 1), arg(metavar="FLOAT", help_behavior_hint="")
    ] = None
    """Probability that a part carries a drawn texture; default: 0, and 1 for `ur5-textured`."""
    kinds: tuple[str, ...] = ("noise", "checker", "stripes", "wood")
    """Procedural kinds to draw from, also clutter."""
    folder: str = ""
    """Draw from the images of this folder instead."""
    size: Annotated[int, Bounds(8, 8192)] = 512
    """Side of a procedural texture, px."""
    scale: Annotated[Range, Bounds(1e-3, 1e3)] = (0.15, 0.4)
    """Size of a texture's tile, as a share of the robot's size."""


@dataclass(frozen=True)
class BackgroundConfig:
    """What the images show behind the robot."""

    room: Annotated[float, Bounds(0, 1)] = 0.5
    """Share of sequences with a room (floor and walls, with depth) instead of an image."""
    kinds: tuple[str, ...] = ("noise", "checker", "stripes", "wood", "clutter")
    """Procedural images to draw from, for rooms too; "plain" is one color."""
    folder: str = ""
    """Draw images from this folder instead."""
    color: Annotated[tuple[float, float, float], Bounds(0, 1, ordered=False)] = (0.85, 0.85, 0.85)
    """sRGB of the kind "plain", 0..1; in a room, surfaces differ from it a little."""
    room_size: Annotated[Range, Bounds(0, 1e3)] = (0.2, 1.5)
    """Distance of each wall from the robot and the camera, in units of the robot's reach."""


@dataclass(frozen=True)
class ImageConfig:
    """Imperfections of the camera, in the RGB images only; off by default."""

    noise: Annotated[Range, Bounds(0, 255)] = (0.0, 0.0)
    """Standard deviation of additive Gaussian noise, grey levels of 255."""
    blur: Annotated[Range, Bounds(0, 100)] = (0.0, 0.0)
    """Standard deviation of a Gaussian blur, px."""
    exposure: Annotated[Range, Bounds(-20, 20)] = (0.0, 0.0)
    """Exposure change, stops."""
    exposure_drift: Annotated[Range, Bounds(-20, 20)] = (0.0, 0.0)
    """Exposure change from the first frame to the last, as of a camera that adapts, stops."""


@dataclass(frozen=True)
class RandomizationConfig:
    """Ranges of every factor; the default draws all of them, STUDIO only the motion and
    the directions of the lights."""

    motion: MotionConfig = field(default_factory=MotionConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    lights: LightsConfig = field(default_factory=LightsConfig)
    materials: MaterialsConfig = field(default_factory=MaterialsConfig)
    textures: TexturesConfig = field(default_factory=TexturesConfig)
    background: BackgroundConfig = field(default_factory=BackgroundConfig)
    image: ImageConfig = field(default_factory=ImageConfig)


STUDIO = RandomizationConfig(
    camera=StudioCameraConfig(
        elevation=(25.0, 25.0), fov=(45.0, 45.0), fill=(0.8, 0.8), jitter=0.0, roll=(0.0, 0.0),
    ),
    lights=LightsConfig(
        number=(2, 2), elevation=(50.0, 50.0), intensity=(3.5, 3.5), warmth=(0.0, 0.0),
        ambient=(0.3, 0.3),
    ),
    materials=MaterialsConfig(probability=0.0),
    background=BackgroundConfig(room=0.0, kinds=("plain",)),
)
"""`--randomize none`: the model's own materials before a plain grey."""


@dataclass(frozen=True)
class RenderConfig:
    """What to render. Sequence i of a dataset depends only on its configuration and on i."""

    robot: str = "ur5"
    """A name of `gcbench robots`, or a path to a .urdf, .glb or .gltf file. `microwave` shows
    another instance in each sequence, `microwave:17` one instance, `partnet:7310` an object of your
    PartNet-Mobility folder, `rd:panda_description` a robot of the package robot_descriptions."""
    package: tuple[str, ...] = ()
    """NAME=DIR: folder of `package://NAME/...` in a URDF; partnet=DIR: your PartNet-Mobility."""
    root: str = ""
    """Folder that a URDF may read meshes from; default: its package, else its own folder."""
    scale: Annotated[float, Bounds(1e-6, 1e6)] = 1.0
    """Factor of all lengths of a URDF or glTF file that is not in metres."""
    seed: Annotated[int, Bounds(0)] = 0
    """Seed of all random draws."""
    twin_of: str = OWN
    """Robot whose random draws this dataset uses; with equal seeds, the two are twins with equal
    motion, camera, lights and background. own: draws of this robot alone (ur5-textured: those of
    ur5). "": the draws that all robots shared in earlier versions, and the default of a
    configuration file without this field."""
    stream: Literal["test", "train"] = "test"
    """Suites contain sequences of `test` only; train a learned method on `train`."""
    frames: Annotated[int, Bounds(1, 100_000)] = 15
    """Number of frames of a sequence."""
    width: Annotated[int, Bounds(16, 16_384)] = 640
    """Width of the images, px."""
    height: Annotated[int, Bounds(16, 16_384)] = 480
    """Height of the images, px."""
    animation: str = ""
    """Animation of the model to play. Default: its first animation. none: move the joints."""
    scored_joints: tuple[str, ...] = ()
    """Joints that move and are scored. Default: those of the catalogue; of an object, up to three
    doors, or its first drawer; of another model, the bottom three."""
    vary: tuple[str, ...] = FACTORS
    """Factors that change from sequence to sequence; the others keep the draw of sequence 0."""
    keep_unobservable: bool = False
    """Keep sequences whose motion cannot be observed (see the docs on observability)."""
    allow_missing: bool = False
    """Load a model although meshes are missing; they are listed in the dataset."""
    layers: tuple[str, ...] = ()
    """Layers to add: normal, coordinates (on the object), keypoints, tracks (of surface points)."""
    track_points: Annotated[int, Bounds(1, 100_000)] = 256
    """Number of tracks in a sequence."""
    flow: Literal["both", "forward", "none"] = "both"
    """Flow images to store. They follow from depth, parts and poses."""
    visibility: bool = True
    """Whether visibility images are stored. They follow from depth, parts and poses."""
    samples: Literal[1, 4, 9] = 4
    """Color samples in a pixel of the RGB image (antialiasing)."""
    randomization: RandomizationConfig = field(default_factory=RandomizationConfig)

    @property
    def omitted_images(self) -> tuple[str, ...]:
        """Images that are not stored: of "flow", "flow_backward" and "visibility"."""
        stored = {"flow": self.flow != "none", "flow_backward": self.flow == "both",
                  "visibility": self.visibility}
        return tuple(name for name, is_stored in stored.items() if not is_stored)


def resolve(config: RenderConfig) -> RenderConfig:
    """Check a config, and return it with the defaults that depend on its robot.

    Raises:
        ConfigError: if a value has another type or is out of range, or a name is unknown.
    """
    from ...robots.catalog import find_robot, is_file, is_object
    from .images import KINDS, PLAIN

    config = convert_fields(config, RenderConfig)
    own = draws_of(config.robot)
    of_object = is_object(config.robot)
    textured = not of_object and not is_file(config.robot) and find_robot(config.robot).textured
    for name, problem in find_invalid_values(config):
        option = name.removeprefix("randomization.").replace("_", "-")
        raise ConfigError(f"--{option} {problem}")
    ranges, textures = config.randomization, config.randomization.textures
    lists = {"layers": (config.layers, LAYERS), "vary": (config.vary, FACTORS),
             "textures.kinds": (textures.kinds, (*KINDS,)),
             "background.kinds": (ranges.background.kinds, (*KINDS, PLAIN))}
    for option, (names, known) in lists.items():
        if unknown := sorted(set(names) - set(known)):
            raise ConfigError(f"--{option} {unknown[0]}: there are {', '.join(known)}")
    azimuth = ranges.camera.azimuth_or_default(of_object)
    if textures.probability is None:
        textures = replace(textures, probability=1.0 if textured else 0.0)
    camera = replace(CameraConfig(**vars(ranges.camera)), azimuth=azimuth)
    return replace(
        config,
        twin_of=own if config.twin_of == OWN else config.twin_of and draws_of(config.twin_of),
        layers=tuple(name for name in LAYERS if name in config.layers),
        randomization=replace(ranges, camera=camera, textures=textures),
    )


def draws_of(robot: str) -> str:
    """Return the name of a robot's own draws: of a file, its name without folders.

    Raises ModelError if there is no such robot; a file need not exist.
    """
    from ...robots.catalog import find_robot, is_category, is_file, is_object, parse_object_name

    if is_file(robot):
        return Path(robot).name
    if is_object(robot):
        if not is_category(robot):
            parse_object_name(robot)
        return robot
    entry = find_robot(robot)
    return entry.name.removesuffix("-textured") if entry.textured else entry.name


def find_invalid_values(config: object, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield (field, what is wrong) for each number outside its `Bounds`, and each unusable text."""
    for name, hint in field_types(type(config)).items():
        value = getattr(config, name)
        if is_dataclass(value):
            yield from find_invalid_values(value, f"{prefix}{name}.")
        if name == "kinds" and not value:
            yield f"{prefix}{name}", "is empty: name a kind"
        for bounds in get_args(hint)[1:] if value is not None else ():
            if isinstance(bounds, Bounds) and (problem := bounds.problem(value)):
                yield f"{prefix}{name}", problem
        for text in cast("tuple[object, ...]", value) if isinstance(value, tuple) else (value,):
            if isinstance(text, str) and _UNUSABLE.search(text):
                yield f"{prefix}{name}", f"{text[:40]!a}: leave out control characters"
