"""Phi_T, Phi_alpha and Phi_app: maps of Gaussian attributes in UV space (paper section 3.3).

Each is a `MapDecoder` of transposed convolutions. Extensions that the paper does not have, off in its configuration: maps may
end below the grid and be enlarged bilinearly; free mean maps and basis maps weighted by a linear map of z_id are added; colors
change with expression by `ExpressionMaps`, which the paper's Phi_app, a function of z_id and d, leaves out.
Values are needed at active texels only, so mean and basis maps exist only there and decoder maps are read only there.

Codes are [..., K] with any leading dimensions, which the attributes have as well (`inputs`). Used by `grmm` only.
"""

from __future__ import annotations

from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from .config import BASIS_COLOR, BASIS_GROUPS, COLOR_CHANNELS, TRANSFORM_CHANNELS, VIEW_CHANNELS, GRMMConfig
from .layout import map_reader
from .sparse import FixedSparse

SLOPE = 0.2
LAST_GAIN = 0.1  # decoders start near their mean maps
BASIS_INIT = 0.01


class MapDecoder(nn.Module):
    """A code to a map: a linear layer to the start map, then transposed convolutions of stride 2 with leaky rectifiers.

    Args:
        inputs: Length of the code.
        outputs: Channels of the map.
        start: Side of the first map.
        channels: Channels of the first map and of each following one; one more stage gives the output.
        view_stage: Side of the map to which the tiled view direction is appended, or None.
    """

    def __init__(self, inputs: int, outputs: int, start: int, channels: tuple[int, ...], view_stage: int | None = None) -> None:
        super().__init__()
        self.start = start
        self.view_stage = view_stage
        self.first = nn.Linear(inputs, channels[0] * start * start)
        widths = (*channels, outputs)
        extra = [VIEW_CHANNELS if start << i == view_stage else 0 for i in range(len(channels))]
        stages = [nn.ConvTranspose2d(widths[i] + extra[i], widths[i + 1], 4, stride=2, padding=1) for i in range(len(channels))]
        self.stages = nn.ModuleList(stages)
        self.activation = nn.LeakyReLU(SLOPE)
        nn.init.kaiming_normal_(self.first.weight, SLOPE)
        nn.init.zeros_(self.first.bias)
        for i, stage in enumerate(stages):
            # each output of a 4x4, stride 2 transposed convolution sees 4 of the 16 taps
            gain = nn.init.calculate_gain("leaky_relu", SLOPE) * (LAST_GAIN if i == len(stages) - 1 else 1.0)
            nn.init.normal_(stage.weight, std=gain / (4 * stage.in_channels) ** 0.5)
            if stage.bias is not None:
                nn.init.zeros_(stage.bias)

    @property
    def last_bias(self) -> Tensor:
        """What is added to every texel of the map, [outputs]."""
        return cast(Tensor, self.stages[-1].bias)

    def forward(self, code: Tensor, view: Tensor | None = None) -> Tensor:
        """Return the map.

        Args:
            code: [B, inputs].
            view: Unit view directions, [B, 3], where the decoder has a `view_stage`.

        Returns:
            [B, outputs, side, side].
        """
        x = self.activation(self.first(code)).view(len(code), -1, self.start, self.start)
        for i, stage in enumerate(self.stages):
            if view is not None and x.shape[-1] == self.view_stage:
                tiled = view[:, :, None, None].expand(-1, -1, *x.shape[-2:])
                x = torch.cat([x, tiled], 1)
            x = stage(x)
            if i < len(self.stages) - 1:
                x = self.activation(x)
        return x


class ExpressionMaps(nn.Module):
    """Color changes of an expression: maps weighted by z_exp, with a gain for each person.

    A furrow is a few texels of darker skin, too fine for the displacement of vertices, deep in one face and faint in another:
    weights = (A z_exp) (1 + B z_id). Nothing is added at z_exp = 0, and by an untrained model.

    Args:
        z_id, z_exp: Lengths of the codes.
        maps: Number of maps K.
        count: Texels N.
    """

    def __init__(self, z_id: int, z_exp: int, maps: int, count: int) -> None:
        super().__init__()
        self.weights = nn.Linear(z_exp, maps, bias=False)
        self.gains = nn.Linear(z_id, maps, bias=False)
        nn.init.zeros_(self.gains.weight)
        self.maps = nn.Parameter(torch.zeros(maps, count * COLOR_CHANNELS))

    def forward(self, z_id: Tensor, z_exp: Tensor) -> Tensor:
        """Return what codes z_id [..., Z] and z_exp [..., Y] add to the colors, display sRGB [..., N, 3]."""
        weights = self.weights(z_exp) * (1.0 + self.gains(z_id))  # [..., K]
        added: Tensor = (weights @ self.maps).unflatten(-1, (-1, COLOR_CHANNELS))
        return added


