"""From a configuration and a seed to the plain data that decides every pixel."""

from __future__ import annotations

from .box_mapping import split_by_axis
from .clip_space import box_corners, clip_from_light, clip_from_world
from .config import (
    LAYERS,
    STUDIO,
    CameraConfig,
    ImageConfig,
    LightsConfig,
    MotionConfig,
    RandomizationConfig,
    RenderConfig,
    TexturesConfig,
    draws_of,
    resolve,
)
from .config_files import config_tree, differences, parse_config, read_config
from .models import check_model_paths, dataset_asset, model_of, model_source, packages_of, robot_of
from .motion import Motion, MotionSampler, animation_times
from .posed_model import PosedModel, pose_parts, rest, rest_in_part
from .room import RoomSurface
from .sampling import Streams, draw_camera, draw_scene, shake_camera
from .scene import Scene

__all__ = [
    "LAYERS", "STUDIO", "CameraConfig", "ImageConfig", "LightsConfig", "Motion", "MotionConfig",
    "MotionSampler", "PosedModel", "RandomizationConfig", "RenderConfig", "RoomSurface", "Scene",
    "Streams", "TexturesConfig", "animation_times", "box_corners", "check_model_paths",
    "clip_from_light", "clip_from_world", "config_tree", "dataset_asset", "differences",
    "draw_camera", "draw_scene", "draws_of", "model_of", "model_source", "packages_of",
    "parse_config", "pose_parts", "read_config", "resolve", "rest", "rest_in_part", "robot_of",
    "shake_camera", "split_by_axis",
]
