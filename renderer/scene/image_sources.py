"""Images for surfaces and backgrounds: procedural ones, or those of a user's folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from ...errors import ConfigError
from ...robots.files import read_bounded
from .images import PLAIN, TextureImage, draw_texture

_SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".webp")
_MAX_BYTES = 64 << 20
_MAX_PIXELS = 100_000_000


class ImageFolder:
    """The images in a folder and in the folders directly below it, sorted by path.

    Raises ConfigError if the folder is missing or contains no image.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.is_dir():
            raise ConfigError(f"no image folder {path}: give an existing folder of images")
        found = {p for pattern in ("*", "*/*") for p in self.path.glob(pattern)
                 if p.suffix.lower() in _SUFFIXES and p.is_file()
                 and not any(part.startswith(".") for part in p.relative_to(self.path).parts)}
        # As text with "/", so that the order is the same on every system.
        self.files = tuple(sorted(found, key=lambda p: p.relative_to(self.path).as_posix()))
        if not self.files:
            raise ConfigError(f"no images in {path}: put {', '.join(_SUFFIXES)} files there")

    def draw(self, rng: np.random.Generator, size: tuple[int, int],
             tileable: bool = False) -> TextureImage:
        """Draw one of the images as sRGB [h w 3] of `size` (h, w) px, cropped to that aspect.

        A tileable one is mirrored to the right and downwards: it repeats without a seam.
        Raises ConfigError for a file that cannot be read as an image, or is too large.
        """
        h, w = size
        image = _read(self.files[int(rng.integers(len(self.files)))])
        rows, columns = image.shape[:2]
        zoom = min(rows / h, columns / w)
        crop_h, crop_w = max(1, round(h * zoom)), max(1, round(w * zoom))
        y, x = (int(rng.integers(n + 1)) for n in (rows - crop_h, columns - crop_w))
        image = image[y:y + crop_h, x:x + crop_w]
        if tileable:
            half = _resize(image, (h + 1) // 2, (w + 1) // 2)
            wide = np.concatenate([half, half[:, ::-1]], 1)
            return np.ascontiguousarray(np.concatenate([wide, wide[::-1]], 0)[:h, :w])
        return _resize(image, h, w)


def draw_image(kinds: Sequence[str], images: ImageFolder | None, size: tuple[int, int],
               rng: np.random.Generator, tileable: bool,
               plain: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> TextureImage:
    """Draw sRGB [h w 3] of `size` (h, w) px: from `images` if given, else of one of `kinds`.

    `plain` is the color of the kind "plain", sRGB 0..1.

    Raises ConfigError for an unknown kind, or an unreadable image.
    """
    if images is not None:
        return images.draw(rng, size, tileable)
    kind = kinds[int(rng.integers(len(kinds)))]
    if kind == PLAIN:
        color = np.round(255.0 * np.asarray(plain)).astype(np.uint8)
        return np.broadcast_to(color, (*size, 3)).copy()
    return draw_texture(kind, size, rng, tileable)


def _read(path: Path) -> TextureImage:
    """Return sRGB [h w 3]. Decodes bytes: cv2.imread rejects some file names on Windows."""
    try:
        data = np.frombuffer(read_bounded(path, _MAX_BYTES, ConfigError), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    except (MemoryError, cv2.error) as error:
        raise ConfigError(f"cannot read image {path}: replace or remove it") from error
    if image is None:
        raise ConfigError(f"{path} is not an image that OpenCV reads: replace or remove it")
    if image.shape[0] * image.shape[1] > _MAX_PIXELS:
        raise ConfigError(f"{path} has more than {_MAX_PIXELS // 10**6} megapixels: shrink it")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def _resize(image: TextureImage, h: int, w: int) -> TextureImage:
    smaller = h < image.shape[0]
    method = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (w, h), interpolation=method), np.uint8)
