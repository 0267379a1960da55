"""What goes through a `Session` and comes back: plain values, checked when they are made. Needs numpy only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from ..controls.frame import Controls
from ..errors import ConfigError, ShapeError
from ..geometry.camera import Camera
from ..hair.settings import HairSettings
from ..light.lamps import Lighting
from ..light.shading import Response
from .wearing import HairUse

HEAD_TO_BLENDER: np.ndarray = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Head axes (y up, face +z) to the axes of Blender's head object (z up, face -y): (x, y, z) -> (x, -z, y), [4, 4]."""
HEAD_TO_BLENDER.flags.writeable = False
LIGHT_PASSES = ("diffuse", "specular", "shadow")
PASS_NAMES: tuple[str, ...] = ("rgb", "alpha", "depth", "raw", "normal", "features", "mask", "hair", *LIGHT_PASSES)
LINEAR_PASS = "linear"
"""A further pass, for hosts that work in linear light: "rgb" and "alpha" as `color.scene_linear_premultiplied` has them."""
RAW_LINEAR_PASS = "raw_linear"
"""The same of "raw" and "alpha"."""
EMPTY_DEPTH = 1.0e10
"""Depth in metres of pixels that no Gaussian covers: Blender's value for an empty Z pass."""
MAX_LOD = 3
FINAL_STRANDS = MAX_STRANDS = 8.0
"""Of `RenderOptions.strands`: for final pictures, and at most."""
MAX_WRINKLES = 4.0
CLOUD_TERMS = (1, 4, 9, 16)
"""Numbers of spherical harmonics that a cloud may have: those of the degrees 0 to 3."""
MAX_PIXELS = 1 << 26  # 8192 x 8192; refuses sizes that only a typing error asks for


@dataclass(frozen=True)
class AvatarInfo:
    """What a caller may know about an opened avatar without loading the model.

    Attributes:
        id: Handle for the other methods. Valid for the life of the session, also across a restart of the worker.
        name: Display name.
        source: What `open` takes for it: "default", "sample:SEED", "library:NAME", or an absolute path.
        head_name: Name of the head model, such as "open_head".
        head_sha256: Hash of the head model's asset.
        weights_name: Name of the trained weights.
        weights_sha256: Hash of the trained weights' file.
        vertex_count: Vertices V of the head mesh.
        gaussian_count: Gaussians of the avatar at full detail.
        feature_count: Feature channels of each Gaussian.
        z_id_size: Length of the residual identity code.
        z_exp_size: Length of the residual expression code.
        shape: The avatar's own shape coefficients, [300]; `Controls.shape` is added to them.
        z_id: The avatar's own residual identity code, [z_id_size]; `Controls.z_id` is added to it.
        aligned_code_norms: Length of the residual code of each aligned expression, [60].
        provenance: Where the avatar comes from (keys of `avatar.Provenance`).
        thumbnail: PNG bytes, or empty.
        hair: Settings of the strands that the avatar has of its own; None where its hair is in its Gaussians only.
        hair_parts: Those of its brows, beard and lashes, by these names, where they are not `HairSettings.for_part` of `hair`.
        antialiased: Its Gaussians want the opacity compensation of antialiasing (`splat.compensation`) from what draws them.
    """

    id: int
    name: str
    source: str
    head_name: str
    head_sha256: str
    weights_name: str
    weights_sha256: str
    vertex_count: int
    gaussian_count: int
    feature_count: int
    z_id_size: int
    z_exp_size: int
    shape: np.ndarray
    z_id: np.ndarray
    aligned_code_norms: np.ndarray
    provenance: Mapping[str, object] = field(default_factory=lambda: MappingProxyType({}))
    thumbnail: bytes = b""
    hair: HairSettings | None = None
    hair_parts: Mapping[str, HairSettings] = field(default_factory=lambda: MappingProxyType({}))
    antialiased: bool = False


@dataclass(frozen=True)
class Deformation:
    """The mesh of an avatar under some controls, head space, metres.

    Attributes:
        vertices: Posed vertices v_d of eq. 11 after skinning, [V, 3] float32.
        displacement: Learned residual displacement of the unposed vertices, times `residual_strength`, [V, 3] float32: what
            Blender's residual shape key holds.
        joints: Posed joint positions of root, neck, jaw, left eye, right eye, [5, 3] float32.
    """

    vertices: np.ndarray
    displacement: np.ndarray
    joints: np.ndarray


