"""`PlainModel`: the model's inference in numpy, numba and onnxruntime, from the same weights files as `model.grmm.GRMM`.

It answers what a session asks of a model: opacity, appearance, offsets and color changes of codes, the displacement of the
mesh, where the Gaussians are on posed vertices, and the refined picture. Every method is held to its torch twin by the tests.

Used by the session without torch. May not import torch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..controls.names import JOINT_NAMES
from ..files.packing import unpack
from ..geometry.rotations import euler_to_axis_angle, euler_to_matrix
from ..head.skinning import posed_vertices
from ..model.config import BASIS_COLOR, BASIS_GROUPS, COLOR_CHANNELS, METRES_PER_MM, TRANSFORM_CHANNELS
from ..model.inputs import InputSpace, ModelInputs
from ..model.layout import CompressedRows, anchor_tables, compressed_rows, map_reader
from ..model.lip_line import lip_line, redrawn
from ..model.parameters import EXPRESSION_MAPS, code_sizes
from ..model.steps import Geometry, Mesh, Rest, depth_range, face_mask, normalise_depth, refinement_grid
from ..model.weights_file import WeightsFile
from ..splat.types import RasterOutput
from .onnx_networks import SLOPE, Network, map_decoder, refinement

_NECK, _JAW = JOINT_NAMES.index("neck"), JOINT_NAMES.index("jaw")
_PARTS = {"position": slice(0, 3), "rotation": slice(3, 7), "scale": slice(7, 10)}  # of the offsets
_ROWS_MIN = 16  # of a picture, in a task of a thread
_THIN_COVER = 1e-6  # keeps the division by an enlarged alpha defined; where that is 0, so is alpha itself


class PlainModel:
    """A trained model on a head, ready to be asked.

    Args:
        file: Trained numbers with their configuration, head and texels.
        threads: Threads of the networks; None leaves it to onnxruntime.
        like: Another model of the same weights, whose networks and tables serve where parameters are the same.
    """

    def __init__(self, file: WeightsFile, threads: int | None = None, like: PlainModel | None = None) -> None:
        self.head_model = file.head
        self.config = config = file.info.config
        self.layout = file.layout
        self.z_id_size, self.z_exp_size = code_sizes(config, file.head)
        self._file, self._threads = file, threads
        names = {name: f"decoders.{name}." for name in ("transform", "opacity", "appearance")}
        names |= {"refinement": "refinement."} if config.refine else {}
        self._networks = {name: self._network(name, prefix, like) for name, prefix in names.items()}
        self._sums: dict[str, tuple[bytes, np.ndarray]] = {}  # of basis maps and means: the last code and what it gave
        self._lip_line = lip_line(file.head, file.layout) if config.lip_line else None
        self._empty = file.layout.on_lash_cards(file.head) if config.hairless else np.zeros(0, np.int64)
        self._tables: _Tables = _Tables(file) if like is None else like._tables

    def changed(self, deltas: Mapping[str, np.ndarray]) -> PlainModel:
        """Return a model whose parameters have an avatar's changes added (eq. 20's result)."""
        arrays, packed = dict(self._file.arrays), dict(self._file.packed)
        for name, delta in deltas.items():
            before: Any = unpack(*packed.pop(name)) if name in packed else arrays.get(name, 0.0)
            arrays[name] = (before + delta).astype(np.float32)
        return PlainModel(replace(self._file, arrays=arrays, packed=packed), self._threads, self)

    def _network(self, name: str, prefix: str, like: PlainModel | None) -> Network:
        arrays = self._file.arrays
        if like is not None and all(like._file.arrays[key] is arrays[key] for key in arrays if key.startswith(prefix)):
            return like._networks[name]
        if name == "refinement":
            return Network(refinement(arrays, self.config), self._threads)
        return Network(map_decoder(arrays, f"decoders.{name}", self.config, name == "appearance"), self._threads)

    @property
    def gaussian_count(self) -> int:
        """Active texels N."""
        return len(self.layout)

    def input_space(self) -> InputSpace:
        """What persons and controls are added up in."""
        return InputSpace(self.head_model, self.z_id_size, self.z_exp_size, self._file.arrays.get("aligned_codes"))

    def texels(self) -> np.ndarray:
        """Flat index row * grid + column of each Gaussian's texel, [N]."""
        return self.layout.texel

    # --- decoders --------------------------------------------------------------------------------------------------

    def offsets(self, z_id: np.ndarray, z_exp: np.ndarray) -> np.ndarray:
        """Phi_T: offsets of position, rotation, log scale from z_id [Z] and z_exp [Y], [N, 10]."""
        return self._decode("transform", self._person_offsets(z_id), np.concatenate([z_id, z_exp])[None])

    def opacity(self, z_id: np.ndarray) -> np.ndarray:
        """Phi_alpha: opacities 0..1 from z_id [Z], [N]; where strands are the lashes, nothing stands on their cards."""
        logits = self._decode("opacity", self._mean("opacity", 1), z_id[None])
        added = self._basis("opacity", z_id)
        if added is not None:
            logits += added
        opacity: np.ndarray = (1.0 / (1.0 + np.exp(-(logits[:, 0] + np.float32(self.config.opacity_bias))))).astype(np.float32)
        opacity[self._empty] = 0.0
        return opacity

    def appearance(self, z_id: np.ndarray, view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Phi_app: display sRGB [N, 3] and features [N, F] from z_id [Z] and the unit view direction [3]."""
        channels = COLOR_CHANNELS + self.config.features
        values = self._decode("appearance", self._mean("appearance", channels), z_id[None], view[None])
        colors = np.ascontiguousarray(values[:, :COLOR_CHANNELS])
        added = self._basis(BASIS_COLOR, z_id)
        if added is not None:
            colors += added
        return redrawn(colors, self._lip_line), redrawn(np.ascontiguousarray(values[:, COLOR_CHANNELS:]), self._lip_line)

    def expression_colors(self, z_id: np.ndarray, z_exp: np.ndarray) -> np.ndarray:
        """What z_exp [Y] adds to the colors of z_id [Z], display sRGB, [N, 3] or a row of zeros."""
        arrays = self._file.arrays
        if not self.config.expression_maps:
            return np.zeros((1, COLOR_CHANNELS), np.float32)
        gains = 1.0 + arrays["decoders.expression.gains.weight"] @ z_id
        return self._weighted(EXPRESSION_MAPS, (arrays["decoders.expression.weights.weight"] @ z_exp) * gains)

    def _decode(self, name: str, base: np.ndarray, *inputs: np.ndarray) -> np.ndarray:
        """What a network adds to a base [N, channels], as a new array."""
        from ..compute.threads import for_rows
        from .loops import add_product

        values = base.copy()
        decoded = self._networks[name](*(np.ascontiguousarray(part, np.float32) for part in inputs))
        for_rows(add_product, len(values), *_parts_of(self._tables.reader), decoded, values)
        return values

    def _mean(self, name: str, channels: int) -> np.ndarray:
        mean = self._file.arrays.get(f"decoders.{name}_mean")
        return np.zeros((len(self.layout), channels), np.float32) if mean is None else mean

    def _person_offsets(self, z_id: np.ndarray) -> np.ndarray:
        """Offsets of a person without what the network adds, [N, 10]: the mean and the basis maps."""
        code = z_id.tobytes()
        known = self._sums.get("transform")
        if known is None or known[0] != code:
            values = self._mean("transform", TRANSFORM_CHANNELS).copy()
            for name, part in _PARTS.items():
                added = self._basis(name, z_id)
                if added is not None:
                    values[:, part] += added
            known = self._sums["transform"] = code, values
        return known[1]

    def _basis(self, name: str, z_id: np.ndarray) -> np.ndarray | None:
        if not self.config.basis_maps or name not in self.config.basis_channels:
            return None
        # A person's maps stay the same while an expression plays, and adding them up is most of decoding.
        code = z_id.tobytes()
        known = self._sums.get(name)
        if known is None or known[0] != code:
            weights = self._file.arrays["decoders.basis_weights.weight"] @ z_id
            known = self._sums[name] = code, self._weighted(f"decoders.basis.{name}", weights, BASIS_GROUPS[name])
        return known[1]

    def _weighted(self, name: str, weights: np.ndarray, channels: int = COLOR_CHANNELS) -> np.ndarray:
        """Sum of the maps of a name, [N, channels]."""
        from ..compute.threads import for_rows
        from .loops import add_maps, add_packed_maps

        result = np.zeros(len(self.layout) * channels, np.float32)
        weights = weights.astype(np.float32)
        if name in self._file.packed:
            for_rows(add_packed_maps, len(result), weights, *self._file.packed[name], result)
        else:
            for_rows(add_maps, len(result), weights, self._file.arrays[name], result)
        return result.reshape(-1, channels)

    # --- mesh ------------------------------------------------------------------------------------------------------

    def rest(self, shape: np.ndarray) -> Rest[np.ndarray]:
        """The shaped head before expression and pose from coefficients [S]."""
        return Rest(self.head_model.shaped(shape), np.asarray(self.head_model.joints(shape), np.float32))

    def mesh(self, inputs: ModelInputs[np.ndarray], rest: Rest[np.ndarray] | None = None) -> Mesh[np.ndarray]:
        """Posed mesh with the learned displacement, eq. 5-11; see `GRMM.mesh`."""
        head = self.head_model
        rest = self.rest(inputs.shape) if rest is None else rest
        displacement = self._displacement(inputs) * np.float32(inputs.strength)
        used = len(inputs.expression)
        unposed = rest.vertices + head.expression_dirs[:, :, :used] @ inputs.expression + displacement
        rotations = euler_to_matrix(inputs.pose)
        vertices = posed_vertices(unposed, rotations, rest.joints, head.weights, self._tables.parents, head.posedirs)
        return Mesh(vertices.astype(np.float32), displacement)

    def _displacement(self, inputs: ModelInputs[np.ndarray]) -> np.ndarray:
        """Learned displacement of the unposed vertices, eq. 5-11, [V, 3] metres."""
        turns = euler_to_axis_angle(inputs.pose[[_NECK, _JAW]]).astype(np.float32)  # [2, 3]
        base = np.concatenate([inputs.z_id, *turns])
        for layer in ("shared.0", "shared.2"):
            base = _rectified(self._linear(layer, base))
        coefficients = np.zeros(self.config.alpha_exp, np.float32)
        used = min(len(coefficients), len(inputs.expression))
        coefficients[:used] = inputs.expression[:used]
        features = np.concatenate([base, inputs.z_exp])  # eq. 7
        gamma, beta = np.split(self._linear("film.2", _rectified(self._linear("film.0", coefficients))), 2)  # eq. 8
        modulated = features + gamma * features + beta  # eq. 9
        identity, expression = (
            self._linear(f"{name}.2", _rectified(self._linear(f"{name}.0", values))).reshape(-1, 3)
            for name, values in (("identity", base), ("expression", modulated))
        )
        moved: np.ndarray = (identity + self._tables.face_mask * expression) * np.float32(METRES_PER_MM)
        return moved

    def _linear(self, name: str, x: np.ndarray) -> np.ndarray:
        arrays = self._file.arrays
        result: np.ndarray = arrays[f"mesh_decoder.{name}.weight"] @ x + arrays[f"mesh_decoder.{name}.bias"]
        return result

    # --- Gaussians and pictures ------------------------------------------------------------------------------------

    def geometry(self, vertices: np.ndarray, offsets: np.ndarray) -> Geometry[np.ndarray]:
        """Place the Gaussians on posed vertices [V, 3] with offsets [N, 10] (eq. 12)."""
        from ..compute.threads import for_rows
        from ..model.placing import place_forward

        placed = Geometry(*(np.empty((len(offsets), width), np.float32) for width in (3, 4, 3)))
        tables = self._tables
        where = (self._corners(vertices), tables.texel_corners, self.layout.barycentric)
        for_rows(place_forward, len(offsets), *where, offsets, tables.placing, *placed)
        return placed

    def normals(self, vertices: np.ndarray) -> np.ndarray:
        """Outward unit normals of the mesh at the texels, [N, 3], for posed vertices [V, 3]."""
        flat = np.zeros((len(self.layout), TRANSFORM_CHANNELS), np.float32)
        w, x, y, z = self.geometry(vertices, flat).quats.T
        return np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], -1)

    def _corners(self, vertices: np.ndarray) -> np.ndarray:
        from ..compute.threads import for_rows
        from .loops import uv_corners

        tables = self._tables
        corners = np.empty((len(tables.corner_vertex), 9), np.float32)
        vertices = np.ascontiguousarray(vertices, np.float32)
        where = (vertices, tables.corner_vertex, tables.outward)
        for_rows(uv_corners, len(corners), *_parts_of(tables.jacobian), *where, corners)
        return corners

    def refine(
        self, raster: RasterOutput[np.ndarray], limits: np.ndarray | None = None, coarse: bool = False,
        cover: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Psi_ref (eq. 14) on a picture that was rasterised over black; see `GRMM.refine`."""
        rgb, alpha, far = np.asarray(raster.rgb), np.asarray(raster.alpha), np.asarray(raster.depth)
        there = self.config.features and raster.features is not None
        features = np.asarray(raster.features) if there else np.zeros((*alpha.shape, 0), np.float32)
        if "refinement" not in self._networks:
            return rgb
        if limits is None:
            limits = depth_range(far, alpha)
        depth = normalise_depth(far, alpha, limits)
        cover = alpha if cover is None else np.asarray(cover)
        if not coarse:
            return self._refined(rgb, features, depth, cover)
        from ..compute.threads import for_rows
        from .coarse_loops import enlarge, halve

        rows, columns = (-(-size // 2) for size in alpha.shape)
        small = np.empty((rows, columns, 5 + features.shape[2]), np.float32)
        for_rows(halve, rows, rgb, depth, alpha, features, small, smallest=_ROWS_MIN)
        halves = small[..., 5:] if raster.halves is None else np.asarray(raster.halves)
        refined = self._refined(small[..., :3], halves, small[..., 3], small[..., 4])
        # The network's change is a residual times alpha. Enlarging both keeps the residual whole across the silhouette.
        refined -= small[..., :3]
        larger = np.empty(rgb.shape, np.float32)
        for_rows(enlarge, len(rgb), refined, small[..., 4], rgb, cover, np.float32(_THIN_COVER), larger, smallest=_ROWS_MIN)
        return larger

    def _refined(self, rgb: np.ndarray, features: np.ndarray, depth: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """The network on rgb [H, W, 3], features [H, W, F], depth and cover [H, W] of any size."""
        from ..compute.threads import for_rows
        from .loops import fold_pixels, unfold_residual

        fold, grid = self.config.refine_unshuffle, refinement_grid(self.config)
        rows, columns = (-(-size // grid) * grid // fold for size in alpha.shape)
        weight, bias = (self._file.arrays[f"refinement.entry.{name}"].copy() for name in ("weight", "bias"))
        weight = np.pad(weight, ((0, 0), (0, -weight.shape[1] % 4)))
        entered = np.empty((1, len(weight), rows, columns), np.float32)
        options = fold, weight, bias, np.float32(SLOPE), entered[0]
        for_rows(fold_pixels, rows, rgb, features, depth, *options, smallest=_ROWS_MIN)
        residual = self._networks["refinement"](entered)[0]
        refined = np.empty(rgb.shape, np.float32)
        for_rows(unfold_residual, len(rgb), rgb, alpha, residual, fold, refined, smallest=_ROWS_MIN)
        return refined


class _Tables:
    """Constant tables of a model's layout and head."""

    def __init__(self, file: WeightsFile) -> None:
        config, head, layout = file.info.config, file.head, file.layout
        side = config.decoder_grid
        self.reader = compressed_rows(map_reader(layout.texel, config.grid, side), (len(layout), side * side))
        anchor = anchor_tables(layout, head.faces, head.uv_faces)
        self.jacobian = compressed_rows(anchor.jacobian, (2 * len(layout.uv), head.vertex_count))
        self.outward = np.ascontiguousarray(anchor.outward[:, 0])
        self.corner_vertex, self.texel_corners = anchor.corner_vertex, anchor.texel_corners
        self.face_mask = face_mask(head)[:, None]
        self.parents = tuple(int(parent) for parent in head.parents)
        unit, limit = config.position_unit_mm * METRES_PER_MM, config.position_limit_mm * METRES_PER_MM
        scales = config.texel_scale / config.grid, config.normal_scale / config.grid
        self.placing = tuple(map(np.float32, (unit, limit, config.scale_log_limit or 0.0, *scales)))


def _parts_of(matrix: CompressedRows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return matrix.starts, matrix.columns, matrix.values


def _rectified(x: np.ndarray) -> np.ndarray:
    return np.where(x < 0, x * np.float32(SLOPE), x)
