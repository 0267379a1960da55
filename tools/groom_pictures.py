"""`python -m tools.groom_pictures`: draw the small pictures by which grooms are chosen, with the renderer of this package.

One for each groom and one of a bald head, `grmm_core/assets/grooms/NAME.jpg`; half a minute. Needs pillow.
"""

from __future__ import annotations

import io
import sys

import numpy as np
from PIL import Image

from grmm_core.files.access import atomic_write_bytes
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings, groom_names
from grmm_core.hair.packaged import GROOM_FOLDER, PICTURE_SUFFIX
from grmm_core.session import HairUse, Instance, RenderOptions, create_session
from grmm_core.session.wearing import GROOM_PREFIX, NO_HAIR

PIXELS, OVERSAMPLED, QUALITY = 128, 3, 78
YAW, PITCH, DISTANCE, FOV = 32.0, 8.0, 1.15, 21.0
BACKGROUND = (0.16, 0.16, 0.16)
LOOK = HairSettings(melanin=0.55, redness=0.15)  # light enough that strands can be told apart


def main() -> int:
    """Write the files."""
    size = PIXELS * OVERSAMPLED
    camera = Camera.orbit(size, size, YAW, PITCH, DISTANCE, FOV)
    options = RenderOptions(passes=("rgb",), background=BACKGROUND)
    total = 0
    with create_session("local") as session:
        head = session.open("default")
        for name in (NO_HAIR, *groom_names()):
            use = HairUse(name if name == NO_HAIR else GROOM_PREFIX + name, LOOK)
            picture = session.render([Instance(head.id, hair=use)], camera, options)["rgb"]
            pixels = np.round(picture.clip(0.0, 1.0) * 255).astype(np.uint8)
            data = io.BytesIO()
            Image.fromarray(pixels).resize((PIXELS, PIXELS), Image.Resampling.LANCZOS).save(data, "JPEG", quality=QUALITY)
            atomic_write_bytes(GROOM_FOLDER / f"{name}{PICTURE_SUFFIX}", data.getvalue())
            total += len(data.getvalue())
    print(f"{len(groom_names()) + 1} pictures, {total} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
