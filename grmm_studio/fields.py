"""Where on a head is what: smooth masks in the coordinates of the template head. Needs numpy only.

Everything is written over template positions (head space, metres) of the mean person, so that it holds for every shape, and
over the head model's regions. Used by `mesh` (attributes for the shaders) and `grooms` (where hair grows).
"""

from __future__ import annotations

import math

import numpy as np

from grmm_core.hair.attach import SIDEBURN_Y, SIDEBURN_Z
from grmm_core.wrinkles.noise import bump, smoothstep, wave_noise

HEAD_CENTRE = np.array([0.0, 0.045, 0.0])
ARCH_CENTRE = 0.055  # metres forward: where the dental arches' halves begin to run straight back
# Hairline of the mean head: azimuth in degrees from the front (0) to the nape (180), height in metres.
HAIRLINE_AZIMUTH = (0.0, 20.0, 35.0, 48.0, 60.0, 70.0, 80.0, 92.0, 104.0, 118.0, 140.0, 180.0)
HAIRLINE_HEIGHT = (0.101, 0.102, 0.099, 0.080, 0.058, 0.022, 0.016, 0.034, 0.030, -0.012, -0.032, -0.040)
RECEDED_HEIGHT = (0.123, 0.133, 0.138, 0.122, 0.075, 0.028, 0.016, 0.034, 0.030, -0.012, -0.032, -0.040)


def azimuth(points: np.ndarray) -> np.ndarray:
    """Degrees from the front, 0..180, unsigned; [...]."""
    return np.degrees(np.abs(np.arctan2(points[..., 0], points[..., 2] - HEAD_CENTRE[2])))


def hairline_distance(points: np.ndarray, receding: float, lift: float, seed: int) -> np.ndarray:
    """Metres above (positive) the hairline on the template, irregular as hairlines are; [...].

    Args:
        points: Template positions, [..., 3].
        receding: 0 full hair .. 1 receded temples and forehead.
        lift: Metres that the front line is moved up.
        seed: Seed of the irregularity.
    """
    angle = azimuth(points)
    full = np.interp(angle, HAIRLINE_AZIMUTH, HAIRLINE_HEIGHT)
    bare = np.interp(angle, HAIRLINE_AZIMUTH, RECEDED_HEIGHT)
    line = full + receding * (bare - full) + lift * smoothstep(75.0, 45.0, angle)
    irregular = 0.0035 * wave_noise(points, 0.030, seed) + 0.002 * wave_noise(points, 0.009, seed + 1)
    return points[..., 1] - line + irregular


def scalp_density(points: np.ndarray, receding: float, lift: float, seed: int) -> np.ndarray:
    """Density of scalp hair 0..1 that thins out towards the hairline; template positions [..., 3] -> [...]."""
    distance = hairline_distance(points, receding, lift, seed)
    density = smoothstep(-0.003, 0.010, distance)
    # the crown thins with the receding line
    crown = np.exp(-(((points - np.array([0.0, 0.135, -0.035])) / np.array([0.038, 0.03, 0.038])) ** 2).sum(-1))
    density = density * (1.0 - 0.75 * receding * crown)
    # no hair in front of and on the ears
    ear = (np.abs(points[..., 0]) > 0.0735) & (np.abs(points[..., 1] - 0.005) < 0.042) & (np.abs(points[..., 2] + 0.0) < 0.035)
    return np.where(ear, 0.0, density)


SIDEBURN = (0.019, 0.024, 0.036, 0.046)  # metres: depths between which a beard goes up before the ears, with its borders
SIDEBURN_END = 0.004  # metres below the hair of the scalp over which it ends
# heights above which a beard grows, by depth: it ends below the edge of the jaw, and where chin and throat meet
NECK_Z, NECK_Y = (0.0, 0.02, 0.05, 0.07, 0.1), (-0.034, -0.050, -0.079, -0.086, -0.09)


