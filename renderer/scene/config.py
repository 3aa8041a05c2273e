"""What to render, as one object: the command line, the function's argument and `dataset.json`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from ...errors import GcbenchError

Range = tuple[float, float]
FACTORS = (
    "motion", "camera", "lights", "materials", "textures", "background", "image", "instance",
)  # fmt: skip
"""Each factor draws from its own random stream, so that two datasets can differ in one only."""
LAYERS = ("normal", "coordinates", "keypoints", "tracks")
"""Truth that is stored on demand."""


@dataclass(frozen=True)
class MotionConfig:
    """Joint motion (angles in degrees here, radians everywhere else)."""

    total: Range = (10.0, 70.0)
    """|displacement| of a scored revolute joint over the sequence, deg."""
    total_prismatic: Range = (0.1, 0.9)
    """|displacement| of a scored prismatic joint, as a share of its range."""
    max_step: float = 6.0
    """Largest motion of a joint between two frames, deg."""
    fps: float = 30.0
    """Frames per second of `times`."""


@dataclass(frozen=True)
class CameraConfig:
    """Camera position on a shell around the robot, looking at it."""

    azimuth: Range = (-180.0, 180.0)
    """deg about the world's z."""
    elevation: Range = (5.0, 50.0)
    """deg above the horizon."""
    fov: Range = (35.0, 55.0)
    """Vertical field of view, deg."""
    fill: Range = (0.5, 0.9)
    """Size of the robot's projected bounding box in the first frame, as a share of the image's
    smaller side; sets the distance."""
    jitter: float = 0.08
    """The look-at point moves by up to this share of the robot's size."""
    roll: Range = (-5.0, 5.0)
    """deg about the optical axis."""


@dataclass(frozen=True)
class LightsConfig:
    """Directional lights and a constant ambient light."""

    number: tuple[int, int] = (1, 3)
    """How many, both ends included."""
    elevation: Range = (20.0, 80.0)
    """deg above the horizon."""
    intensity: Range = (2.0, 5.0)
    """Of all the lights together (pyrender's unit: radiance factor)."""
    warmth: Range = (-0.15, 0.15)
    """Red against blue of each light's colour."""
    ambient: Range = (0.15, 0.4)
    shadows: bool = False
    """Directional shadows (costs about twice the time)."""


@dataclass(frozen=True)
class MaterialsConfig:
    """Changes to the model's own materials; each distinct material has its own draw."""

    probability: float = 1.0
    """Chance that a material is changed."""

    hue: float = 0.03
    """Hue shift of up to this share of the colour circle."""
    value: Range = (0.8, 1.2)
    """Factor on the brightness."""
    roughness: Range = (0.35, 0.9)
    metallic: Range = (0.0, 0.4)


@dataclass(frozen=True)
class TexturesConfig:
    """Textures on the robot's parts; UVs are made by box projection where a mesh has none."""

    probability: float = 0.0
    """Chance that a part carries a drawn texture (`ur5-textured` sets 1)."""
    kinds: tuple[str, ...] = ("noise", "checker", "stripes", "wood")
    """Procedural kinds to draw from."""
    folder: str = ""
    """Draw from the images of this folder instead."""
    size: int = 512
    """Side of a procedural texture, px."""
    scale: Range = (0.15, 0.4)
    """Size of a texture's tile, as a share of the robot's size."""


@dataclass(frozen=True)
class BackgroundConfig:
    """What is behind the robot."""

    room: float = 0.5
    """Share of sequences with a room (textured floor and walls that have depth) instead of an
    image, which has none."""
    kinds: tuple[str, ...] = ("noise", "checker", "stripes", "wood", "clutter")
    """Procedural images to draw from; "plain" is one colour."""
    folder: str = ""
    """Draw images from this folder instead."""
    color: tuple[float, float, float] = (0.85, 0.85, 0.85)
    """sRGB of the kind "plain", 0..1."""
    room_size: Range = (0.2, 1.5)
    """Space between each wall and what must be inside (robot, camera), in units of the robot's
    reach."""


@dataclass(frozen=True)
class ImageConfig:
    """Camera imperfections; off by default. They touch the RGB images only."""

    noise: Range = (0.0, 0.0)
    """Standard deviation of additive Gaussian noise, grey levels of 255."""
    blur: Range = (0.0, 0.0)
    """Standard deviation of a Gaussian blur, px."""
    exposure: Range = (0.0, 0.0)
    """Exposure change, stops."""


