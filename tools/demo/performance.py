"""The demonstration's own short performance: two and a half seconds that use brows, lids, gaze, lips, jaw and neck."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from grmm_core.controls.names import ARKIT_NAMES, MIXTURES

FRAMES_PER_SECOND = 24
DURATION = 2.5  # seconds

# Time in seconds to weights; between the keys the curves ease in and out.
_KEYS: tuple[tuple[float, dict[str, float]], ...] = (
    (0.0, {}),
    (0.25, {"browInnerUp": 0.3}),
    (0.55, {"mouthSmileLeft": 0.75, "mouthSmileRight": 0.7, "cheekSquintLeft": 0.4, "cheekSquintRight": 0.4}),
    (0.85, {**MIXTURES["visemeEE"]}),
    (1.05, {**MIXTURES["visemeAA"]}),
    (1.25, {"mouthClose": 0.05, "mouthPressLeft": 0.6, "mouthPressRight": 0.6}),
    (1.45, {**MIXTURES["visemeOO"]}),
    (1.75, {**MIXTURES["surprise"]}),
    (2.05, {"mouthPucker": 0.8, "browDownLeft": 0.6, "browDownRight": 0.6}),
    (2.3, {"mouthSmileLeft": 0.5, "mouthSmileRight": 0.5}),
    (DURATION, {}),
)
_BLINKS = (0.4, 1.55, 2.2)  # seconds at which the lids are shut
_BLINK_HALF_WIDTH = 0.09


def write_performance(path: Path) -> None:
    """Write the performance as an ARKit JSON file: names, frames per second, frames of 52 weights."""
    times = np.arange(round(DURATION * FRAMES_PER_SECOND) + 1) / FRAMES_PER_SECOND
    weights = np.zeros((times.size, len(ARKIT_NAMES)))
    key_times = np.array([time for time, _ in _KEYS])
    for column, name in enumerate(ARKIT_NAMES):
        values = np.array([key.get(name, 0.0) for _, key in _KEYS])
        weights[:, column] = _ease(times, key_times, values)
    closed = np.max([1.0 - np.clip(np.abs(times - blink) / _BLINK_HALF_WIDTH, 0.0, 1.0) for blink in _BLINKS], axis=0)
    glance = 0.5 * np.sin(2.0 * np.pi * times / DURATION)
    for side, toward_left in (("Left", "Out"), ("Right", "In")):
        away = {"Out": "In", "In": "Out"}[toward_left]
        weights[:, ARKIT_NAMES.index(f"eyeBlink{side}")] = closed**0.7
        weights[:, ARKIT_NAMES.index(f"eyeLook{toward_left}{side}")] = np.maximum(glance, 0.0)
        weights[:, ARKIT_NAMES.index(f"eyeLook{away}{side}")] = np.maximum(-glance, 0.0)
    document = {
        "names": list(ARKIT_NAMES),
        "metadata": {"fps": FRAMES_PER_SECOND},
        "frames": [{"weights": np.round(row, 4).tolist(), "time": float(t)} for row, t in zip(weights, times, strict=True)],
    }
    path.write_text(json.dumps(document), encoding="utf-8")


def _ease(times: np.ndarray, keys: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate with zero slope at every key (smoothstep)."""
    index = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, keys.size - 2)
    t = np.clip((times - keys[index]) / (keys[index + 1] - keys[index]), 0.0, 1.0)
    return values[index] + (values[index + 1] - values[index]) * t * t * (3.0 - 2.0 * t)
