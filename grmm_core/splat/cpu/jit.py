"""How this folder compiles: one decorator for all kernels, on top of `grmm_core.compute.kernels`.

Numba looks at the file of the outermost kernel when it judges whether a cached form is still valid: after a change to a helper
that kernels of other files call (`simd.py`, the first half of `forward.py`), touch those files too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...compute.kernels import compiled

# Everything of "fast" except the promise that no NaN or infinity occurs: such Gaussians are found and dropped by the kernels.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp", "afn"}


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function on its first call, to run without the interpreter lock, and cache the result."""
    return compiled(nogil=True, fastmath=FAST_MATH, error_model="numpy")(function)