@dataclass(frozen=True)
class RandomizationConfig:
    """Ranges of every factor; the default draws all of them, STUDIO only the motion."""

    motion: MotionConfig = field(default_factory=MotionConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    lights: LightsConfig = field(default_factory=LightsConfig)
    materials: MaterialsConfig = field(default_factory=MaterialsConfig)
    textures: TexturesConfig = field(default_factory=TexturesConfig)
    background: BackgroundConfig = field(default_factory=BackgroundConfig)
    image: ImageConfig = field(default_factory=ImageConfig)


STUDIO = RandomizationConfig(
    camera=CameraConfig(
        azimuth=(45.0, 45.0),
        elevation=(25.0, 25.0),
        fov=(45.0, 45.0),
        fill=(0.8, 0.8),
        jitter=0.0,
        roll=(0.0, 0.0),
    ),
    lights=LightsConfig(
        number=(2, 2),
        elevation=(50.0, 50.0),
        intensity=(3.5, 3.5),
        warmth=(0.0, 0.0),
        ambient=(0.3, 0.3),
    ),
    materials=MaterialsConfig(probability=0.0),
    background=BackgroundConfig(room=0.0, kinds=("plain",)),
)
"""`--randomize none`: the model's own materials before a plain grey."""


@dataclass(frozen=True)
class RenderConfig:
    """A dataset: sequence i is a function of this and i alone."""

    robot: str = "ur5"
    """A name of `gcbench robots`, or a path to a .urdf, .glb or .gltf file. `microwave` is another
    one in each sequence, `microwave:17` that one, `partnet:7310` an object of your PartNet-Mobility
    folder."""
    package: tuple[str, ...] = ()
    """NAME=DIR: where `package://NAME/...` of a URDF is; partnet=DIR: your PartNet-Mobility."""
    seed: int = 0
    stream: Literal["test", "train"] = "test"
    """Suites hold sequences of `test` only; a learned method trains on `train`."""
    frames: int = 15
    width: int = 640
    height: int = 480
    animation: str = ""
    """Animation of the model to play; default: its first, if it has any; none: joints move."""
    scored_joints: tuple[str, ...] = ()
    """Joints that move and are scored; default: the bottom three, those of the catalogue, an
    object's doors (three at most), or its first drawer."""
    vary: tuple[str, ...] = FACTORS
    """Factors that change from sequence to sequence; the others keep the draw of sequence 0."""
    keep_unobservable: bool = False
    """Keep sequences whose motion cannot be seen (the rule is in the docs)."""
    allow_missing: bool = False
    """Load a model although meshes are missing; they are listed in the dataset."""
    layers: tuple[str, ...] = ()
    """More truth: normal, coordinates (on the object), keypoints, tracks (of surface points)."""
    track_points: int = 256
    """Number of tracks in a sequence."""
    samples: Literal[1, 4, 9] = 4
    """Colour samples in a pixel of the RGB image (antialiasing)."""
    randomization: RandomizationConfig = field(default_factory=RandomizationConfig)


def resolved(config: RenderConfig) -> RenderConfig:
    """The config with what its robot's catalogue entry adds, checked.

    Raises GcbenchError for a value that cannot be meant.
    """
    from ...robots.catalog import (
        find_robot,
        is_category,
        is_file,
        is_object,
        parse_object_name,
    )

    if is_object(config.robot):
        if not is_category(config.robot):
            parse_object_name(config.robot)
        config = _before_its_front(config)
    elif not is_file(config.robot) and find_robot(config.robot).textured:
        ranges = config.randomization
        if ranges.textures.probability == 0.0:
            textures = replace(ranges.textures, probability=1.0)
            config = replace(config, randomization=replace(ranges, textures=textures))
    if config.seed < 0:
        raise GcbenchError(f"--seed {config.seed}: give 0 or more")
    sizes = (("frames", 1, 100_000), ("width", 16, 16_384), ("height", 16, 16_384),
             ("track_points", 1, 100_000))
    for name, least, most in sizes:
        value = getattr(config, name)
        if not least <= value <= most:
            option = name.replace("_", "-")
            raise GcbenchError(f"--{option} {value}: give {least} to {most}")
    unknown = sorted(set(config.layers) - set(LAYERS))
    if unknown:
        raise GcbenchError(f"--layers {unknown[0]}: there are {', '.join(LAYERS)}")
    config = replace(config, layers=tuple(name for name in LAYERS if name in config.layers))
    unknown = sorted(set(config.vary) - set(FACTORS))
    if unknown:
        raise GcbenchError(f"--vary {unknown[0]}: the factors are {', '.join(FACTORS)}")
    _check_ranges(config.randomization, "")
    return config


FRONT: Range = (110.0, 250.0)
"""deg: azimuths from which one sees the front of an object, which looks along -x as in
PartNet-Mobility. A door seen from behind tells nothing of its motion."""


def _before_its_front(config: RenderConfig) -> RenderConfig:
    """The config of an object with the camera before it, where its azimuth is a default."""
    ranges = config.randomization
    default = {RandomizationConfig().camera.azimuth: FRONT, STUDIO.camera.azimuth: (215.0, 215.0)}
    azimuth = default.get(ranges.camera.azimuth, ranges.camera.azimuth)
    camera = replace(ranges.camera, azimuth=azimuth)
    return replace(config, randomization=replace(ranges, camera=camera))


_BOUNDS: dict[str, tuple[float, float]] = {
    "probability": (0, 1), "room": (0, 1), "hue": (0, 1), "jitter": (0, 10), "max_step": (0, 360),
    "size": (8, 8192), "fps": (1e-6, 1e6), "total": (0, 360), "total_prismatic": (0, 1),
    "azimuth": (-720, 720), "elevation": (-90, 90), "fov": (1, 170), "fill": (0.01, 10),
    "roll": (-360, 360), "number": (1, 8), "intensity": (0, 1e3), "warmth": (-1, 1),
    "ambient": (0, 1e3), "value": (0, 100), "roughness": (0, 1), "metallic": (0, 1),
    "scale": (1e-3, 1e3), "room_size": (0, 1e3), "noise": (0, 255), "blur": (0, 100),
    "exposure": (-20, 20), "color": (0, 1),
}  # fmt: skip


def _check_ranges(values: object, where: str) -> None:
    """Every number within its bounds, every range with its lower end first."""
    for name, value in vars(values).items():
        if hasattr(value, "__dataclass_fields__"):
            _check_ranges(value, f"{where}{name}.")
            continue
        if name not in _BOUNDS or isinstance(value, (bool, str)):
            continue
        low, high = _BOUNDS[name]
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(low <= x <= high for x in numbers):
            raise GcbenchError(f"--{where}{name} {_words(numbers)}: give {low:g} to {high:g}")
        if name != "color" and list(numbers) != sorted(numbers):
            raise GcbenchError(f"--{where}{name} {_words(numbers)}: give the smaller number first")


def _words(numbers: tuple[float, ...]) -> str:
    return " ".join(f"{x:g}" for x in numbers)
