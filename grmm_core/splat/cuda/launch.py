"""The kernels on a graphics card: compiled once per device and number of features, started through the CUDA driver.

Torch's current device, context and stream are used, so that the kernels take their place among torch's own. Never run so far:
no graphics card was at hand. What can be proven without one is in the tests (see `drawing.py`). Used by `adapter.py`.
"""

from __future__ import annotations

import ctypes
import functools
import sys
import threading
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import BackendError
from .compile import compile_source
from .source import FEATURES_MAX, KERNELS, THREADS, kernel_source

_lock = threading.Lock()


def pack(arguments: tuple[Any, ...]) -> tuple[ctypes.Array[ctypes.c_void_p], list[Any]]:
    """Return kernel arguments as the array of pointers that a launch takes, and the objects pointed at, to be kept alive."""
    values: list[Any] = []
    for argument in arguments:
        if isinstance(argument, Tensor):
            values.append(ctypes.c_void_p(argument.data_ptr()))
        elif isinstance(argument, np.ndarray):
            values.append((ctypes.c_double * argument.size)(*argument.tolist()))
        else:
            values.append(ctypes.c_int(argument))
    return (ctypes.c_void_p * len(values))(*(ctypes.addressof(value) for value in values)), values


@functools.cache
def _driver() -> ctypes.CDLL:
    try:
        return ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError as error:
        raise BackendError("The CUDA driver library is missing; install the graphics driver or use the device cpu.") from error


def _check(code: int, what: str) -> None:
    if code:
        text = ctypes.c_char_p()
        _driver().cuGetErrorString(code, ctypes.byref(text))
        reason = (text.value or b"unknown error").decode()
        raise BackendError(f"The CUDA rasteriser failed to {what} ({reason}); use the device cpu.")


class DeviceKernels:
    """The kernels, loaded on one device."""

    def __init__(self, device: torch.device, features: int) -> None:
        """Compile and load them.

        Args:
            device: A CUDA device.
            features: Channels beside color and depth.

        Raises:
            BackendError: Too many channels, no compiler, or the driver refuses.
        """
        if features > FEATURES_MAX:
            raise BackendError(f"The CUDA rasteriser takes {FEATURES_MAX} features, not {features}; use the backend 'torch'.")
        major, minor = torch.cuda.get_device_capability(device)
        image = compile_source(kernel_source(features), f"sm_{major}{minor}")
        self._device = device
        self._module = ctypes.c_void_p()
        self._functions: dict[str, ctypes.c_void_p] = {}
        with torch.cuda.device(device):
            torch.cuda.current_stream().synchronize()  # makes torch's context the current one of this thread
            _check(_driver().cuModuleLoadData(ctypes.byref(self._module), image), "load its kernels")
            for name in KERNELS:
                function = ctypes.c_void_p()
                _check(_driver().cuModuleGetFunction(ctypes.byref(function), self._module, name.encode()), f"find {name}")
                self._functions[name] = function

    def launch(self, name: str, blocks: tuple[int, int], *arguments: Any) -> None:
        """See `drawing.Kernels`."""
        parameters, alive = pack(arguments)
        with torch.cuda.device(self._device):
            stream = ctypes.c_void_p(torch.cuda.current_stream().cuda_stream)
            code = _driver().cuLaunchKernel(self._functions[name], *blocks, 1, THREADS, 1, 1, 0, stream, parameters, None)
        del alive  # the driver has copied them
        _check(code, f"start {name}")


@functools.cache
def _loaded(index: int, features: int) -> DeviceKernels:
    return DeviceKernels(torch.device("cuda", index), features)


def device_kernels(device: torch.device, features: int) -> DeviceKernels:
    """Return the kernels for a device, compiled on first use. Raises `BackendError`."""
    with _lock:
        return _loaded(torch.cuda.current_device() if device.index is None else device.index, features)
