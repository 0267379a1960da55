"""Makes the documentation's pictures of what `pictures` saved: `python tools/window/assemble.py FOLDER docs/images`."""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

SIDEBAR = (852, 80, 1069, 848)  # in windows of 1300 x 940: left, upper, right, lower
DETAIL = (714, 90, 1296, 700)
PHOTOS = (714, 90, 1296, 316)
GAP = 12  # pixels between pieces
BACKGROUND = (24, 24, 24)
COLORS = 256  # of the saved palette; dithered, so that the shaded head shows no steps


def main(source: Path, target: Path) -> None:
    """Write panel_expression.png (a window) and panel_detail.png (pieces of three windows)."""
    pieces = [
        Image.open(source / name).convert("RGB").crop(box)
        for name, box in (("window.png", SIDEBAR), ("panel_detail.png", DETAIL), ("panel_fit.png", PHOTOS))
    ]
    sidebar, detail, photos = pieces
    height = max(sidebar.height, detail.height + GAP + photos.height)
    sheet = Image.new("RGB", (sidebar.width + GAP + detail.width, height), BACKGROUND)
    sheet.paste(sidebar, (0, 0))
    sheet.paste(detail, (sidebar.width + GAP, 0))
    sheet.paste(photos, (sidebar.width + GAP, detail.height + GAP))
    for name, picture in (
        ("panel_expression.png", Image.open(source / "panel_expression.png").convert("RGB")),
        ("panel_detail.png", sheet),
    ):
        # Only with a palette given does Pillow dither.
        palette = picture.quantize(COLORS)
        picture.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(target / name, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
