"""How this folder compiles: one decorator for all kernels.

Numba is imported here and in the kernel modules only; `api.py` imports them when the backend "cpu" is first used.
A kernel's compiled form is cached next to its source, or in the user's cache folder where that is read-only (NUMBA_CACHE_DIR
decides when set). Numba looks at the file of the outermost kernel when it judges whether a cached form is still valid, so every
kernel and what it calls share a file, except for the few helpers of `simd.py`.

A cached form names the module that it came from. The installed Blender extension is imported as `bl_ext...grmm_core` by Blender
and as `grmm_core` by the worker process, from one folder: the package is part of the cache's file names to keep them apart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

# Everything of "fast" except the promise that no NaN or infinity occurs: such Gaussians are found and dropped by the kernels.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp", "afn"}


def kernel(parallel: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function on its first call, without the interpreter lock, and caches the result.

    Args:
        parallel: The function spreads `prange` loops over the threads.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        # Numba names the cache files after this.
        function.__qualname__ = f"{__package__}.{function.__qualname__}"
        options = {"nogil": True, "fastmath": FAST_MATH, "parallel": parallel, "error_model": "numpy", "boundscheck": False}
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no folder is writable: compile in every process
            return numba.njit(cache=False, **options)(function)

    return decorate
