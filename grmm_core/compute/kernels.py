"""How every numba kernel of the core is compiled and cached; importing this module loads numba.

A compiled form is cached next to its source, or in the user's cache folder where that is read-only (NUMBA_CACHE_DIR decides
when set). It names the module that it came from. The installed Blender extension is imported as `bl_ext...grmm_core` by Blender
and as `grmm_core` by the worker process, from one folder: the module's full name is part of the cache's file names to keep
them apart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function on its first call with numba's `options` and caches the result."""

    def decorate(function: Callable[..., Any]) -> Any:
        function.__qualname__ = f"{function.__module__}.{function.__qualname__}"  # numba names the cache files after this
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no folder is writable: compile in every process
            return numba.njit(cache=False, **options)(function)

    return decorate