class AttributeDecoders(nn.Module):
    """The three decoders with mean and basis maps, read at the active texels.

    Args:
        config: Sizes.
        z_id, z_exp: Lengths of the codes.
        texel: Flat indices of the active texels, [N].
    """

    transform_mean: nn.Parameter | None
    opacity_mean: nn.Parameter | None
    appearance_mean: nn.Parameter | None

    def __init__(self, config: GRMMConfig, z_id: int, z_exp: int, texel: np.ndarray) -> None:
        super().__init__()
        count = len(texel)
        self.count = count
        self.features = config.features
        self.basis_channels = config.basis_channels
        start, channels = config.decoder_start, config.decoder_channels
        app_channels = COLOR_CHANNELS + config.features
        self.transform = MapDecoder(z_id + z_exp, TRANSFORM_CHANNELS, start, channels)
        self.opacity = MapDecoder(z_id, 1, start, channels)
        self.appearance = MapDecoder(z_id, app_channels, start, channels, config.view_stage)
        side = config.decoder_grid
        self.read = FixedSparse(map_reader(texel, config.grid, side), (count, side * side))
        self.opacity_bias = config.opacity_bias
        for name, width in (("transform", TRANSFORM_CHANNELS), ("opacity", 1), ("appearance", app_channels)):
            mean = nn.Parameter(torch.zeros(count, width)) if config.mean_maps else None
            self.register_parameter(f"{name}_mean", mean)
        if not config.mean_maps:
            with torch.no_grad():
                self.appearance.last_bias[:COLOR_CHANNELS] = 0.5  # mid grey
        self.basis = nn.ParameterDict()
        self.basis_weights: nn.Linear | None = None
        if config.basis_maps:
            self.basis_weights = nn.Linear(z_id, config.basis_maps, bias=False)
            for name in config.basis_channels:
                self.basis[name] = nn.Parameter(torch.randn(config.basis_maps, count * BASIS_GROUPS[name]) * BASIS_INIT)
        self.expression = ExpressionMaps(z_id, z_exp, config.expression_maps, count) if config.expression_maps else None

    def transform_offsets(self, z_id: Tensor, z_exp: Tensor) -> Tensor:
        """Phi_T: position, rotation and log scale offsets of each Gaussian from z_id [..., Z], z_exp [..., Y]: [..., N, 10]."""
        offsets = self._decode(self.transform, self.transform_mean, torch.cat([z_id, z_exp], -1))
        parts = {"position": slice(0, 3), "rotation": slice(3, 7), "scale": slice(7, 10)}
        added = [self._basis(name, z_id, part.stop - part.start) for name, part in parts.items()]
        if any(a is not None for a in added):
            columns = [
                offsets[..., part] if a is None else offsets[..., part] + a
                for a, part in zip(added, parts.values(), strict=True)
            ]
            offsets = torch.cat(columns, -1)
        return offsets

    def opacity_logits(self, z_id: Tensor) -> Tensor:
        """Phi_alpha: logit of the opacity of each Gaussian from z_id [..., Z]: [..., N]."""
        logits = self._decode(self.opacity, self.opacity_mean, z_id)
        added = self._basis("opacity", z_id, 1)
        logits = logits if added is None else logits + added
        return logits[..., 0] + self.opacity_bias

    def colors(self, z_id: Tensor, view: Tensor) -> tuple[Tensor, Tensor]:
        """Phi_app: display sRGB [..., N, 3] and features [..., N, F] from z_id [..., Z] and unit view directions [..., 3]."""
        values = self._decode(self.appearance, self.appearance_mean, z_id, view)
        colors, features = values[..., :COLOR_CHANNELS], values[..., COLOR_CHANNELS:]
        added = self._basis(BASIS_COLOR, z_id, COLOR_CHANNELS)
        return (colors if added is None else colors + added), features

    def expression_colors(self, z_id: Tensor, z_exp: Tensor) -> Tensor:
        """What z_exp [..., Y] adds to the `colors` of z_id [..., Z], sRGB [..., N, 3]; without expression maps zeros [1, 3]."""
        added: Tensor = z_id.new_zeros(1, COLOR_CHANNELS) if self.expression is None else self.expression(z_id, z_exp)
        return added

    def _decode(self, decoder: MapDecoder, mean: Tensor | None, code: Tensor, view: Tensor | None = None) -> Tensor:
        lead = code.shape[:-1]
        views = None if view is None else view.expand(*lead, VIEW_CHANNELS).reshape(-1, VIEW_CHANNELS)
        decoded = decoder(code.reshape(-1, code.shape[-1]), views)  # [B, C, side, side]
        values: Tensor = self.read(decoded.flatten(2).mT)  # [B, N, C]
        values = values.reshape(*lead, *values.shape[1:])
        return values if mean is None else values + mean

    def _basis(self, name: str, z_id: Tensor, width: int) -> Tensor | None:
        if self.basis_weights is None or name not in self.basis:
            return None
        return (self.basis_weights(z_id) @ self.basis[name]).unflatten(-1, (-1, width))
