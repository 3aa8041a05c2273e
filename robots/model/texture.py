"""Images of untrusted models, and the step from stored colours to linear ones."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ModelError
from ..geometry import Array

if TYPE_CHECKING:
    from PIL import Image

_MAX_SIDE = 4096
_MAX_PIXELS = 16384 * 8192
_FORMATS = ("PNG", "JPEG", "BMP", "TGA", "TIFF", "GIF", "WEBP")


def decode_texture(data: bytes, name: str) -> NDArray[np.uint8]:
    """Return the image [h w 3|4] sRGB of a file, row 0 on top, at most 4096 px on a side."""
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the size is checked below, before any pixel is decoded
        try:
            return texture_from_image(Image.open(io.BytesIO(data), formats=_FORMATS), name)
        except ModelError:
            raise
        except Exception as error:
            raise ModelError(f"{name}: is not an image that can be read ({error})") from error


def texture_from_image(image: Image.Image | Any, name: str) -> NDArray[np.uint8]:
    """Return the array [h w 3|4] of a PIL image, which may still be undecoded."""
    width, height = image.size
    if width * height > _MAX_PIXELS or width * height == 0:
        raise ModelError(f"{name}: image of {width} x {height} pixels; at most {_MAX_PIXELS}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if image.mode.startswith("I;16"):  # which Pillow clips instead of scaling
                from PIL import Image

                image = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
            if max(width, height) > _MAX_SIDE:
                image.thumbnail((_MAX_SIDE, _MAX_SIDE))
            transparent = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
            pixels = np.asarray(image.convert("RGBA" if transparent else "RGB"), np.uint8)
        except Exception as error:
            raise ModelError(f"{name}: is not an image that can be read ({error})") from error
    if transparent and pixels[..., 3].min() == 255:
        pixels = pixels[..., :3]
    return np.ascontiguousarray(pixels)


def linear_from_srgb(color: ArrayLike) -> Array:
    """Linear values of sRGB ones, both in 0..1 (clipped)."""
    c = np.clip(np.asarray(color, np.float64), 0.0, 1.0)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def base_color(rgba: ArrayLike) -> tuple[float, float, float, float]:
    """Return the linear RGBA of an sRGB colour of 3 or 4 values in 0..1; alpha stays as it is."""
    c = np.asarray(rgba, np.float64).reshape(-1)
    r, g, b = linear_from_srgb(c[:3]).tolist()
    return r, g, b, float(np.clip(c[3], 0.0, 1.0)) if len(c) > 3 else 1.0


def mean_color(texture: NDArray[np.uint8]) -> tuple[float, float, float, float]:
    """Return the linear mean RGBA of a texture [h w 3|4]; alpha is 1."""
    pixels = texture[:: max(1, texture.shape[0] // 256), :: max(1, texture.shape[1] // 256), :3]
    r, g, b = linear_from_srgb(pixels.reshape(-1, 3) / 255.0).mean(axis=0).tolist()
    return r, g, b, 1.0
