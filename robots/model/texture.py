"""Images of untrusted models, and the step from stored colours to linear ones."""

from __future__ import annotations

import hashlib
import io
import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ModelError
from ..geometry import Array

MAX_TEXTURE_BYTES = 2**29
"""Limit on the decoded textures of a model, together. OpenGL takes 1.8 times as much again."""
_MAX_SIDE = 4096
_MAX_PIXELS = 16384 * 8192
_FORMATS = ("PNG", "JPEG", "BMP", "TGA", "TIFF", "GIF", "WEBP")


class TextureDecoder:
    """Decoder of the images of one model; equal files share one array.

    The decoded arrays together are bounded; an image's size is checked before its pixels are
    decoded.
    """

    def __init__(self, limit: int = MAX_TEXTURE_BYTES) -> None:
        self._limit = self._left = limit
        self._pictures: dict[bytes, NDArray[np.uint8]] = {}

    def decode(self, data: bytes, name: str) -> NDArray[np.uint8]:
        """Return the image [h w 3|4] sRGB of a file, row 0 on top, at most 4096 px on a side.

        Raises:
            ModelError: If `data` is no image, or a too large one; `name` begins the message.
        """
        key = hashlib.sha256(data).digest()
        if key not in self._pictures:
            self._pictures[key] = self.count(self._decode(data, name), name)
        return self._pictures[key]

    def count(self, picture: NDArray[np.uint8], name: str) -> NDArray[np.uint8]:
        """Return a new picture after counting its bytes; raise ModelError if they are too many."""
        self._check(picture.nbytes, name)
        self._left -= picture.nbytes
        return picture

    def _check(self, count: int, name: str) -> None:
        if count > self._left:
            raise ModelError(f"{name}: the model's textures exceed {self._limit} bytes when "
                             "decoded; make them smaller")

    def _decode(self, data: bytes, name: str) -> NDArray[np.uint8]:
        from PIL import Image, UnidentifiedImageError

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the size is checked before any pixel is decoded
            try:
                image = Image.open(io.BytesIO(data), formats=_FORMATS)
                width, height = image.size
                transparent = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
                if width * height > _MAX_PIXELS or width * height == 0:
                    raise ModelError(f"{name}: image of {width} x {height} pixels; at most "
                                     f"{_MAX_PIXELS}")
                self._check(width * height * (4 if transparent else 3), name)
                if image.mode.startswith("I;16"):  # which Pillow clips instead of scaling
                    image = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
                if max(width, height) > _MAX_SIDE:
                    image.thumbnail((_MAX_SIDE, _MAX_SIDE))
                pixels = np.asarray(image.convert("RGBA" if transparent else "RGB"), np.uint8)
            except UnidentifiedImageError:
                raise ModelError(f"{name}: is not an image of a known format "
                                 f"({', '.join(_FORMATS)})") from None
            except ModelError:
                raise
            except Exception as error:
                why = f" ({error})" if str(error) and "0x" not in str(error) else ""
                raise ModelError(f"{name}: is a damaged image{why}") from error
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
