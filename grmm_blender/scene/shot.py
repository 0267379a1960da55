"""What a picture needs to know of a scene, as plain values: nothing here refers to Blender's data.

Made by `walk`; read by the engine and the viewport, on any thread.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grmm_core.controls.frame import Controls
from ...grmm_core.geometry.camera import Camera
from ...grmm_core.light.lamps import Lighting
from ...grmm_core.light.shading import Response
from ...grmm_core.session import HairUse
from ..hair import StrandShot
from ..splats import CloudShot

WEARS_ITS_OWN = HairUse()


@dataclass(frozen=True)
class AvatarShot:
    """An avatar, or a splat cloud, as it is in one frame.

    Attributes:
        name: Name of its head object, or of the cloud object.
        source: What `session_host.open_avatar` takes; "" for a cloud.
        controls: Expression and pose.
        model_to_world: Head space to Blender's world, [4, 4].
        holdout: It cuts a hole instead of being drawn.
        cloud: Its Gaussians, for a cloud.
        hair: What it wears; the same choice is the same object, so that shots can be compared.
        strands: Curves in the place of the groom of `hair`; None: there are none.
        note: One sentence about what it should wear and cannot, or "".
        response: How it takes the scene's light; None: it stays in the studio's.
        lighting: What lights it in a viewport of splats; None: as `response` says, in the shot of the scene.
        lit_by_view: That light turns with the view and is in its axes, y up and z to the viewer; else in the world's.
        own_light: Light that it takes in the place of the scene's, in head space.
        wrinkles: Factor of the furrows of its expression.
    """

    name: str
    source: str
    controls: Controls
    model_to_world: np.ndarray
    holdout: bool = False
    cloud: CloudShot | None = None
    hair: HairUse = WEARS_ITS_OWN
    response: Response | None = None
    lighting: Lighting | None = None
    lit_by_view: bool = False
    own_light: Lighting | None = None
    wrinkles: float = 1.0
    strands: StrandShot | None = None
    note: str = ""


@dataclass(frozen=True, eq=False)
class Occluder:
    """A mesh in front of which or behind which avatars may stand.

    Attributes:
        triangles: Corners in the mesh's own space, [T, 3, 3]. Never written to: the same array is the same mesh.
        matrix: Places it in the world, [4, 4] float64.
    """

    triangles: np.ndarray
    matrix: np.ndarray

    def placed(self, dtype: type[np.floating] = np.float32) -> np.ndarray:
        """Return the corners in the world, [T, 3, 3]."""
        world = self.triangles.reshape(-1, 3) @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        return world.astype(dtype).reshape(-1, 3, 3)


@dataclass(frozen=True)
class Occluders:
    """The meshes of a scene.

    Attributes:
        plain: Objects that only hide.
        holdouts: Objects that cut holes into the alpha channel too.
    """

    plain: tuple[Occluder, ...] = ()
    holdouts: tuple[Occluder, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.plain or self.holdouts)


@dataclass(frozen=True)
class SceneShot:
    """A scene at one moment.

    Attributes:
        avatars: Avatars and clouds to draw, sorted by name: pictures do not depend on the order of creation.
        has_avatars: There are any, if only as holdouts.
        occluders: Meshes that hide them.
        world: Scene-linear color of the background, [3], or None for a transparent film.
        lighting: Light of the scene, where an avatar takes it.
    """

    avatars: tuple[AvatarShot, ...] = ()
    has_avatars: bool = False
    occluders: Occluders = Occluders()
    world: np.ndarray | None = None
    lighting: Lighting | None = None


@dataclass(frozen=True)
class Frame:
    """Everything that a picture is made from.

    Attributes:
        scene: What there is to see.
        camera: Camera of the full picture.
        clip: Nearest and farthest distance that the camera sees, metres.
    """

    scene: SceneShot
    camera: Camera
    clip: tuple[float, float]


@dataclass(frozen=True)
class Region:
    """Part of the full picture that is rendered, in pixels from the lower left corner."""

    x: int
    y: int
    width: int
    height: int
