"""Open a photo as an upright 8-bit-range RGB array, whatever the camera or program wrote.

Pillow reads the files: it knows every common format, and its decoders are maintained. What is added here are the limits and
the one-sentence errors.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FileAccessError, FileFormatError, GrmmError, ShapeError
from ..files.access import describe_os_error

if TYPE_CHECKING:
    from PIL import Image

MAX_PIXELS = 300_000_000  # far above any camera; refuses pictures made to exhaust memory
MAX_SIDE = 4096  # larger photos are reduced: a face is never fitted at more
MIN_SIDE = 64
MASK_TOLERANCE = 0.02  # relative difference of proportions
_EXIF_ORIENTATION, _TURNED = 0x0112, (5, 6, 7, 8)  # values with which width and height change places
_HEIC_SUFFIXES = {".heic", ".heif", ".avif"}


@dataclass(frozen=True)
class Photo:
    """A decoded photo.

    Attributes:
        path: Where it came from.
        pixels: Display sRGB 0..1, [H, W, 3] float32; transparent parts are composited over mid grey.
        alpha: Opacity 0..1, [H, W] float32, or None when the file has none.
        scale: Size of `pixels` relative to the file's (below 1 when it was reduced).
    """

    path: Path
    pixels: np.ndarray
    alpha: np.ndarray | None
    scale: float


def load_photo(path: str | os.PathLike[str], max_side: int = MAX_SIDE) -> Photo:
    """Read a photo: EXIF orientation applied, 8 or 16 bits, grey, palette or alpha.

    Raises:
        FileAccessError: Missing or not readable.
        FileFormatError: Not a picture, truncated, in a format that is not installed, too small or too large.
    """
    from PIL import ImageOps

    path = Path(path)
    with _opened(path) as image:
        width, height = image.size
        image.draft("RGB", (max_side, max_side))  # JPEG decodes large photos at a fraction of their size
        image.load()
        image = ImageOps.exif_transpose(image)
        scale = min(1.0, max_side / max(width, height))
        rgb, alpha = _to_rgb(image)
    return _reduced(Photo(path, rgb, alpha, scale), max_side)


def picture_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Width and height of the upright photo; its pixels are not decoded. Raises as `load_photo`."""
    path = Path(path)
    with _opened(path) as image:
        width, height = image.size
        return (height, width) if image.getexif().get(_EXIF_ORIENTATION, 1) in _TURNED else (width, height)


def check_proportion(mask: tuple[int, int], photo: tuple[int, int], name: str) -> None:
    """Refuse a mask whose width and height have another proportion than its photo's. Raises `ShapeError`."""
    if abs(mask[0] / mask[1] - photo[0] / photo[1]) > MASK_TOLERANCE * photo[0] / photo[1]:
        raise ShapeError(
            f"The mask has {mask[0]}x{mask[1]} pixels, another proportion than {name} with {photo[0]}x{photo[1]}; "
            "make it from the upright photo."
        )


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """A picture that Pillow has opened and of which only the header is read; what goes wrong with it becomes one sentence."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # Pillow's own bomb warning has another limit; ours is checked before anything is decoded.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path) as image:
                _check_size(path, *image.size)
                yield image
    except (FileNotFoundError, IsADirectoryError) as error:
        raise FileAccessError(f"{path} does not exist or is a folder; choose a photo.") from error
    except PermissionError as error:
        raise FileAccessError(f"Cannot read {path}: {describe_os_error(error)}; change its permissions or copy it.") from error
    except UnidentifiedImageError as error:
        hint = "save it as JPEG or PNG first" if path.suffix.lower() in _HEIC_SUFFIXES else "choose a JPEG or PNG photo"
        raise FileFormatError(f"{path.name} is not a picture that can be read here; {hint}.") from error
    except Image.DecompressionBombError as error:
        raise FileFormatError(f"{path.name} is too large to be a photo; reduce it first.") from error
    except (GrmmError, MemoryError):
        raise
    # Damaged files make Pillow's decoders raise OSError, SyntaxError, ValueError, struct.error, EOFError, IndexError ...
    except Exception as error:
        raise FileFormatError(f"{path.name} is damaged or truncated; get the photo again.") from error


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise FileFormatError(f"{path.name} has {width}x{height} pixels, which is too large; reduce it below 300 megapixels.")
    if min(width, height) < MIN_SIDE:
        raise FileFormatError(f"{path.name} has only {width}x{height} pixels; use a photo of at least {MIN_SIDE} on each side.")


def _to_rgb(image: Image.Image) -> tuple[np.ndarray, np.ndarray | None]:
    """Return [H, W, 3] and alpha of a Pillow image in any mode."""
    mode = image.mode
    if mode.startswith("I;16") or mode == "I":
        grey = np.asarray(image, np.float32)
        grey /= 65535.0 if grey.max(initial=0.0) > 255.0 or mode.startswith("I;16") else 255.0
        return np.repeat(np.clip(grey, 0.0, 1.0)[:, :, None], 3, axis=2), None
    if mode == "F":
        grey = np.nan_to_num(np.asarray(image, np.float32))
        return np.repeat(np.clip(grey, 0.0, 1.0)[:, :, None], 3, axis=2), None
    transparent = mode in ("RGBA", "LA", "PA", "RGBa", "La") or "transparency" in image.info
    values = np.asarray(image.convert("RGBA" if transparent else "RGB"), np.float32) / 255.0
    if not transparent:
        return values, None
    alpha = values[:, :, 3]
    return values[:, :, :3] * alpha[:, :, None] + 0.5 * (1.0 - alpha[:, :, None]), alpha


def _reduced(photo: Photo, max_side: int) -> Photo:
    """Shrink to `max_side` where the decoder did not do it already."""
    from PIL import Image

    height, width = photo.pixels.shape[:2]
    factor = max_side / max(height, width)
    if factor >= 1.0:
        return photo
    size = (max(1, round(width * factor)), max(1, round(height * factor)))

    def shrink(plane: np.ndarray) -> np.ndarray:
        return np.asarray(Image.fromarray(plane).resize(size, Image.Resampling.BOX))

    pixels = np.stack([shrink(np.ascontiguousarray(photo.pixels[:, :, c])) for c in range(3)], axis=2)
    alpha = None if photo.alpha is None else shrink(photo.alpha)
    return Photo(photo.path, pixels, alpha, photo.scale)
