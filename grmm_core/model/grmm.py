"""`GRMM`: the paper's model, from codes and coefficients to a picture (eq. 4-14).

The steps are separate methods, so that callers compute only what changed: opacity is constant per avatar, appearance per
avatar and view, offsets per expression, geometry per pose. `render` composes all of them for training and fitting.

Used by `session`, `training`, `fitting`, `evaluation`. Must not import any of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from ..controls.names import ALIGNED_NAMES, JOINT_NAMES
from ..errors import ConfigError, ShapeError
from ..geometry.camera import Camera
from ..head.torch_head import TorchHead
from ..splat import Gaussians, RasterOutput, rasterize
from .config import GRMMConfig
from .decoders import AttributeDecoders
from .layout import TexelLayout, texel_layout
from .mesh_decoder import MeshDecoder
from .refine import RefinementNetwork, depth_range, doubled, halved, normalise_depth
from .texels import Geometry, TexelAnchor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..head import HeadModel

HEAD_CENTRE: tuple[float, float, float] = (0.0, 0.0, 0.0)
"""Point from which view directions are taken: between the ears, head space, metres."""
NECK, JAW = JOINT_NAMES.index("neck"), JOINT_NAMES.index("jaw")
TEETH_REGIONS = ("upper_teeth", "lower_teeth")
CODE_INIT = 0.1  # standard deviation of the table of expression codes before training
METRES_PER_MM = 1e-3
_SMALL_ANGLE = 1e-6
_THIN_COVER = 1e-6  # keeps the division by an enlarged alpha defined; where that is 0, so is alpha itself


@dataclass
class Rendering:
    """A picture with what led to it.

    Attributes:
        image: I of eq. 14, refined, over the background, [H, W, 3].
        raw: I_rgb of eq. 13, over the background, [H, W, 3].
        alpha: [H, W].
        depth: Expected depth in metres, 0 where nothing is, [H, W].
        gaussians: What was splatted.
        offsets: Decoded offsets before limits, [N, 10].
        vertices: v_d after skinning, [V, 3].
        displacement: Learned displacement, [V, 3] metres.
    """

    image: Tensor
    raw: Tensor
    alpha: Tensor
    depth: Tensor
    gaussians: Gaussians
    offsets: Tensor
    vertices: Tensor
    displacement: Tensor


class GRMM(nn.Module):
    """Gaussian Residual Morphable Model on a head model.

    Args:
        head: Mesh model.
        config: Sizes.
        layout: Active texels that trained maps belong to; found on the head's UV map when None.

    Raises:
        ConfigError: The head lacks what the configuration needs.
    """

    def __init__(self, head: HeadModel, config: GRMMConfig, layout: TexelLayout | None = None) -> None:
        super().__init__()
        self.config = config
        self.head_model = head
        with torch.device("cpu"):  # `load_weights` builds the rest without memory
            self.head = TorchHead(head)
        vertex_count = len(head.v_template)
        # eq. 21: without residuals the coefficients take the codes' places
        self.z_id_size = config.z_id if config.residuals else head.shape_dirs.shape[-1]
        self.z_exp_size = config.z_exp if config.residuals else head.expression_dirs.shape[-1]
        layout = layout or texel_layout(head.uv, head.uv_faces, config.grid)
        if layout.grid != config.grid:
            raise ConfigError(f"The texel layout has a grid of {layout.grid}; the configuration says {config.grid}.")
        self.anchor = TexelAnchor(layout, head.faces, head.uv, head.uv_faces, vertex_count)
        self.mesh_decoder = MeshDecoder(config, self.z_id_size, self.z_exp_size, face_mask(head))
        self.decoders = AttributeDecoders(config, self.z_id_size, self.z_exp_size, layout.texel)
        self.refinement = RefinementNetwork(config) if config.refine else None
        self.half_refinement = False  # whether the refinement network computes in bfloat16: for devices that gain by it
        codes = torch.randn(len(ALIGNED_NAMES), config.z_exp) * CODE_INIT if config.residuals else None
        self.register_parameter("aligned_codes", None if codes is None else nn.Parameter(codes))  # Z [60, Y]

    @property
    def gaussian_count(self) -> int:
        """Active texels N."""
        return self.anchor.count

    @property
    def device(self) -> torch.device:
        """Where the parameters are."""
        return self.anchor.barycentric.device

    @property
    def dtype(self) -> torch.dtype:
        """Floating type of the parameters."""
        return self.anchor.barycentric.dtype

    # --- codes -----------------------------------------------------------------------------------------------------

    def z_identity(self, z_id: Tensor, shape: Tensor) -> Tensor:
        """The identity code that the decoders read: z_id [..., Z], or without residuals the shape coefficients (eq. 21)."""
        return z_id if self.config.residuals else shape

    def z_expression(self, aligned: Tensor, offset: Tensor | None = None, expression: Tensor | None = None) -> Tensor:
        """The expression code of weighted aligned expressions.

        Args:
            aligned: Weights of the 60 aligned expressions, [..., 60].
            offset: Added to the code, [..., Y], or None.
            expression: Head-model coefficients, [..., E]; only read, and then needed, without residuals (eq. 21).

        Returns:
            z_exp = offset + sum_k aligned_k Z_k, [..., Y].
        """
        if self.aligned_codes is None:
            if expression is None:
                raise ConfigError("This model has no residual codes; give the expression coefficients.")
            return expression if offset is None else expression + offset
        code = aligned @ self.aligned_codes
        return code if offset is None else code + offset

    # --- mesh ------------------------------------------------------------------------------------------------------

    def displacement(self, z_id: Tensor, z_exp: Tensor, neck: Tensor, jaw: Tensor, alpha_exp: Tensor) -> Tensor:
        """Learned displacement of the unposed vertices, eq. 5-11.

        Args:
            z_id: [B, Z].
            z_exp: [B, Y].
            neck: Axis-angle vectors, radians, [B, 3] (see `euler_to_rotvec`).
            jaw: As `neck`.
            alpha_exp: Expression coefficients, [B, E].

        Returns:
            [B, V, 3] metres.
        """
        displacement: Tensor = self.mesh_decoder(z_id, z_exp, neck, jaw, alpha_exp)
        return displacement

    def vertices(self, shape: Tensor, expression: Tensor, pose: Tensor, displacement: Tensor | None = None) -> Tensor:
        """Posed vertices v_d.

        Args:
            shape: [B, S].
            expression: [B, E].
            pose: XYZ Euler angles of the five joints, radians, [B, 5, 3].
            displacement: Added before skinning, [B, V, 3] metres, or None.

        Returns:
            [B, V, 3] metres.
        """
        posed: Tensor = self.head(shape, expression, pose, displacement)[0]
        return posed

    # --- Gaussians -------------------------------------------------------------------------------------------------

    def offsets(self, z_id: Tensor, z_exp: Tensor) -> Tensor:
        """Phi_T: offsets of position, rotation, log scale from z_id [Z] and z_exp [Y], [N, 10]. Changes with expression."""
        return self.decoders.transform_offsets(z_id, z_exp)

    def geometry(self, vertices: Tensor, offsets: Tensor) -> Geometry:
        """Place the Gaussians on posed vertices [V, 3] with offsets [N, 10] (eq. 12)."""
        c = self.config
        return self.anchor.place(
            vertices, offsets, c.position_unit_mm * METRES_PER_MM, c.position_limit_mm * METRES_PER_MM,
            c.scale_log_limit, c.texel_scale, c.normal_scale,
        )  # fmt: skip

    def opacity(self, z_id: Tensor) -> Tensor:
        """Phi_alpha: opacities 0..1 from z_id [Z], [N]. Constant per avatar."""
        return self.decoders.opacities(z_id)

    def appearance(self, z_id: Tensor, view: Tensor) -> tuple[Tensor, Tensor]:
        """Phi_app: display sRGB [N, 3] and features [N, F] from z_id [Z] and the unit view direction [3]."""
        return self.decoders.colors(z_id, view)

    def gaussians(self, vertices: Tensor, z_id: Tensor, z_exp: Tensor, view: Tensor) -> Gaussians:
        """All attributes at once for posed vertices [V, 3], z_id [Z], z_exp [Y] and the unit view direction [3]."""
        return self._assemble(self.geometry(vertices, self.offsets(z_id, z_exp)), z_id, z_exp, view)

    def expression_colors(self, z_id: Tensor, z_exp: Tensor) -> Tensor:
        """What z_exp [Y] adds to the colors of z_id [Z]: wrinkles and blood, display sRGB, [N, 3] or a row of zeros."""
        return self.decoders.expression_colors(z_id, z_exp)

    def _assemble(self, geometry: Geometry, z_id: Tensor, z_exp: Tensor, view: Tensor) -> Gaussians:
        colors, features = self.appearance(z_id, view)
        colors = colors + self.expression_colors(z_id, z_exp)
        return Gaussians(
            means=geometry.means, quats=geometry.quats, scales=geometry.scales, opacities=self.opacity(z_id),
            colors=colors, features=features if self.config.features else None,
        )  # fmt: skip

    # --- pictures --------------------------------------------------------------------------------------------------

    def refine(self, raster: RasterOutput, limits: Tensor | None = None, coarse: bool = False) -> Tensor:
        """Psi_ref (eq. 14) on a picture that was rasterised over black.

        Args:
            raster: Rasterised colors (background black), alpha, depth, features.
            limits: Depths in metres that become 0 and 1, [2]; those of the covered pixels when None. Give the range of the
                whole picture when only a part of it is drawn, or the range at each pixel, [2, H, W].
            coarse: For previews: look at half the resolution, which takes a quarter of the time; the change is enlarged.

        Returns:
            Refined colors premultiplied over black, [H, W, 3]; unchanged without a refinement network.
        """
        if self.refinement is None:
            return raster.rgb
        if limits is None:
            limits = depth_range(raster.depth, raster.alpha)
        depth = normalise_depth(raster.depth, raster.alpha, limits)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.half_refinement):
            if coarse:
                return self._refine_coarsely(raster, depth)
            refined: Tensor = self.refinement(raster.rgb, raster.features, depth, raster.alpha)
        return refined

    def _refine_coarsely(self, raster: RasterOutput, depth: Tensor) -> Tensor:
        parts = [raster.rgb, depth[..., None], raster.alpha[..., None]]
        if raster.features is not None:
            parts.append(raster.features)
        small = halved(torch.cat(parts, -1))
        rgb, small_depth, alpha, features = small[..., :3], small[..., 3], small[..., 4], small[..., 5:]
        refined = self.refinement(rgb, features if raster.features is not None else None, small_depth, alpha)
        # The network's change is a residual times alpha. Enlarging both keeps the residual whole across the silhouette.
        enlarged = doubled(torch.cat([refined - rgb, alpha[..., None]], -1), *raster.alpha.shape)
        residual = enlarged[..., :3] / enlarged[..., 3:].clamp(min=_THIN_COVER)
        return raster.rgb + raster.alpha[..., None] * residual

    def view_direction(self, camera: Camera) -> Tensor:
        """The paper's d: unit vector from the head's centre to a camera given in head space, [3]."""
        return torch.as_tensor(camera.view_direction(np.array(HEAD_CENTRE)), dtype=self.dtype, device=self.device)

    def render(
        self,
        camera: Camera,
        *,
        shape: Tensor,
        expression: Tensor,
        pose: Tensor,
        z_id: Tensor,
        z_exp: Tensor,
        background: Sequence[float] | Tensor | None = None,
        refine: bool = True,
        backend: str = "auto",
        strength: float = 1.0,
    ) -> Rendering:
        """Draw one head, differentiably.

        Args:
            camera: In head space.
            shape: [S].
            expression: Head-model coefficients alpha_exp, [E].
            pose: XYZ Euler angles of the five joints, radians, [5, 3].
            z_id: [Z].
            z_exp: [Y]; see `z_expression`.
            background: Display sRGB behind the head, [3]; black when None.
            refine: Run the refinement network.
            backend: Rasteriser backend.
            strength: Factor of the learned displacement.

        Raises:
            ShapeError: A code has the wrong length.
            BackendError: The rasteriser backend is not available.
        """
        for name, code, size in (("z_id", z_id, self.z_id_size), ("z_exp", z_exp, self.z_exp_size)):
            if code.shape != (size,):
                raise ShapeError(f"{name} has shape {tuple(code.shape)}; this model takes ({size},).")
        turns = euler_to_rotvec(pose[[NECK, JAW]])  # [2, 3]
        displacement = self.displacement(z_id[None], z_exp[None], turns[:1], turns[1:], expression[None]) * strength
        vertices = self.vertices(shape[None], expression[None], pose[None], displacement)[0]
        offsets = self.offsets(z_id, z_exp)
        gaussians = self._assemble(self.geometry(vertices, offsets), z_id, z_exp, self.view_direction(camera))
        raster = rasterize(gaussians, camera, backend=backend)
        refined = self.refine(raster) if refine else raster.rgb
        behind = 0.0
        if background is not None:
            color = torch.as_tensor(background, dtype=refined.dtype, device=refined.device)
            behind = (1.0 - raster.alpha)[..., None] * color
        return Rendering(
            refined + behind, raster.rgb + behind, raster.alpha, raster.depth, gaussians, offsets, vertices, displacement[0]
        )


def face_mask(head: HeadModel) -> Tensor:
    """M_face of eq. 11: 0 on teeth vertices, 1 elsewhere, [V]."""
    mask = np.ones(len(head.v_template), np.float32)
    for name in TEETH_REGIONS:
        if name in head.regions:
            mask[head.regions[name]] = 0.0
    return torch.from_numpy(mask)


def euler_to_rotvec(euler: Tensor) -> Tensor:
    """Axis-angle vectors of XYZ Euler angles (R = Rz Ry Rx), radians, [..., 3] to [..., 3]; smooth at zero."""
    cx, cy, cz = torch.cos(euler / 2).unbind(-1)
    sx, sy, sz = torch.sin(euler / 2).unbind(-1)
    w = cz * cy * cx + sz * sy * sx
    axis = torch.stack([cz * cy * sx - sz * sy * cx, cz * sy * cx + sz * cy * sx, sz * cy * cx - cz * sy * sx], -1)
    axis = torch.where(w[..., None] < 0, -axis, axis)  # the shorter way round
    w = w.abs()
    square = axis.square().sum(-1)
    small = square < _SMALL_ANGLE**2
    length = torch.where(small, torch.ones_like(square), square).sqrt()  # no square root of zero in the gradient
    factor = torch.where(small, 2.0 / w.clamp(min=0.5), 2.0 * torch.atan2(length, w) / length)
    return axis * factor[..., None]
