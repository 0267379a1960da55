"""How every numba kernel of the core is compiled and cached; importing this module loads numba.

A compiled form is cached next to its source, or in the user's cache folder where that is read-only (NUMBA_CACHE_DIR decides
when set). Its file's name tells apart two things that numba does not ask for: the module that it came from, since the installed
Blender extension is imported as `bl_ext...grmm_core` by Blender and as `grmm_core` by the worker process, from one folder; and
what it holds of other files, constants and kernels, since numba compares its own source alone, and went on with old constants
after an update. Both are a short sum in the name: Windows has paths of 260 characters.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function on its first call with numba's `options` and caches the result."""

    def decorate(function: Callable[..., Any]) -> Any:
        held = hashlib.sha256("\n".join((function.__module__, *_held(function))).encode()).hexdigest()[:12]
        function.__qualname__ += f".{held}"  # numba names the cache files after this
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no folder is writable: compile in every process
            return numba.njit(cache=False, **options)(function)

    return decorate


def _held(function: Callable[..., Any]) -> Iterator[str]:
    """What a compiled form holds: its instructions, constants, and values and kernels that it names."""
    code = function.__code__
    yield code.co_code.hex()
    yield repr([part for part in code.co_consts if not hasattr(part, "co_code")])
    for name in code.co_names:
        value = function.__globals__.get(name)
        yield f"{name} {_shown(value)}"
        if isinstance(value, ModuleType):
            yield from (f"{name}.{part} {_shown(vars(value).get(part))}" for part in code.co_names)


def _shown(value: object) -> str:
    if isinstance(value, Dispatcher):  # whose name says what it holds
        return str(value.py_func.__qualname__)
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.tolist()}"
    return repr(value) if isinstance(value, (bool, int, float, str, tuple, np.generic)) else ""
