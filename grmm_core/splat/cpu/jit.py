"""How this folder compiles: one decorator for all kernels.

Numba is imported in this folder only, and `api.py` imports the folder when the backend "cpu" is first used.
A kernel's compiled form is cached next to its source, or in the user's cache folder where that is read-only (NUMBA_CACHE_DIR
decides when set). Numba looks at the file of the outermost kernel when it judges whether a cached form is still valid: after a
change to a helper that kernels of other files call (`simd.py`, the first half of `forward.py`), touch those files too.

A cached form names the module that it came from. The installed Blender extension is imported as `bl_ext...grmm_core` by Blender
and as `grmm_core` by the worker process, from one folder: the package is part of the cache's file names to keep them apart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

# Everything of "fast" except the promise that no NaN or infinity occurs: such Gaussians are found and dropped by the kernels.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp", "afn"}


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function on its first call, to run without the interpreter lock, and cache the result."""
    function.__qualname__ = f"{__package__}.{function.__qualname__}"  # numba names the cache files after this
    options = {"nogil": True, "fastmath": FAST_MATH, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder is writable: compile in every process
        return numba.njit(cache=False, **options)(function)
