"""`GRMM`: the paper's model, from `ModelInputs` to a picture (eq. 4-14).

    inputs -> mesh -> Gaussians (attributes, placed on the mesh) -> picture

The steps are separate methods, so that callers compute only what changed: opacity is constant per avatar, appearance per
avatar and view, offsets per expression, geometry per pose. `render` composes all of them. Training, fitting, evaluation,
benchmark, portraits and sessions draw with these steps; what sessions add (strands, light, furrows, catchlights) is theirs.

Batches as in `inputs`: [..., K] with any leading dimensions, up to the rasteriser.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from ..controls.names import ALIGNED_NAMES, JOINT_NAMES
from ..errors import ConfigError, ShapeError
from ..geometry.camera import Camera
from ..geometry.libraries import to_numpy
from ..geometry.tensor_rotations import euler_to_rotvec
from ..head.torch_head import TorchHead
from ..light.resting import Texels
from ..light.tones import Tones
from ..light.turning import turned_shade
from ..splat import Gaussians, RasterOutput, rasterize
from .config import METRES_PER_MM, GRMMConfig
from .decoders import AttributeDecoders
from .focus import focused_uv
from .inputs import InputSpace, ModelInputs, expression_code, identity_code
from .layout import TexelLayout, texel_layout
from .lip_line import LipLine, lip_line, redrawn
from .mesh_decoder import MeshDecoder
from .refine import RefinementNetwork
from .steps import HEAD_CENTRE, Geometry, Mesh, Rest, face_mask
from .texels import TexelAnchor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..head import HeadModel

NECK, JAW = JOINT_NAMES.index("neck"), JOINT_NAMES.index("jaw")
NO_OPACITY = -30.0  # logit
CODE_INIT = 0.1  # standard deviation of the table of expression codes before training


@dataclass(frozen=True)
class Attributes:
    """What the decoders say about the Gaussians, before they are placed on a mesh.

    Attributes:
        offsets: Position, rotation, log scale before limits, [..., N, 10].
        logits: Of the opacities, [..., N].
        colors: Display sRGB, [..., N, 3].
        features: [..., N, F].
    """

    offsets: Tensor
    logits: Tensor
    colors: Tensor
    features: Tensor

    def detached(self) -> Attributes:
        """The same without gradients."""
        return Attributes(self.offsets.detach(), self.logits.detach(), self.colors.detach(), self.features.detach())

    def recolored(self, colors: Tensor) -> Attributes:
        """The same with other colors [..., N, 3]."""
        return replace(self, colors=colors)


@dataclass(frozen=True)
class Picture:
    """A picture of one head.

    Attributes:
        image: I of eq. 14, refined, premultiplied, [H, W, 3].
        raw: I_rgb of eq. 13, premultiplied, [H, W, 3].
        alpha: Coverage, [H, W].
        depth: Expected depth in metres, 0 where nothing is, [H, W].
    """

    image: Tensor
    raw: Tensor
    alpha: Tensor
    depth: Tensor

    def over(self, background: Sequence[float] | Tensor) -> Picture:
        """The same over a color, display sRGB [3]."""
        color = torch.as_tensor(background, dtype=self.image.dtype, device=self.image.device)
        behind = (1.0 - self.alpha)[..., None] * color
        return replace(self, image=self.image + behind, raw=self.raw + behind)

    def detached(self) -> Picture:
        """The same without gradients."""
        return Picture(self.image.detach(), self.raw.detach(), self.alpha.detach(), self.depth.detach())


@dataclass(frozen=True)
class Rendering(Picture):
    """A picture with what led to it.

    Attributes:
        inputs: What was drawn.
        mesh: The posed mesh.
        offsets: Decoded offsets before limits, [N, 10].
        gaussians: What was splatted.
    """

    inputs: ModelInputs[Tensor]
    mesh: Mesh
    offsets: Tensor
    gaussians: Gaussians


class GRMM(nn.Module):
    """Gaussian Residual Morphable Model on a head model.

    Args:
        head: Mesh model.
        config: Sizes.
        layout: Active texels that trained maps belong to; found when None: on the head's UV map, or on
            the focused one.

    Raises:
        ConfigError: The head lacks what the configuration needs.
    """

    aligned_codes: nn.Parameter | None
    empty_texels: Tensor

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
        if layout is None:
            layout = texel_layout(focused_uv(head) if config.focus else head.uv, head.uv_faces, config.grid)
        if layout.grid != config.grid:
            raise ConfigError(f"The texel layout has a grid of {layout.grid}; the configuration says {config.grid}.")
        self.layout = layout
        empty = layout.on_lash_cards(head) if config.hairless else np.zeros(0, np.int64)
        self.register_buffer("empty_texels", torch.tensor(empty, device="cpu"), persistent=False)
        self.anchor = TexelAnchor(layout, head.faces, head.uv_faces, vertex_count, config.focus)
        self.mesh_decoder = MeshDecoder(config, self.z_id_size, self.z_exp_size, torch.from_numpy(face_mask(head)))
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

    # --- inputs ----------------------------------------------------------------------------------------------------

    def input_space(self) -> InputSpace:
        """What persons and controls are added up in; holds a copy of the table of codes as it is now."""
        codes = None if self.aligned_codes is None else self.aligned_codes.detach().float().cpu().numpy().copy()
        return InputSpace(self.head_model, self.z_id_size, self.z_exp_size, codes)

    def tensors(self, inputs: ModelInputs[np.ndarray]) -> ModelInputs[Tensor]:
        """The same inputs as tensors like the model's."""
        return inputs.mapped(lambda array: torch.as_tensor(array, dtype=self.dtype, device=self.device))

    def performed(
        self, z_id: Tensor, shape: Tensor, expression: Tensor, pose: Tensor, aligned: Tensor, offset: Tensor | None = None
    ) -> ModelInputs[Tensor]:
        """Inputs of a captured or tracked frame, differentiable in all of them and in the table of codes.

        Args:
            z_id: Identity code, [..., Z]; not read without residuals.
            shape: [..., S].
            expression: [..., E].
            pose: All parts included, [..., 5, 3] radians.
            aligned: Weights of the 60 aligned expressions, [..., 60].
            offset: Added to the expression code, [..., Y], or None; not read without residuals.
        """
        z_exp = self.z_expression(aligned, offset, expression)
        return ModelInputs(self.z_identity(z_id, shape), z_exp, shape, expression, pose)

    def z_identity(self, z_id: Tensor, shape: Tensor) -> Tensor:
        """See `inputs.identity_code`."""
        return identity_code(self.aligned_codes, z_id, shape)

    def z_expression(self, aligned: Tensor, offset: Tensor | None = None, expression: Tensor | None = None) -> Tensor:
        """See `inputs.expression_code`."""
        return expression_code(self.aligned_codes, aligned, offset, expression)

    # --- mesh ------------------------------------------------------------------------------------------------------

    def rest(self, shape: Tensor) -> Rest:
        """The shaped head before expression and pose from coefficients [..., S]: most of the arithmetic of a mesh."""
        return Rest(self.head.shaped(shape), self.head.joints(shape))

    def mesh(self, inputs: ModelInputs[Tensor], rest: Rest | None = None) -> Mesh:
        """Posed mesh with the learned displacement, eq. 5-11.

        Args:
            inputs: Codes, coefficients, pose.
            rest: `rest` of the shape, where the caller has it already.
        """
        rest = self.rest(inputs.shape) if rest is None else rest
        displacement = self.displacement(inputs)
        unposed = rest.vertices + self.head.expression_offsets(inputs.expression) + displacement
        return Mesh(self.head.posed(unposed, inputs.pose, rest.joints), displacement)

    def displacement(self, inputs: ModelInputs[Tensor]) -> Tensor:
        """Learned displacement of the unposed vertices times the strength, [..., V, 3] metres."""
        turns = euler_to_rotvec(inputs.pose[..., [NECK, JAW], :])  # [..., 2, 3]
        learned: Tensor = self.mesh_decoder(inputs.z_id, inputs.z_exp, turns[..., 0, :], turns[..., 1, :], inputs.expression)
        return learned * inputs.strength

    def vertices(self, shape: Tensor, expression: Tensor, pose: Tensor) -> Tensor:
        """Posed vertices of the head model alone, without anything learned.

        Args:
            shape: [..., S].
            expression: [..., E].
            pose: XYZ Euler angles of the five joints, radians, [..., 5, 3].

        Returns:
            [..., V, 3] metres.
        """
        posed: Tensor = self.head(shape, expression, pose)[0]
        return posed

    # --- Gaussians -------------------------------------------------------------------------------------------------

    def offsets(self, z_id: Tensor, z_exp: Tensor) -> Tensor:
        """Phi_T: offsets of position, rotation, log scale from z_id [..., Z] and z_exp [..., Y], [..., N, 10]."""
        return self.decoders.transform_offsets(z_id, z_exp)

    def opacity(self, z_id: Tensor) -> Tensor:
        """Phi_alpha: opacities 0..1 from z_id [..., Z], [..., N]. Constant per avatar."""
        return torch.sigmoid(self.opacity_logits(z_id))

    def opacity_logits(self, z_id: Tensor) -> Tensor:
        """Opacities before the sigmoid, [..., N]; where strands are the lashes, nothing stands on their cards."""
        return self.decoders.opacity_logits(z_id).index_fill(-1, self.empty_texels, NO_OPACITY)

    def appearance(self, z_id: Tensor, view: Tensor) -> tuple[Tensor, Tensor]:
        """Phi_app: display sRGB [..., N, 3] and features [..., N, F] from z_id [..., Z] and unit view directions [..., 3]."""
        colors, features = self.decoders.colors(z_id, view)
        return redrawn(colors, self.lip_line), redrawn(features, self.lip_line)

    @functools.cached_property
    def lip_line(self) -> LipLine[Tensor] | None:
        """How the borders of lips are redrawn; None for models without `lip_line`."""
        line = lip_line(self.head_model, self.layout) if self.config.lip_line else None
        with torch.inference_mode(False):  # a session may ask first, and a fit of the same model needs gradients later
            return None if line is None else LipLine(*(torch.as_tensor(array, device=self.device) for array in line))

    def expression_colors(self, z_id: Tensor, z_exp: Tensor) -> Tensor:
        """What z_exp adds to the colors of z_id: wrinkles and blood, display sRGB, [..., N, 3] or a row of zeros."""
        return self.decoders.expression_colors(z_id, z_exp)

    def attributes(self, inputs: ModelInputs[Tensor], view: Tensor) -> Attributes:
        """All that is decoded, for unit view directions [..., 3]."""
        z_id, z_exp = inputs.z_id, inputs.z_exp
        colors, features = self.appearance(z_id, view)
        colors = colors + self.expression_colors(z_id, z_exp)
        return Attributes(self.offsets(z_id, z_exp), self.opacity_logits(z_id), colors, features)

    def geometry(self, vertices: Tensor, offsets: Tensor) -> Geometry:
        """Place the Gaussians on posed vertices [..., V, 3] with offsets [..., N, 10] (eq. 12)."""
        c = self.config
        return self.anchor.place(
            vertices, offsets, c.position_unit_mm * METRES_PER_MM, c.position_limit_mm * METRES_PER_MM,
            c.scale_log_limit, c.texel_scale, c.normal_scale,
        )  # fmt: skip

    def normals(self, vertices: Tensor) -> Tensor:
        """Outward unit normals of the mesh with posed vertices [V, 3] at the Gaussians' texels, [N, 3]."""
        return self.anchor(vertices).normals

    def texels(self) -> np.ndarray:
        """Flat index row * grid + column of each Gaussian's texel, [N]."""
        flat: np.ndarray = self.anchor.texel.cpu().numpy()
        return flat

    def turned_shade(self, vertices: Tensor, pose: Tensor) -> Tensor | None:
        """What the neck's turn makes of colors in the studio's light, [N, 1], of posed vertices [V, 3]; see `light.turning`."""
        if not self.config.turned_light or not bool(pose[..., NECK, :].any()):
            return None
        shade = turned_shade(self.head_model, self.lit_texels, to_numpy(vertices), to_numpy(pose))
        return None if shade is None else torch.as_tensor(shade, dtype=self.dtype, device=self.device)

    def tone(self, vertices: Tensor) -> Tensor | None:
        """What colors of eyes and mouths are multiplied by, [N, 1 or 3], of posed vertices [V, 3]; None for nothing."""
        shade = self.tones.shade(to_numpy(vertices))
        return None if shade is None else torch.as_tensor(shade, dtype=self.dtype, device=self.device)

    @functools.cached_property
    def tones(self) -> Tones:
        """What colors that were learned lack (`eye_shade` and `mouth_tone` of the configuration)."""
        return Tones.of(self.head_model, self.lit_texels, self.config.eye_shade, self.config.mouth_tone)

    @functools.cached_property
    def lit_texels(self) -> Texels:
        """Where the Gaussians are on the mesh, as light needs it."""
        return Texels.of(self.head_model, self.layout.face, self.layout.barycentric)

    def gaussians(self, vertices: Tensor, attributes: Attributes) -> Gaussians:
        """Place decoded attributes on the posed vertices [V, 3] of one head, its colors with what they lack (`tones`)."""
        placed = self.geometry(vertices, attributes.offsets)
        shade = self.tone(vertices)
        attributes = attributes if shade is None else attributes.recolored(attributes.colors * shade)
        features = attributes.features if self.config.features else None
        return Gaussians(*placed, torch.sigmoid(attributes.logits), attributes.colors, features)

    # --- pictures --------------------------------------------------------------------------------------------------

    def view_direction(self, camera: Camera) -> Tensor:
        """The paper's d: unit vector from the head's centre to a camera given in head space, [3]."""
        return torch.as_tensor(camera.view_direction(np.array(HEAD_CENTRE)), dtype=self.dtype, device=self.device)

    def draw(
        self, gaussians: Gaussians, camera: Camera, refine: bool = True, backend: str = "auto", limits: Tensor | None = None
    ) -> Picture:
        """Rasterise and refine one head (eq. 13, 14), over black.

        Args:
            gaussians: With the model's features; further Gaussians may be appended whose features are zero.
            camera: In head space.
            refine: Run the refinement network; without it `image` is `raw`, and the features are not even drawn.
            backend: Of the rasteriser.
            limits: See `refine`.
        """
        drawn = gaussians if refine else replace(gaussians, features=None)
        raster = rasterize(drawn, camera, backend=backend, antialiased=self.config.antialias)
        return Picture(self.refine(raster, limits) if refine else raster.rgb, raster.rgb, raster.alpha, raster.depth)

    def refine(
        self, raster: RasterOutput[Tensor], limits: Tensor | None = None, coarse: bool = False, cover: Tensor | None = None
    ) -> Tensor:
        """Psi_ref (eq. 14) on a picture that was rasterised over black.

        Args:
            raster: Rasterised colors (background black), alpha, depth, features.
            limits: Depths in metres that become 0 and 1, [2]; those of the covered pixels when None. Give the range of the
                whole picture when only a part of it is drawn, or the range at each pixel, [2, H, W].
            coarse: For previews: look at half the resolution, which takes a quarter of the time; the change is enlarged.
            cover: What the residual is multiplied by where that is not alpha: the avatar's own part of it, [H, W].

        Returns:
            Refined colors premultiplied over black, [H, W, 3]; unchanged without a refinement network.
        """
        if self.refinement is None:
            return raster.rgb
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.half_refinement):
            return self.refinement.refined(raster, limits, coarse, cover)

    def render(
        self,
        camera: Camera,
        inputs: ModelInputs[Tensor],
        background: Sequence[float] | Tensor | None = None,
        refine: bool = True,
        backend: str = "auto",
        limits: Tensor | None = None,
        lit_later: bool = False,
    ) -> Rendering:
        """Draw one head, differentiably, but for the shade of its turn.

        Args:
            camera: In head space.
            inputs: Of one frame.
            background: Display sRGB behind the head, [3]; black when None.
            refine: Run the refinement network.
            backend: Of the rasteriser.
            limits: See `refine`.
            lit_later: Leave the studio's light as it falls on a head at rest (`turned_shade`).

        Raises:
            ShapeError: A code has the wrong length.
            BackendError: The rasteriser backend is not available.
        """
        for name, code, size in (("z_id", inputs.z_id, self.z_id_size), ("z_exp", inputs.z_exp, self.z_exp_size)):
            if code.shape != (size,):
                raise ShapeError(f"{name} has shape {tuple(code.shape)}; this model takes ({size},).")
        mesh = self.mesh(inputs)
        attributes = self.attributes(inputs, self.view_direction(camera))
        shade = None if lit_later else self.turned_shade(mesh.vertices, inputs.pose)
        attributes = attributes if shade is None else attributes.recolored(attributes.colors * shade)
        gaussians = self.gaussians(mesh.vertices, attributes)
        picture = self.draw(gaussians, camera, refine, backend, limits)
        if background is not None:
            picture = picture.over(background)
        seen = (picture.image, picture.raw, picture.alpha, picture.depth)
        return Rendering(*seen, inputs, mesh, attributes.offsets, gaussians)
