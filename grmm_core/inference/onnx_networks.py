"""The model's networks without torch: graphs of the map decoders and of the refinement, run by onnxruntime.

`map_decoder` and `refinement` write the networks of `model.decoders.MapDecoder` and `model.refine.RefinementNetwork` down as
ONNX graphs from a weights file's arrays. A `Network` is compiled at its first use. Needs numpy and onnxruntime.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..model.config import COLOR_CHANNELS, VIEW_CHANNELS, GRMMConfig
from .onnx_graph import OnnxGraph

SLOPE = 0.2  # of the leaky rectifiers, as in `model.decoders` and `model.refine`
Arrays = Mapping[str, np.ndarray]


class Network:
    """One graph with its inputs in order.

    Args:
        model: Serialised ONNX model.
        threads: Threads it may use; None leaves it to onnxruntime.
    """

    def __init__(self, model: bytes, threads: int | None = None) -> None:
        self._model = model
        self._threads = threads
        self._session: Any = None
        self._inputs: list[str] = []

    def __call__(self, *inputs: np.ndarray) -> np.ndarray:
        """Return the graph's output for float32 inputs."""
        if self._session is None:
            self._compile()
        result: np.ndarray = self._session.run(None, dict(zip(self._inputs, inputs, strict=True)))[0]
        return result

    def _compile(self) -> None:
        import onnxruntime

        onnxruntime.disable_telemetry_events()  # builds for Windows report to the system unless told not to
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3  # errors
        # Spinning threads would take the cores from the rasteriser between two networks.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        if self._threads is not None:
            options.intra_op_num_threads = self._threads
        self._session = onnxruntime.InferenceSession(self._model, options, providers=["CPUExecutionProvider"])
        self._inputs = [value.name for value in self._session.get_inputs()]
        self._model = b""


def map_decoder(arrays: Arrays, name: str, config: GRMMConfig, has_view: bool) -> bytes:
    """Graph of a decoder: a code to a map, flattened.

    Args:
        arrays: Parameters by name.
        name: Prefix of the decoder's parameters, such as "decoders.opacity".
        config: Sizes.
        has_view: Whether the view direction is appended at the configured stage.

    Returns:
        A model with the inputs code [1, K] and, with a view, view [1, 3]; output [side * side, C].
    """
    graph = OnnxGraph(name)
    weight = arrays[f"{name}.first.weight"]
    x = graph.input("code", (1, weight.shape[1]))
    view = graph.input("view", (1, VIEW_CHANNELS)) if has_view else ""
    x = graph.node("Gemm", x, graph.constant(weight), graph.constant(arrays[f"{name}.first.bias"]), transB=1)
    x = graph.node("LeakyRelu", x, alpha=SLOPE)
    side, stages = config.decoder_start, len(config.decoder_channels)
    x = graph.node("Reshape", x, graph.constant(np.array([1, -1, side, side])))
    for stage in range(stages):
        if has_view and side == config.view_stage:
            column = graph.node("Reshape", view, graph.constant(np.array([1, VIEW_CHANNELS, 1, 1])))
            tiled = graph.node("Expand", column, graph.constant(np.array([1, VIEW_CHANNELS, side, side])))
            x = graph.node("Concat", x, tiled, axis=1)
        parameters = (graph.constant(arrays[f"{name}.stages.{stage}.{part}"]) for part in ("weight", "bias"))
        x = graph.node("ConvTranspose", x, *parameters, kernel_shape=(4, 4), strides=(2, 2), pads=(1, 1, 1, 1))
        side *= 2
        if stage < stages - 1:
            x = graph.node("LeakyRelu", x, alpha=SLOPE)
    channels = arrays[f"{name}.stages.{stages - 1}.weight"].shape[1]
    x = graph.node("Reshape", x, graph.constant(np.array([channels, side * side])))
    return graph.serialise(graph.node("Transpose", x, perm=(1, 0)), (side * side, channels))


def refinement(arrays: Arrays, config: GRMMConfig) -> bytes:
    """Graph of Psi_ref (eq. 14) without its ends, which are `loops.fold_pixels` and `loops.unfold_residual`.

    Args:
        arrays: Parameters by name.
        config: Sizes.

    Returns:
        A model with what the first layer gives as its input, entered [1, C_0, h, w] of a picture whose sides the network's grid
        divides; output the residual [1, 3 fold^2, h, w].
    """
    graph = OnnxGraph("refinement")
    levels, outputs = len(config.refine_channels), COLOR_CHANNELS * config.refine_unshuffle**2

    def convolve(x: str, name: str, stride: int = 1, pad: int = 1) -> str:
        weight = arrays[f"refinement.{name}.weight"]
        constants = graph.constant(weight), graph.constant(arrays[f"refinement.{name}.bias"])
        return graph.node(
            "Conv", x, *constants, kernel_shape=weight.shape[2:], strides=(stride, stride), pads=(pad, pad, pad, pad)
        )

    def activate(x: str) -> str:
        return graph.node("LeakyRelu", x, alpha=SLOPE)

    def resized(x: str) -> str:
        scales = graph.constant(np.array([1, 1, 2, 2], np.float32))
        options = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
        return graph.node("Resize", x, "", scales, **options)

    x = graph.input("entered", (1, len(arrays["refinement.entry.weight"]), "h", "w"))
    skips = [activate(convolve(x, "first"))]
    for level in range(levels - 1):
        skips.append(activate(convolve(skips[-1], f"down.{level}", stride=2)))
    x = activate(convolve(skips.pop(), "middle"))
    for level in range(levels - 1):
        x = graph.node("Add", resized(convolve(x, f"narrow.{level}", pad=0)), skips.pop())
        x = activate(convolve(x, f"up.{level}"))
    return graph.serialise(convolve(x, "exit"), (1, outputs, "h", "w"))
