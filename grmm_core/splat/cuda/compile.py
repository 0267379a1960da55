"""CUDA text to machine code at run time, with NVRTC: the compiler library that comes with every CUDA build of torch.

Needs neither nvcc nor a graphics card nor CUDA headers. Used by `launch.py`.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ...errors import BackendError

_NAMES = {"linux": ("libnvrtc.so.13", "libnvrtc.so.12", "libnvrtc.so"), "win32": ("nvrtc64_130_0.dll", "nvrtc64_120_0.dll")}
_FOLDERS = ("nvidia/*/lib", "nvidia/*/bin", "nvidia/*/bin/*", "torch/lib")  # under site-packages, of torch's own dependencies
_OPTIONS = ("--std=c++17", "--fmad=true")
_LOG_LINES = 3


def load_compiler() -> ctypes.CDLL:
    """Return the NVRTC library: one that is loaded or on the system's path, else the one that was installed with torch.

    Raises:
        BackendError: There is none.
    """
    for candidate in _candidates():
        try:
            return ctypes.CDLL(candidate)
        except OSError:
            continue
    raise BackendError("The CUDA rasteriser needs NVRTC, which comes with CUDA builds of torch: install one, or gsplat.")


def _candidates() -> Iterator[str]:
    names = _NAMES.get(sys.platform, ())
    yield from names
    for folder in map(Path, sys.path):
        for pattern in _FOLDERS:
            for name in names:
                yield from map(str, sorted(folder.glob(f"{pattern}/{name}")))


def compile_source(source: str, architecture: str) -> bytes:
    """Compile CUDA C++ text.

    Args:
        source: The text.
        architecture: "sm_90" for machine code of compute capability 9.0, or "compute_90" for PTX.

    Returns:
        A cubin or PTX image, as `cuModuleLoadData` takes it.

    Raises:
        BackendError: NVRTC is missing, or refuses the text or the architecture.
    """
    library = load_compiler()
    program = ctypes.c_void_p()
    _check(library, library.nvrtcCreateProgram(ctypes.byref(program), source.encode(), b"grmm_splat.cu", 0, None, None))
    try:
        options = [f"--gpu-architecture={architecture}".encode(), *(option.encode() for option in _OPTIONS)]
        code = library.nvrtcCompileProgram(program, len(options), (ctypes.c_char_p * len(options))(*options))
        if code:
            log = _bytes(library, program, library.nvrtcGetProgramLogSize, library.nvrtcGetProgramLog)
            lines = log.decode(errors="replace").strip("\0").strip().splitlines()[:_LOG_LINES]
            raise BackendError(
                f"The CUDA rasteriser could not be compiled for {architecture} ({' '.join(lines) or f'NVRTC error {code}'}); "
                "use the device cpu."
            )
        if architecture.startswith("sm_"):
            return _bytes(library, program, library.nvrtcGetCUBINSize, library.nvrtcGetCUBIN)
        return _bytes(library, program, library.nvrtcGetPTXSize, library.nvrtcGetPTX)
    finally:
        library.nvrtcDestroyProgram(ctypes.byref(program))


def _bytes(library: ctypes.CDLL, program: ctypes.c_void_p, get_size: Callable[..., Any], get: Callable[..., Any]) -> bytes:
    size = ctypes.c_size_t()
    _check(library, get_size(program, ctypes.byref(size)))
    buffer = ctypes.create_string_buffer(size.value)
    _check(library, get(program, buffer))
    return buffer.raw


def _check(library: ctypes.CDLL, code: int) -> None:
    if code:
        library.nvrtcGetErrorString.restype = ctypes.c_char_p
        raise BackendError(f"NVRTC failed ({library.nvrtcGetErrorString(code).decode()}); use the device cpu.")
