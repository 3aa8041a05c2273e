"""Networks of transformers for depth from one image; transformers is not a dependency of gcbench.

Weights are read from safetensors files only, and no code of a model is executed.
"""

# pyright: basic
from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, MethodError
from .torch_runtime import find_device, torch
from .torchvision_raft import import_torchvision

_METRIC = ("glpn", "tipsv2_dpt", "zoedepth")  # model types that return metres
_MAX_TEXT = 2**24  # bytes of a configuration or a model card
_HUB_NAME = re.compile(r"[\w.-]+/[\w.-]+")


def load_transformers_depth(
    model: str, scale: str = "", device: str = "auto"
) -> tuple[Callable[[NDArray[np.uint8]], NDArray[np.float32]], str]:
    """Load a model for the task depth-estimation from a folder or from the Hugging Face hub.

    Args:
        model: The folder that `save_pretrained` wrote, or OWNER/NAME on the hub.
        scale: "metric" if the network returns depth in m, "relative" if it returns inverse depth
            up to an unknown factor and offset. Default: as its configuration says.
        device: See `find_device`.

    Returns:
        Depth [H W] of an image [H W 3]: z in m, or the inverse of a relative network's output, up
        to scale (its offset is taken to be zero); 0 where there is none. And what the model card
        says of training data and licence.

    Raises:
        ConfigError: If there is no such model, it is for another task, its weights are incomplete
            or no safetensors, or the kind of its depth is unknown or not as `scale` says.
        MethodError: If transformers is missing.
    """
    transformers = _import_transformers()
    folder = Path(model).expanduser()
    local = folder.is_dir()
    if not local and not _HUB_NAME.fullmatch(model):
        raise ConfigError(f"{model}: there is no such folder; a model of the Hugging Face hub is "
                          "hf:OWNER/NAME")
    if local:
        _check_files(folder)
    source = str(folder) if local else model
    options = {"trust_remote_code": False, "local_files_only": local}
    config = _load(transformers.AutoConfig, source, **options)
    _check_task(config, source)
    relative = _check_scale(config, source, scale) == "relative"
    network = _load_network(transformers, source, config, options)
    processor = _load(transformers.AutoImageProcessor, source, **options)
    if not hasattr(processor, "post_process_depth_estimation"):
        raise ConfigError(f"{source}: its image processor {type(processor).__name__} is not one "
                          "for depth; use the preprocessor_config.json of the model's authors")
    network.to(find_device(device), torch.float32).eval()
    return partial(_predict, network, processor, relative), _describe_card(source, config)


def _import_transformers() -> Any:
    try:
        with suppress(MethodError):
            import_torchvision()  # which transformers imports where it is installed
        return import_module("transformers")
    except ImportError as error:
        raise MethodError(
            "--depth hf:MODEL needs transformers: pip install transformers") from error


def _check_files(folder: Path) -> None:
    for file in folder.iterdir():
        if not (file.is_file() or file.is_dir()):
            raise ConfigError(f"{file}: not a regular file")
        if file.suffix in (".json", ".md") and file.stat().st_size > _MAX_TEXT:
            raise ConfigError(f"{file}: larger than {_MAX_TEXT >> 20} MiB")


def _load(factory: Any, source: str, **options: Any) -> Any:
    """Call `from_pretrained`, with its many lines of failure as one."""
    try:
        return factory.from_pretrained(source, **options)
    except Exception as error:  # of transformers, the hub, safetensors or the configuration
        reason = " ".join((str(error) or type(error).__name__).split())[:300]
        raise ConfigError(f"{source}: transformers cannot load it ({reason})") from error


def _load_network(transformers: Any, source: str, config: Any, options: dict[str, bool]) -> Any:
    network, found = _load(
        transformers.AutoModelForDepthEstimation, source, config=config, use_safetensors=True,
        ignore_mismatched_sizes=True, output_loading_info=True, **options)
    misfits = [*found["missing_keys"], *(key for key, *_ in found["mismatched_keys"])]
    if misfits:
        raise ConfigError(f"{source}: these are not the weights of a {config.model_type} for "
                          f"depth: {min(misfits)} is missing or has another shape")
    return network


def _check_task(config: Any, source: str) -> None:
    models = import_module("transformers.models.auto.modeling_auto")
    types = models.MODEL_FOR_DEPTH_ESTIMATION_MAPPING_NAMES
    if config.model_type not in types:
        raise ConfigError(f"{source}: {config.model_type} estimates no depth; there are "
                          f"{', '.join(types)}")


def _check_scale(config: Any, source: str, scale: str) -> str:
    """Return "metric" or "relative"."""
    said = getattr(config, "depth_estimation_type", "")
    if config.model_type in _METRIC or getattr(config, "use_fov_model", False):
        said = "metric"
    if scale and said not in (scale, ""):
        raise ConfigError(f"{source}: its configuration says {said} depth, not {scale}")
    if scale:
        return scale
    if said == "metric":
        return said
    if said == "relative":
        raise ConfigError(
            f"{source}: returns inverse depth up to a factor and an offset; use a metric model, or "
            f"hf-relative:{source} to take the offset for zero")
    raise ConfigError(
        f"{source}: its configuration does not say what {config.model_type} returns; use "
        f"hf-metric:{source} for depth in m, or hf-relative:{source} for inverse depth")


def _predict(
    network: Any, processor: Any, relative: bool, rgb: NDArray[np.uint8]
) -> NDArray[np.float32]:
    """Return what the pipeline depth-estimation predicts, or its inverse."""
    size = rgb.shape[:2]
    inputs = processor(images=np.ascontiguousarray(rgb), input_data_format="channels_last",
                       return_tensors="pt")
    with torch.inference_mode():
        output = network(**inputs.to(network.device))
    (sized,) = processor.post_process_depth_estimation(output, [size])
    out = sized["predicted_depth"].float().cpu().numpy().reshape(size)
    known = np.isfinite(out) & (out > 0)
    inverse = np.divide(1, out, out=np.zeros_like(out), where=known)
    return inverse if relative else np.where(known, out, np.float32(0))


def _describe_card(source: str, config: Any) -> str:
    """Return training data and licence of the model card in the folder or on the hub."""
    hub = import_module("huggingface_hub")
    card: Any = None
    with suppress(Exception):  # no card, no network, or no valid head of the card
        path = Path(source, "README.md")
        card = hub.ModelCard.load(path if Path(source).is_dir() else source).data
    data, licence = getattr(card, "datasets", None), getattr(card, "license", None)
    known = ", ".join(map(str, data)) if isinstance(data, list) else "data not stated"
    revision = getattr(config, "_commit_hash", None)
    at = f" revision {revision[:8]}" if revision else ""
    text = f"{known} ({Path(source).name}{at}; licence {licence or 'not stated'})"
    return "".join(c for c in text if c.isprintable() and c != "@")[:190]
