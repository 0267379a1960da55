"""Write tests/data/photo_networks_reference.npz: what LiteRT answers on fixed random inputs, for the parity test.

pip install ai-edge-litert==2.3.0
python -m tools.photo_networks.reference FOLDER      (the four .tflite files, unpacked from the wheels)
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from ai_edge_litert.interpreter import Interpreter

TARGET = Path(__file__).resolve().parents[2] / "tests" / "data" / "photo_networks_reference.npz"
INPUT_SCALE = {"face_detector": 1.0, "face_landmarks_detector": 1.0, "face_blendshapes": 256.0, "selfie_segmentation": 1.0}
MASK_STRIDE = 4  # the mask is large and smooth; a quarter of its rows and columns is enough


def main() -> None:
    """Run every network once and keep its outputs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    outputs: dict[str, np.ndarray] = {}
    for name, scale in INPUT_SCALE.items():
        interpreter = Interpreter(str(folder / f"{name}.tflite"))
        interpreter.allocate_tensors()
        source = interpreter.get_input_details()[0]
        value = np.random.default_rng(0).uniform(0.0, scale, source["shape"]).astype(np.float32)
        interpreter.set_tensor(source["index"], value)
        interpreter.invoke()
        for index, target in enumerate(interpreter.get_output_details()):
            result = interpreter.get_tensor(target["index"])
            outputs[f"{name}.{index}"] = result[:, ::MASK_STRIDE, ::MASK_STRIDE] if name == "selfie_segmentation" else result
    np.savez_compressed(TARGET, **outputs)


if __name__ == "__main__":
    main()
