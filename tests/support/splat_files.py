"""Splats and splat files that tests make: a cloud of the size of a head, PLY files written by hand."""

from __future__ import annotations

import numpy as np

from grmm_core.formats import SplatCloud
from grmm_core.formats.splats.cloud import SH_C0


def make_cloud(count=400, degree=0, seed=0):
    """A head-sized cloud whose colors are within 0..1 and whose scales are those of skin texels."""
    rng = np.random.default_rng(seed)
    terms = (degree + 1) ** 2
    sh = rng.uniform(-0.3, 0.3, (count, terms, 3))
    sh[:, 0] = (rng.uniform(0.02, 0.98, (count, 3)) - 0.5) / SH_C0
    return SplatCloud(
        rng.normal(0, 0.08, (count, 3)),
        rng.normal(size=(count, 4)),
        np.exp(rng.uniform(np.log(1e-4), np.log(0.02), (count, 3))),
        rng.uniform(0.01, 0.99, count),
        sh,
    ).validated()


def ply_bytes(rows, kind="binary_little_endian", head="", extra=""):
    """A PLY of a structured array, also as text or big endian."""
    names = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
    header = f"ply\nformat {kind} 1.0\n{head}element vertex {len(rows)}\n"
    header += "".join(f"property {names[rows.dtype[n].str[1:]]} {n}\n" for n in rows.dtype.names) + extra + "end_header\n"
    if kind == "ascii":
        body = "\n".join(" ".join(repr(float(v)) for v in row) for row in rows).encode() + b"\n"
    else:
        body = rows.astype(rows.dtype.newbyteorder(">")).tobytes() if "big" in kind else rows.tobytes()
    return header.encode() + body


def splat_rows(count=20, drop=(), rest=0, double=False):
    names = ["opacity", "x", "z", "y", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(rest))]
    names += [*(f"rot_{i}" for i in range(4)), *(f"scale_{i}" for i in range(3))]
    rows = np.zeros(count, [(n, "<f8" if double else "<f4") for n in names if n not in drop])
    rng = np.random.default_rng(2)
    for name in rows.dtype.names:
        rows[name] = rng.normal(size=count)
    return rows
