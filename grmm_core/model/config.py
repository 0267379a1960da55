"""Every size of the model in one immutable object.

`GRMMConfig` is stored as JSON in weights files and read from training configurations. `PRESETS` holds the paper's sizes and
smaller ones. Used by every module of this package; needs the standard library only.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import ConfigError

POSITION_CHANNELS = 3
ROTATION_CHANNELS = 4
SCALE_CHANNELS = 3
TRANSFORM_CHANNELS = POSITION_CHANNELS + ROTATION_CHANNELS + SCALE_CHANNELS  # the paper's 10
COLOR_CHANNELS = 3
BASIS_COLOR = "colour"  # spelled as weights files have it
JOINTS_OF_MESH_DECODER = 6  # theta_neck and theta_jaw, axis-angle
VIEW_CHANNELS = 3

BASIS_GROUPS: dict[str, int] = {
    "position": POSITION_CHANNELS, "rotation": ROTATION_CHANNELS, "scale": SCALE_CHANNELS,
    "opacity": 1, BASIS_COLOR: COLOR_CHANNELS,
}  # fmt: skip
"""Attributes that basis maps can carry, with their channels."""

METRES_PER_MM = 1e-3  # decoders work in millimetres

_MAX_SIZE = 1 << 14  # refuses absurd sizes of damaged or hostile files before anything is allocated


@dataclass(frozen=True)
class GRMMConfig:
    """Sizes and switches of a `GRMM`.

    Attributes:
        grid: N_g, texels along a side of the UV square.
        focus: Spend texels where eyes look (`focus`) instead of evenly over the head's UV map.
        features: Feature channels that each Gaussian carries to the refinement network (paper: 32).
        z_id, z_exp: Length of the residual codes. Without residuals they are the head's shape and expression lengths.
        residuals: False gives the ablation of eq. 21: codes are replaced by shape and expression coefficients.
        alpha_exp: Expression coefficients that the FiLM layer reads (paper: 100).
        mesh_hidden: Width of the mesh decoder's layers.
        mesh_rank: Width of the last hidden layer before the vertices; None is `mesh_hidden`.
        decoder_start: Texels along a side of the first map of a decoder (paper: 8).
        decoder_channels: Channels after each stage, the first for the start map. Every stage but the first doubles the side.
        decoder_grid: Side at which the decoders end; below `grid` their maps are enlarged bilinearly.
        view_stage: Side of the map to which the tiled view direction is added (paper: 8).
        mean_maps: Free full-resolution maps added to each decoder's output.
        basis_maps: Number of full-resolution maps weighted by a linear map of z_id; 0 is the paper's plain form.
        basis_channels: Which attributes the basis maps carry, names of `BASIS_GROUPS`.
        expression_maps: Number of full-resolution color maps weighted by z_exp and z_id, for wrinkles and blood; 0 is the
            paper's plain form, in which colors do not change with expression.
        position_unit_mm: Millimetres that a decoder output of 1 moves a Gaussian.
        position_limit_mm: Soft limit of position offsets (hair needs centimetres).
        scale_log_limit: Soft limit of |log(scale / base scale)|; None leaves it free.
        normal_scale: Base scale along the normal, relative to the texel's smaller side.
        texel_scale: Base scale in the tangent plane, relative to the texel's side.
        opacity_bias: Added to the opacity logits.
        antialias: Draw with Mip-Splatting's compensation: Gaussians smaller than a pixel do not grow a head's outline.
        hairless: Trained on people without any hair: scalp hair, brows, lashes and beards are strands that sessions add.
        turned_light: Colors of a head that its neck turns change as the capture studio's rig lights it (`light.turning`); to be
            off for data in another light. The paper's form has nothing like it.
        eye_shade: Eyes lie in the shade of their lids, which colors do not hold (`light.eye_shade`); likewise.
        mouth_tone: Mouths are darker inside, and lips darker and less red, than colors hold (`light.tones`); likewise.
        lip_line: The borders of lips are redrawn along smooth lines (`model.lip_line`), for weights of a studio that painted
            them elsewhere: up to its number 9.
        refine: Whether there is a refinement network.
        refine_channels: Widths of the refinement network's levels, finest first.
        refine_unshuffle: Pixels along a side folded into channels before the first convolution (1 or 2).
    """

    name: str = "paper"
    grid: int = 512
    focus: bool = False
    features: int = 32
    z_id: int = 512
    z_exp: int = 256
    residuals: bool = True
    alpha_exp: int = 100
    mesh_hidden: int = 256
    mesh_rank: int | None = None
    decoder_start: int = 8
    decoder_channels: tuple[int, ...] = (256, 256, 128, 64, 32, 32)
    decoder_grid: int = 512
    view_stage: int = 8
    mean_maps: bool = False
    basis_maps: int = 0
    basis_channels: tuple[str, ...] = ("position", "opacity", BASIS_COLOR)
    expression_maps: int = 0
    position_unit_mm: float = 1.0
    position_limit_mm: float = 200.0
    scale_log_limit: float | None = None
    normal_scale: float = 0.35
    texel_scale: float = 0.6
    opacity_bias: float = 2.0
    antialias: bool = False
    hairless: bool = False
    turned_light: bool = True
    eye_shade: bool = True
    mouth_tone: bool = True
    lip_line: bool = True
    refine: bool = True
    refine_channels: tuple[int, ...] = (32, 64, 128)
    refine_unshuffle: int = 1

    def __post_init__(self) -> None:
        """Check consistency. Raises `ConfigError`."""
        # JSON and TOML give lists
        for name in ("decoder_channels", "basis_channels", "refine_channels"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        sizes = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.type == "int"}
        sizes |= {f"decoder_channels[{i}]": c for i, c in enumerate(self.decoder_channels)}
        sizes |= {f"refine_channels[{i}]": c for i, c in enumerate(self.refine_channels)}
        if self.mesh_rank is not None:
            sizes["mesh_rank"] = self.mesh_rank
        for name, value in sizes.items():
            smallest = 0 if name in ("features", "basis_maps", "expression_maps") else 1
            if type(value) is not int or not smallest <= value <= _MAX_SIZE:
                raise ConfigError(f"The model setting {name} is {value!r}; it must be a number from {smallest} to {_MAX_SIZE}.")
        if self.decoder_start << len(self.decoder_channels) != self.decoder_grid:
            raise ConfigError(
                f"{len(self.decoder_channels)} doublings of decoder_start {self.decoder_start} do not give "
                f"decoder_grid {self.decoder_grid}; change decoder_channels."
            )
        if self.decoder_grid > self.grid or self.grid % self.decoder_grid:
            raise ConfigError(f"decoder_grid {self.decoder_grid} must divide grid {self.grid}.")
        stages = [self.decoder_start << i for i in range(len(self.decoder_channels))]
        if self.view_stage not in stages:
            raise ConfigError(f"view_stage {self.view_stage} is not the side of a decoder map; use one of {stages}.")
        unknown = set(self.basis_channels) - set(BASIS_GROUPS)
        if unknown:
            raise ConfigError(f"Unknown basis_channels {sorted(unknown)}; use names of {sorted(BASIS_GROUPS)}.")
        if self.refine_unshuffle not in (1, 2):
            raise ConfigError(f"refine_unshuffle is {self.refine_unshuffle}; it must be 1 or 2.")
        if self.refine and not self.refine_channels:
            raise ConfigError("refine_channels is empty; give at least one width or set refine to false.")

    def replace(self, **changes: Any) -> GRMMConfig:
        """Return a copy with the named fields changed. Raises `ConfigError`."""
        return GRMMConfig.from_dict(dataclasses.asdict(self) | changes)

    def to_json(self) -> str:
        """Return the configuration as JSON with sorted keys."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    @staticmethod
    def from_json(text: str) -> GRMMConfig:
        """Read what `to_json` wrote. Raises `ConfigError`."""
        try:
            values = json.loads(text)
        except ValueError as error:
            raise ConfigError(f"The model configuration is not JSON ({error}); get the weights again.") from error
        return GRMMConfig.from_dict(values)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> GRMMConfig:
        """Build a configuration from fields by name; absent ones keep their default. Raises `ConfigError`."""
        if not isinstance(values, Mapping):
            raise ConfigError("The model configuration is not a table of settings.")
        known = {f.name: f for f in dataclasses.fields(GRMMConfig)}
        for name, value in values.items():
            if name not in known:
                raise ConfigError(f"Unknown model setting {name!r}; known are {', '.join(sorted(known))}.")
            _check_type(name, str(known[name].type), value)
        return GRMMConfig(**values)


