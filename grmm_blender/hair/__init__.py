"""Hair in a scene: strands as Blender's Curves object on the head's surface, read from it and made from a groom.

``strands`` strands of one frame as plain values
``read``    from an evaluated Curves object to a shot
``build``   a Curves object from a groom
``curve_sliders`` what the panel's sliders do to curves, for every engine
``display`` whether viewports show curves or splats
``grooms``  the choice of hair, with pictures
``swing``   hair that was baked while an animation played
"""

from __future__ import annotations

from .read import message_of, read_strands
from .strands import StrandShot

__all__ = ["StrandShot", "message_of", "read_strands"]
