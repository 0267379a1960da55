"""The parameters that a configuration has, by name and shape, without making the model.

Files of weights are checked against this before memory is allocated on their word, by every implementation of the model.
Needs numpy only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..controls.names import ALIGNED_NAMES
from .config import BASIS_GROUPS, COLOR_CHANNELS, JOINTS_OF_MESH_DECODER, TRANSFORM_CHANNELS, VIEW_CHANNELS, GRMMConfig

if TYPE_CHECKING:
    from ..head import HeadModel

Shapes = dict[str, tuple[int, ...]]
EXPRESSION_MAPS = "decoders.expression.maps"


def code_sizes(config: GRMMConfig, head: HeadModel) -> tuple[int, int]:
    """Lengths of z_id and z_exp; without residuals the coefficients take the codes' places (eq. 21)."""
    if config.residuals:
        return config.z_id, config.z_exp
    return head.shape_dirs.shape[-1], head.expression_dirs.shape[-1]


def mean_map_shapes(config: GRMMConfig, count: int) -> Shapes:
    """Mean maps of the decoders at N = `count` texels; the paper's form has none, an avatar may still bring its own."""
    widths = {"transform": TRANSFORM_CHANNELS, "opacity": 1, "appearance": COLOR_CHANNELS + config.features}
    return {f"decoders.{name}_mean": (count, width) for name, width in widths.items()}


def parameter_shapes(config: GRMMConfig, head: HeadModel, count: int) -> Shapes:
    """Return every parameter and stored buffer of `grmm.GRMM` on a head with N = `count` active texels."""
    z_id, z_exp = code_sizes(config, head)
    shapes: Shapes = {"anchor.texel": (count,), "anchor.face": (count,), "anchor.barycentric": (count, 3)}
    if config.focus:
        shapes["anchor.uv"] = head.uv.shape
    if config.residuals:
        shapes["aligned_codes"] = (len(ALIGNED_NAMES), config.z_exp)
    shapes |= _mesh_decoder(config, z_id, z_exp, 3 * len(head.v_template))
    shapes |= _map_decoder("transform", config, z_id + z_exp, TRANSFORM_CHANNELS)
    shapes |= _map_decoder("opacity", config, z_id, 1)
    shapes |= _map_decoder("appearance", config, z_id, COLOR_CHANNELS + config.features, config.view_stage)
    if config.mean_maps:
        shapes |= mean_map_shapes(config, count)
    if config.basis_maps:
        shapes["decoders.basis_weights.weight"] = (config.basis_maps, z_id)
        shapes |= {f"decoders.basis.{name}": (config.basis_maps, count * BASIS_GROUPS[name]) for name in config.basis_channels}
    if config.expression_maps:
        shapes[EXPRESSION_MAPS] = (config.expression_maps, count * COLOR_CHANNELS)
        shapes["decoders.expression.weights.weight"] = (config.expression_maps, z_exp)
        shapes["decoders.expression.gains.weight"] = (config.expression_maps, z_id)
    if config.refine:
        shapes |= _refinement(config)
    return shapes


def _layer(name: str, outputs: int, *inputs: int) -> Shapes:
    return {f"{name}.weight": (outputs, *inputs), f"{name}.bias": (outputs,)}


def _mesh_decoder(config: GRMMConfig, z_id: int, z_exp: int, outputs: int) -> Shapes:
    hidden, rank = config.mesh_hidden, config.mesh_rank or config.mesh_hidden
    shapes = _layer("mesh_decoder.shared.0", hidden, z_id + JOINTS_OF_MESH_DECODER)
    shapes |= _layer("mesh_decoder.shared.2", hidden, hidden)
    shapes |= _layer("mesh_decoder.film.0", hidden, config.alpha_exp)
    shapes |= _layer("mesh_decoder.film.2", 2 * (hidden + z_exp), hidden)
    for name, inputs in (("identity", hidden), ("expression", hidden + z_exp)):
        shapes |= _layer(f"mesh_decoder.{name}.0", rank, inputs) | _layer(f"mesh_decoder.{name}.2", outputs, rank)
    return shapes


def _map_decoder(name: str, config: GRMMConfig, inputs: int, outputs: int, view_stage: int | None = None) -> Shapes:
    start, widths = config.decoder_start, (*config.decoder_channels, outputs)
    shapes = _layer(f"decoders.{name}.first", widths[0] * start * start, inputs)
    for i in range(len(config.decoder_channels)):
        extra = VIEW_CHANNELS if start << i == view_stage else 0
        shapes[f"decoders.{name}.stages.{i}.weight"] = (widths[i] + extra, widths[i + 1], 4, 4)
        shapes[f"decoders.{name}.stages.{i}.bias"] = (widths[i + 1],)
    return shapes


def _refinement(config: GRMMConfig) -> Shapes:
    fold, widths = config.refine_unshuffle, config.refine_channels
    shapes = _layer("refinement.entry", widths[0], (COLOR_CHANNELS + config.features + 1) * fold * fold)
    shapes |= _layer("refinement.first", widths[0], widths[0], 3, 3)
    for i in range(len(widths) - 1):
        shapes |= _layer(f"refinement.down.{i}", widths[i + 1], widths[i], 3, 3)
    shapes |= _layer("refinement.middle", widths[-1], widths[-1], 3, 3)
    for i, level in enumerate(reversed(range(len(widths) - 1))):
        shapes |= _layer(f"refinement.narrow.{i}", widths[level], widths[level + 1], 1, 1)
        shapes |= _layer(f"refinement.up.{i}", widths[level], widths[level], 3, 3)
    return shapes | _layer("refinement.exit", COLOR_CHANNELS * fold * fold, widths[0], 3, 3)