@dataclass(frozen=True)
class CloudArrays:
    """Gaussians that did not come from the model, in head axes (y up), to be drawn beside avatars: see `Session.put_cloud`.

    Attributes:
        means: Centres in metres, [N, 3].
        quats: Quaternions wxyz, [N, 4].
        scales: Standard deviations in metres along the local axes, [N, 3].
        opacities: 0..1, [N].
        harmonics: Spherical harmonics of display sRGB as in 3DGS, [N, K, 3] with K 1, 4, 9 or 16.
    """

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    harmonics: np.ndarray

    def __post_init__(self) -> None:
        count = len(self.means)
        terms = self.harmonics.shape[1] if self.harmonics.ndim == 3 else 0
        shapes = {"means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,)}
        if terms not in CLOUD_TERMS:
            found = self.harmonics.shape
            raise ShapeError(f"CloudArrays.harmonics has the shape {found}; [N, K, 3] with K 1, 4, 9 or 16 is needed.")
        for name, shape in {**shapes, "harmonics": (count, terms, 3)}.items():
            array = np.ascontiguousarray(getattr(self, name), np.float32)
            if array.shape != shape:
                raise ShapeError(f"CloudArrays.{name} has the shape {array.shape}; {shape} is needed.")
            object.__setattr__(self, name, array)


@dataclass(frozen=True)
class Instance:
    """One avatar placed in the world for one picture.

    Attributes:
        avatar_id: `AvatarInfo.id`, or what `Session.put_cloud` returned.
        controls: Its expression and pose.
        model_to_world: Head space to world, [4, 4]: rotation, translation, one uniform scale. The camera of `render` is in
            the same world. From a Blender matrix M of the head object: M @ HEAD_TO_BLENDER.
        hair: What it wears.
        response: How it takes the light of `RenderOptions.lighting`; None: it stays in the studio's light, as learned.
        lighting: Light of its own in the place of that, in head space, such as a photo's.
        wrinkles: Factor of the height of the furrows that its expression draws, 0 to `MAX_WRINKLES`.
    """

    avatar_id: int
    controls: Controls = field(default_factory=Controls)
    model_to_world: np.ndarray = field(default_factory=lambda: np.eye(4))
    hair: HairUse = field(default_factory=HairUse)
    response: Response | None = None
    lighting: Lighting | None = None
    wrinkles: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.wrinkles <= MAX_WRINKLES:  # neither is NaN
            raise ConfigError(f"The factor of the wrinkles is {self.wrinkles}; it must be 0 to {MAX_WRINKLES:g}.")
        matrix = np.array(self.model_to_world, np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise ShapeError("An avatar's placement must be a 4x4 matrix of finite numbers.")
        linear = matrix[:3, :3]
        scale = float(np.cbrt(np.linalg.det(linear)))
        if scale < 1e-6 or np.abs(linear @ linear.T - scale**2 * np.eye(3)).max() > 1e-3 * scale**2:
            raise ShapeError(
                "An avatar's placement must be a rotation, a translation and one uniform positive scale; give it, and what it "
                "hangs on, the same scale above 0 in x, y and z."
            )
        matrix.flags.writeable = False
        object.__setattr__(self, "model_to_world", matrix)


@dataclass(frozen=True)
class RenderOptions:
    """How a picture is made.

    Attributes:
        refine: Run the refinement network Psi_ref (eq. 14); without it "rgb" equals "raw".
        passes: Buffers to return, see `Session.render`.
        lod: Level of detail: 0 every Gaussian, each further level a quarter of them (larger ones), up to `MAX_LOD`.
        background: Display sRGB behind the avatars, or None for transparent.
        coarse: Refine at half the resolution, for previews: a quarter of the network's time, a little softer.
        lighting: Light of the scene in the world's axes, for the instances that have a `response`; None: the studio's.
        strands: Share 0..1 of the strands of scalp and beard to draw, in their places, wider, below 1 of half the points; with
            `coarse`, Gaussians far behind the skin are left out then, too. For playback. Above 1, so many times the scalp's
            strands, finer ones: `FINAL_STRANDS` for pictures that may take their time.
    """

    refine: bool = True
    passes: tuple[str, ...] = ("rgb", "alpha")
    lod: int = 0
    background: tuple[float, float, float] | None = None
    coarse: bool = False
    lighting: Lighting | None = None
    strands: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "passes", tuple(self.passes))
        unknown = [name for name in self.passes if name not in (*PASS_NAMES, LINEAR_PASS, RAW_LINEAR_PASS)]
        if unknown or not self.passes:
            name = unknown[0] if unknown else ""
            raise ConfigError(f"There is no render pass {name!r}; choose from {', '.join(PASS_NAMES)}.")
        if not 0 <= self.lod <= MAX_LOD:
            raise ConfigError(f"The level of detail is {self.lod}; it must be 0 to {MAX_LOD}.")
        if not 0.0 < self.strands <= MAX_STRANDS:
            raise ConfigError(f"The share of the strands is {self.strands}; it must be above 0 and up to {MAX_STRANDS:g}.")
        if self.background is not None:
            color = np.asarray(self.background, np.float64)
            if color.shape != (3,) or not np.isfinite(color).all():
                raise ConfigError("The background must be three finite numbers or None for transparent.")


@dataclass(frozen=True)
class SessionStatus:
    """What runs the model, for diagnostics panels and `grmm info`.

    Attributes:
        kind: "local" or "worker".
        alive: The model can answer now (a worker that was not started yet, or has crashed, is not alive).
        pid: Process that runs the model, 0 when not alive.
        python: Version of its interpreter.
        engine: "torch", or "plain" for numpy, numba and onnxruntime; "" when it has not been loaded yet.
        torch: Version of torch there, or "" when it has not been loaded yet.
        device: "cpu", "cuda", "mps" with a readable name.
        threads: Threads the model may use.
        memory_bytes: Resident memory of the process, 0 when unknown.
        restarts: How often the worker was started again after a crash.
        log: Last lines that the worker wrote to stderr.
    """

    kind: str
    alive: bool
    pid: int = 0
    python: str = ""
    engine: str = ""
    torch: str = ""
    device: str = ""
    threads: int = 0
    memory_bytes: int = 0
    restarts: int = 0
    log: str = ""


def check_render_size(camera: Camera) -> None:
    """Raise `ConfigError` when a picture is too large to be meant."""
    if camera.width * camera.height > MAX_PIXELS:
        raise ConfigError(f"A picture of {camera.width}x{camera.height} pixels is too large; choose a smaller size.")
