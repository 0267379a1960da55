"""Open a photo as an upright 8-bit-range RGB array, whatever the camera or program wrote.

Pillow reads the files: it knows every common format, and its decoders are maintained. What is added here are the limits and
the one-sentence errors.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FileFormatError, GrmmError, ShapeError
from ..files.access import read_bytes

if TYPE_CHECKING:
    from PIL import Image

MAX_PIXELS = 300_000_000  # far above any camera; refuses pictures made to exhaust memory
MAX_FILE_BYTES = 1 << 30
MAX_SIDE = 4096  # larger photos are reduced: a face is never fitted at more
MIN_SIDE = 64
MASK_TOLERANCE = 0.02  # relative difference of proportions
_EXIF_ORIENTATION, _TURNED = 0x0112, (5, 6, 7, 8)  # values with which width and height change places
_EXIF_IFD, _EXIF_FOCAL_35MM = 0x8769, 0xA405
_FOCAL_RANGE = (8.0, 1200.0)  # millimetres; files state 0 for "unknown"
_HEIC_SUFFIXES = {".heic", ".heif", ".avif"}


@dataclass(frozen=True)
class Photo:
    """A decoded photo.

    Attributes:
        path: Where it came from.
        pixels: Display sRGB 0..1, [H, W, 3] float32; transparent parts are composited over mid grey.
        alpha: Opacity 0..1, [H, W] float32, or None when the file has none.
        scale: Size of `pixels` relative to the file's (below 1 when it was reduced).
        focal_35mm: Focal length that the file states, millimetres for 35 mm film, or None.
    """

    path: Path
    pixels: np.ndarray
    alpha: np.ndarray | None
    scale: float
    focal_35mm: float | None = None

    def coverage(self) -> np.ndarray:
        """A picture of an outline as coverage 0..1, [H, W]: its alpha where it has one, else its brightness."""
        return self.pixels.mean(-1) if self.alpha is None or self.alpha.min() >= 1.0 else self.alpha


class PhotoFile:
    """A photo's file, opened once: size and EXIF at once, hash and pixels when they are asked for.

    Attributes:
        path: The file.
        width, height: Of the upright photo, pixels.
        focal_35mm: As in `Photo`.

    Raises:
        FileAccessError: Missing or not readable.
        FileFormatError: Not a picture, truncated, in a format that is not installed, too small or too large.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        from PIL import Image

        self.path = Path(path)
        with _one_sentence(self.path), contextlib.ExitStack() as opened:
            # In memory, since Pillow makes room for whatever length a chunk of a file claims before it reads on.
            self._data = read_bytes(self.path, MAX_FILE_BYTES)
            self._image = opened.enter_context(contextlib.closing(Image.open(io.BytesIO(self._data))))
            self._size = self._image.size
            _check_size(self.path, *self._size)
            exif = self._image.getexif()  # of a PNG it may stand behind the pixels, which are then decoded here, and kept
            turned = exif.get(_EXIF_ORIENTATION, 1) in _TURNED
            self.width, self.height = self._size[::-1] if turned else self._size
            self.focal_35mm = _stated_focal(exif)
            self._opened = opened.pop_all()

    def __enter__(self) -> PhotoFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file and of what Pillow has decoded; harmless when done twice."""
        self._opened.close()

    def sha256(self) -> str:
        """SHA-256 of the file's bytes as they are on disk, 64 hexadecimal digits."""
        return hashlib.sha256(self._data).hexdigest()

    def load(self, max_side: int = MAX_SIDE) -> Photo:
        """Decode the pixels, upright, at most `max_side` on the longer side; once, and the file is closed."""
        from PIL import ImageOps

        with _one_sentence(self.path), self:
            image = self._image
            image.draft("RGB", (max_side, max_side))  # JPEG decodes large photos at a fraction of their size
            image.load()
            rgb, alpha = _to_rgb(ImageOps.exif_transpose(image))
        return _reduced(Photo(self.path, rgb, alpha, min(1.0, max_side / max(self._size)), self.focal_35mm), max_side)


def load_photo(path: str | os.PathLike[str], max_side: int = MAX_SIDE) -> Photo:
    """Read a photo: EXIF orientation applied, 8 or 16 bits, grey, palette or alpha. Raises as `PhotoFile`."""
    return PhotoFile(path).load(max_side)


def check_proportion(mask: tuple[int, int], photo: tuple[int, int], name: str) -> None:
    """Refuse a mask whose width and height have another proportion than its photo's. Raises `ShapeError`."""
    if abs(mask[0] / mask[1] - photo[0] / photo[1]) > MASK_TOLERANCE * photo[0] / photo[1]:
        raise ShapeError(
            f"The mask has {mask[0]}x{mask[1]} pixels, another proportion than {name} with {photo[0]}x{photo[1]}; "
            "make it from the upright photo."
        )


@contextlib.contextmanager
def _one_sentence(path: Path) -> Iterator[None]:
    """What goes wrong with a picture's file becomes one sentence."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # Pillow's own bomb warning has another limit; ours is checked before anything is decoded.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            yield
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


def _stated_focal(exif: Image.Exif) -> float | None:
    """Focal length from the 35 mm equivalent, millimetres. A missing or odd entry is no error."""
    try:
        value = float(exif.get_ifd(_EXIF_IFD).get(_EXIF_FOCAL_35MM, 0) or 0)
    except (OSError, ValueError, TypeError, SyntaxError, ZeroDivisionError):
        return None
    return value if _FOCAL_RANGE[0] <= value <= _FOCAL_RANGE[1] else None


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
    return dataclasses.replace(photo, pixels=pixels, alpha=alpha)
