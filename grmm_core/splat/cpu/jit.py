"""How this folder compiles: two decorators for all kernels, on top of `grmm_core.compute.kernels`.

Numba looks at the file of the outermost kernel when it judges whether a cached form is still valid: after a change to a helper
that kernels of other files call (`simd.py`, `blocks.py`), touch those files too.

A kernel takes numbers, arrays and plain tuples. Of a named tuple the cache's index would name the class, and could not be read
any more once that is called otherwise; parts may take and return named tuples. Inner loops index whole arrays: making a view of
one row counts references, which costs more than the row's arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...compute.kernels import compiled

# Everything of "fast" except the promise that no NaN or infinity occurs: such Gaussians are found and dropped by the kernels.
_OPTIONS: dict[str, Any] = {
    "nogil": True, "fastmath": {"contract", "reassoc", "nsz", "arcp", "afn"}, "error_model": "numpy",
}  # fmt: skip


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function on its first call, to run without the interpreter lock, and cache the result."""
    return compiled(**_OPTIONS)(function)


def part(function: Callable[..., Any]) -> Any:
    """Make a function a part of the kernels that call it: its body stands in theirs, so that lanes stay in registers."""
    return compiled(inline="always", **_OPTIONS)(function)
