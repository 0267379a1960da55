"""Names: the 52 ARKit shapes, the aligned expressions, what is made of these, joints.

The aligned expressions are the counterpart of the paper's 60 aligned expressions (section 3.1): everybody in the capture
performs the same 60, and each owns one learned code z_exp shared by all identities (section 3.3). The first 52 are the ARKit
shapes; the last 8 are mixtures that the ARKit shapes alone do not describe well, given as recipes over them.
"""

from __future__ import annotations

from types import MappingProxyType

ARKIT_NAMES: tuple[str, ...] = (
    "browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight",
    "cheekPuff", "cheekSquintLeft", "cheekSquintRight",
    "eyeBlinkLeft", "eyeBlinkRight", "eyeLookDownLeft", "eyeLookDownRight", "eyeLookInLeft", "eyeLookInRight",
    "eyeLookOutLeft", "eyeLookOutRight", "eyeLookUpLeft", "eyeLookUpRight", "eyeSquintLeft", "eyeSquintRight",
    "eyeWideLeft", "eyeWideRight",
    "jawForward", "jawLeft", "jawOpen", "jawRight",
    "mouthClose", "mouthDimpleLeft", "mouthDimpleRight", "mouthFrownLeft", "mouthFrownRight", "mouthFunnel",
    "mouthLeft", "mouthLowerDownLeft", "mouthLowerDownRight", "mouthPressLeft", "mouthPressRight", "mouthPucker",
    "mouthRight", "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper",
    "mouthSmileLeft", "mouthSmileRight", "mouthStretchLeft", "mouthStretchRight",
    "mouthUpperUpLeft", "mouthUpperUpRight", "noseSneerLeft", "noseSneerRight", "tongueOut",
)  # fmt: skip


WORDS: MappingProxyType[str, str] = MappingProxyType({
    "browDown": "Brow Down", "browInnerUp": "Inner Brows Up", "browOuterUp": "Outer Brow Up",
    "cheekPuff": "Puff Cheeks", "cheekSquint": "Raise Cheek",
    "eyeBlink": "Close Lid", "eyeSquint": "Squint", "eyeWide": "Open Wide",
    "eyeLookDown": "Look Down", "eyeLookIn": "Look In", "eyeLookOut": "Look Out", "eyeLookUp": "Look Up",
    "jaw": "Jaw", "jawForward": "Jaw Forward", "jawOpen": "Open Jaw",
    "mouth": "Mouth", "mouthClose": "Close Lips", "mouthDimple": "Dimple", "mouthFrown": "Frown", "mouthFunnel": "Funnel Lips",
    "mouthLowerDown": "Lower Lip Down", "mouthPress": "Press Lips", "mouthPucker": "Pucker Lips",
    "mouthRollLower": "Roll Lower Lip", "mouthRollUpper": "Roll Upper Lip",
    "mouthShrugLower": "Push Lower Lip", "mouthShrugUpper": "Push Upper Lip",
    "mouthSmile": "Smile", "mouthStretch": "Stretch Corner", "mouthUpperUp": "Upper Lip Up",
    "noseSneer": "Sneer", "tongueOut": "Tongue Out",
})  # fmt: skip
"""What each ARKit shape does, without its side: ARKit's own names say where it is, and not always what happens."""


def _both(name: str, weight: float) -> dict[str, float]:
    return {f"{name}Left": weight, f"{name}Right": weight}


MIXTURES: MappingProxyType[str, MappingProxyType[str, float]] = MappingProxyType({
    name: MappingProxyType(recipe)
    for name, recipe in {
        "visemeAA": {"jawOpen": 0.55, **_both("mouthLowerDown", 0.3), **_both("mouthUpperUp", 0.2)},
        "visemeEE": {
            "jawOpen": 0.15, **_both("mouthSmile", 0.4), **_both("mouthStretch", 0.45), **_both("mouthLowerDown", 0.35),
        },
        "visemeOO": {"jawOpen": 0.2, "mouthPucker": 0.7, "mouthFunnel": 0.45},
        "visemeFV": {"jawOpen": 0.1, "mouthRollLower": 0.75, **_both("mouthUpperUp", 0.35)},
        "surprise": {
            "jawOpen": 0.6, "browInnerUp": 0.9, **_both("browOuterUp", 0.9), **_both("eyeWide", 0.9), "mouthFunnel": 0.2,
        },
        "disgust": {
            **_both("noseSneer", 0.9), **_both("mouthUpperUp", 0.6), **_both("browDown", 0.7), **_both("eyeSquint", 0.5),
            "mouthShrugLower": 0.35,
        },
        "laugh": {
            "jawOpen": 0.4, **_both("mouthSmile", 0.95), **_both("cheekSquint", 0.8), **_both("eyeSquint", 0.7),
            **_both("mouthUpperUp", 0.3),
        },
        "scream": {
            "jawOpen": 0.95, **_both("mouthStretch", 0.6), **_both("browDown", 0.8), **_both("eyeSquint", 0.8),
            **_both("noseSneer", 0.6), **_both("mouthLowerDown", 0.5),
        },
    }.items()
})  # fmt: skip
"""Name to recipe over ARKit names; the weights are those of the mixture at 1."""

MIXTURE_NAMES: tuple[str, ...] = tuple(MIXTURES)
ALIGNED_NAMES: tuple[str, ...] = ARKIT_NAMES + MIXTURE_NAMES
"""The 60 aligned expressions, in the order of the weights' table of codes Z [60, z_exp]."""

COMPOUNDS: dict[str, dict[str, float]] = {}
"""Further expressions, as recipes like `MIXTURES`: sliders that are the sum of their parts and have no learned code."""
EXPRESSION_NAMES: tuple[str, ...] = (*ALIGNED_NAMES, *COMPOUNDS)
"""All expressions that have a name and a slider."""

JOINT_NAMES: tuple[str, ...] = ("root", "neck", "jaw", "left_eye", "right_eye")
