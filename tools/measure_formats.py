"""`python -m tools.measure_formats`: round trips through every format that is read and written, as tables with their errors.

Prints the tables of docs/formats.md. SPZ 4 needs zstandard, reading SOG Pillow (`pip install -e .[dev]`).
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.formats import SplatCloud, read_performance, read_splats, write_mesh, write_performance, write_splats
from grmm_core.formats.avatars.gaussian_avatars import GaussianAvatar, read_gaussian_avatar, write_gaussian_avatar
from grmm_core.formats.avatars.lam import LamAvatar, read_lam, write_lam
from grmm_core.formats.meshes.gltf_mesh import read_gltf_mesh
from grmm_core.formats.meshes.mesh import Mesh
from grmm_core.formats.splats.cloud import SH_C0
from grmm_core.geometry.rotations import euler_to_matrix
from grmm_core.performance import Performance

COUNT, DEGREE, FRAMES = 20_000, 2, 300
_DEGREES = 180.0 / np.pi


def main() -> int:
    """Print the tables."""
    folder = Path(tempfile.mkdtemp(prefix="grmm-formats-"))
    cloud = _cloud()
    print(f"{COUNT} splats of a head's size, harmonics of degree {DEGREE}; largest errors\n")
    print("| file | bytes a splat | position | rotation | scale | opacity | color | harmonics |")
    print("|---|---|---|---|---|---|---|---|")
    for label, name, options in (
        (".ply", "a.ply", {}), (".splat", "a.splat", {}), (".spz 2", "a.spz", {"version": 2}), (".spz 3", "a.spz", {}),
        (".spz 4", "a.spz", {"version": 4}), (".sog", "a.sog", {}), (".glb", "a.glb", {}),
    ):  # fmt: skip
        write_splats(folder / name, cloud, **options)
        print(f"| {label} | {(folder / name).stat().st_size / COUNT:.1f} | {_row(cloud, read_splats(folder / name), name)} |")
    bound = replace(cloud, binding=np.arange(COUNT, dtype=np.int32) % 10144)
    write_gaussian_avatar(folder, GaussianAvatar(bound, None))
    found = read_gaussian_avatar(folder).cloud
    size = (folder / "point_cloud.ply").stat().st_size / COUNT
    print(f"| GaussianAvatars | {size:.1f} | {_row(bound, found, 'a.ply')} |")
    write_lam(folder / "a.zip", LamAvatar(Mesh(cloud.means, None), cloud))
    size = (folder / "a.zip").stat().st_size / COUNT
    print(f"| LAM, without its shapes | {size:.1f} | {_row(cloud, read_lam(folder / 'a.zip').cloud, 'a.zip')} |")
    _meshes(folder)
    _performances(folder)
    return 0


def _cloud() -> SplatCloud:
    rng = np.random.default_rng(0)
    sh = rng.uniform(-0.3, 0.3, (COUNT, (DEGREE + 1) ** 2, 3))
    sh[:, 0] = (rng.uniform(0.02, 0.98, (COUNT, 3)) - 0.5) / SH_C0
    scales = np.exp(rng.uniform(np.log(1e-4), np.log(0.02), (COUNT, 3)))
    means = rng.normal(0, 0.08, (COUNT, 3))
    return SplatCloud(means, rng.normal(size=(COUNT, 4)), scales, rng.uniform(0.01, 0.99, COUNT), sh).validated()


def _row(wanted: SplatCloud, reread: SplatCloud, name: str) -> str:
    if name.endswith(".splat"):  # the most visible first
        wanted = wanted.select(np.argsort(-wanted.scales.astype(np.float64).prod(1) * wanted.opacities, kind="stable"))
    sign = np.sign((wanted.quats * reread.quats).sum(1, keepdims=True))
    apart = np.linalg.norm(wanted.quats.astype(np.float64) - sign * reread.quats, axis=1)
    turn = 4.0 * np.arcsin(np.clip(apart / 2.0, 0.0, 1.0)) * _DEGREES
    terms = min(wanted.sh.shape[1], reread.sh.shape[1])
    rest = "not kept" if terms == 1 else f"{np.abs(wanted.sh[:, 1:terms] - reread.sh[:, 1:terms]).max():.2g}"
    return " | ".join(
        [
            f"{np.abs(wanted.means - reread.means).max() * 1e6:.2g} µm",
            f"{turn.max():.2g}°",
            f"{np.abs(reread.scales / wanted.scales - 1).max() * 100:.2g} %",
            f"{np.abs(wanted.opacities - reread.opacities).max():.2g}",
            f"{np.abs(wanted.colors() - reread.colors()).max():.2g}",
            rest,
        ]
    )


def _meshes(folder: Path) -> None:
    from grmm_core.head import load_open_head

    head = load_open_head()
    morphs = {name: head.expression_dirs[:, :, k] for k, name in enumerate(ARKIT_NAMES)}
    write_mesh(folder / "head.glb", head.v_template, head.faces, morphs=morphs)
    found = read_gltf_mesh(folder / "head.glb")
    error = max(np.abs(found.morphs[name] - morphs[name]).max() for name in morphs)
    print(f"\n.glb mesh of the open head: vertices {np.abs(found.vertices - head.v_template).max() * 1e6:.2g} µm, "
          f"52 morph targets {error * 1e6:.2g} µm, {(folder / 'head.glb').stat().st_size / 1e6:.1f} MB")  # fmt: skip
    write_mesh(folder / "head.obj", head.v_template, head.faces)
    rows = [line.split()[1:] for line in (folder / "head.obj").read_text().splitlines() if line.startswith("v ")]
    print(f".obj mesh: vertices {np.abs(np.array(rows, float) - head.v_template).max() * 1e6:.2g} µm\n")


def _performances(folder: Path) -> None:
    rng = np.random.default_rng(1)
    angles: dict[str, Any] = {
        name: rng.uniform(-0.5, 0.5, (FRAMES, 3)) for name in ("head_rotation", "left_eye_rotation", "right_eye_rotation")
    }
    recorded = Performance(
        np.arange(FRAMES) / 60, rng.uniform(0, 1, (FRAMES, 52)).astype(np.float32), 60.0, recorded_shapes=ARKIT_NAMES, **angles
    )
    coefficients = rng.normal(size=(FRAMES, 100)).astype(np.float32)
    flame = replace(recorded, expression=coefficients, head_model="flame")
    print("| performance | weights or coefficients | rotations | times |")
    print("|---|---|---|---|")
    for name, performance in (("a.json", recorded), ("a.csv", recorded), ("a.npz", flame)):
        write_performance(folder / name, performance)
        found = read_performance(folder / name)
        values = (found.weights, recorded.weights) if found.expression is None else (found.expression, coefficients)
        turn = max(np.abs(euler_to_matrix(getattr(found, part)) - euler_to_matrix(angles[part])).max() for part in angles)
        times = np.abs(found.times - recorded.times).max()
        print(f"| {name[1:]} | {np.abs(values[0] - values[1]).max():.2g} | {turn:.2g} | {times:.2g} s |")


if __name__ == "__main__":
    sys.exit(main())