def _check_type(name: str, annotation: str, value: Any) -> None:
    """Refuse a value of the wrong kind, so that a damaged file gives a sentence instead of a traceback."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and value == value and abs(value) < 1e9
    fits = {
        "str": isinstance(value, str),
        "bool": isinstance(value, bool),
        "int": type(value) is int,
        "float": is_number,
        "int | None": value is None or type(value) is int,
        "float | None": value is None or is_number,
        "tuple[int, ...]": isinstance(value, (list, tuple)) and all(type(v) is int for v in value) and len(value) < 32,
        "tuple[str, ...]": isinstance(value, (list, tuple)) and all(isinstance(v, str) for v in value) and len(value) < 32,
    }
    if not fits[annotation]:
        raise ConfigError(f"The model setting {name} is {value!r}; it must be of type {annotation}.")


PRESETS: dict[str, GRMMConfig] = {
    "paper": GRMMConfig(turned_light=False, eye_shade=False, mouth_tone=False, lip_line=False),
    # the paper's sizes with the two extensions that gave the largest gains, and clamped scales
    "base": GRMMConfig(
        name="base", grid=512, features=32, z_id=256, z_exp=128, mesh_hidden=128, mesh_rank=64,
        decoder_channels=(256, 128, 64, 48, 32), decoder_grid=256, mean_maps=True, basis_maps=32,
        position_unit_mm=10.0, scale_log_limit=1.6, refine_channels=(32, 64, 64), refine_unshuffle=2, lip_line=False,
    ),
    # trained and rendered on a CPU
    "small": GRMMConfig(
        name="small", grid=256, features=13, z_id=64, z_exp=32, mesh_hidden=64, mesh_rank=24,
        decoder_start=4, decoder_channels=(128, 128, 64, 48, 24), decoder_grid=128, mean_maps=True, basis_maps=24,
        position_unit_mm=10.0, scale_log_limit=1.6, refine_channels=(16, 32, 48), refine_unshuffle=2, lip_line=False,
    ),
    "tiny": GRMMConfig(
        name="tiny", grid=32, features=4, z_id=6, z_exp=5, mesh_hidden=12, mesh_rank=6,
        decoder_start=4, decoder_channels=(8, 8), decoder_grid=16, mean_maps=True, basis_maps=3,
        expression_maps=2, position_unit_mm=10.0, scale_log_limit=1.6, refine_channels=(8, 8), refine_unshuffle=2,
    ),
}  # fmt: skip
"""Named configurations. `tiny` exists for tests."""