def beard_density(points: np.ndarray, seed: int) -> np.ndarray:
    """Where a beard grows, 0..1: sideburns, jaw, chin, upper lip, cheeks' lower part, under the chin; [...]."""
    x, y, z = np.abs(points[..., 0]), points[..., 1], points[..., 2]
    ragged = wave_noise(points, 0.02, seed)
    upper = np.interp(x, (0.0, 0.018, 0.030, 0.045, 0.060, 0.072), (-0.0195, -0.0205, -0.030, -0.030, -0.012, 0.018))
    cheeks = np.maximum(smoothstep(0.004, -0.006, y - upper + 0.003 * ragged), sideburns(points))
    neck = smoothstep(-0.006, 0.006, y - np.interp(z, NECK_Z, NECK_Y) + 0.002 * ragged)
    front = smoothstep(0.004, 0.018, z)
    moustache = bump(points, (0.010, -0.0165, 0.112), (0.017, 0.0055, 0.02)) * 1.3
    below_lip = bump(points, (0.013, -0.047, 0.104), (0.006, 0.006, 0.02))
    mouth = smoothstep(0.9, 1.2, ((x / 0.0265) ** 2 + ((y + 0.0325) / 0.0125) ** 2))
    jaw = cheeks * neck * front * (1 - 0.6 * below_lip)
    return np.clip(
        np.maximum(
            jaw * mouth, np.clip(moustache, 0, 1) * smoothstep(0.85, 1.1, (x / 0.027) ** 2 + ((y + 0.0325) / 0.0115) ** 2)
        ),
        0,
        1,
    )


def sideburns(points: np.ndarray) -> np.ndarray:
    """Where a beard goes up before the ears to the hair of the scalp, 0..1; [...]."""
    x, y, z = np.abs(points[..., 0]), points[..., 1], points[..., 2]
    behind, begins, ends, before = SIDEBURN
    top = np.interp(z, SIDEBURN_Z, SIDEBURN_Y)
    along: np.ndarray = smoothstep(behind, begins, z) * smoothstep(before, ends, z) * smoothstep(top, top - SIDEBURN_END, y)
    return along * smoothstep(-0.03, -0.02, y) * smoothstep(0.055, 0.06, x)


def redness(points: np.ndarray) -> np.ndarray:
    """Zones with more blood: cheeks, nose, chin, ears, 0..1; [...]."""
    zones = (
        0.9 * bump(points, (0.042, 0.002, 0.085), (0.019, 0.017, 0.03)),
        0.9 * bump(points, (0.0, 0.004, 0.121), (0.014, 0.011, 0.02), mirror=False),
        0.5 * bump(points, (0.011, -0.002, 0.108), (0.008, 0.008, 0.015)),
        0.35 * bump(points, (0.0, -0.058, 0.10), (0.018, 0.012, 0.03), mirror=False),
        1.0 * bump(points, (0.083, 0.005, -0.005), (0.012, 0.035, 0.03)),
    )
    return np.clip(sum(zones), 0.0, 1.0)


def eye_shadow(points: np.ndarray) -> np.ndarray:
    """Darker, bluer skin below and around the eyes, 0..1; [...]."""
    return np.clip(
        bump(points, (0.028, 0.0205, 0.092), (0.014, 0.006, 0.02))
        + 0.6 * bump(points, (0.016, 0.033, 0.09), (0.005, 0.008, 0.015)),
        0,
        1,
    )


def wrinkle_lines(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wrinkles by age: amplitude 0..1 and phase in units of one line; [...] each."""
    x, y = np.abs(points[..., 0]), points[..., 1]
    forehead = bump(points, (0.0, 0.083, 0.105), (0.045, 0.020, 0.05), mirror=False)
    crow = bump(points, (0.056, 0.036, 0.075), (0.012, 0.016, 0.025))
    frown = bump(points, (0.006, 0.061, 0.112), (0.006, 0.011, 0.02))
    neck = bump(points, (0.0, -0.10, 0.04), (0.06, 0.03, 0.05), mirror=False) * 0.7
    under = 0.7 * bump(points, (0.030, 0.022, 0.092), (0.014, 0.006, 0.02))
    angle = np.arctan2(y - 0.036, np.maximum(x - 0.040, 1e-4))
    kinds = np.stack([forehead, crow, frown, neck, under], -1)
    phases = np.stack([y / 0.0085 + 0.5 * np.cos(x * 60), angle / 0.32, x / 0.0065, y / 0.013, y / 0.0032], -1)
    which = kinds.argmax(-1)
    amplitude = np.take_along_axis(kinds, which[..., None], -1)[..., 0]
    phase = np.take_along_axis(phases, which[..., None], -1)[..., 0]
    return amplitude, phase


def tooth_arc(points: np.ndarray) -> np.ndarray:
    """Signed metres along the dental arch from the middle, for template points of the teeth, [...]."""
    width, depth = 0.030, 0.045
    angle = np.arctan2(points[..., 0] / width, np.maximum(points[..., 2] - ARCH_CENTRE, 0) / depth)
    table = np.linspace(-math.pi / 2, math.pi / 2, 721)
    curve = np.stack([width * np.sin(table), depth * np.cos(table)], -1)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=-1))])
    length -= length[360]
    arc = np.interp(angle, table, length)
    behind = np.maximum(ARCH_CENTRE - points[..., 2], 0.0)
    return arc + np.sign(points[..., 0]) * behind
