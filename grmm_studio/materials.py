"""Cycles materials from a `Subject`: skin, eyes, teeth, tongue, hair. Imports bpy.

Shaders read mesh attributes that `scene` writes: `rest` (template position in metres; for eyeballs the direction from the eye's
centre with +z through the pupil), and masks 0..1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy
import numpy as np

from grmm_core.data.layers import ALBEDO, PARTS
from grmm_core.light.eye_shade import IRIS, LIMBUS, WHITE
from grmm_core.wrinkles.families import LINE_DEPTH

from .passes import PART_OUTPUTS
from .subjects import Subject
from .teeth import TeethTextures
from .textures import SkinTextures

Socket = Any  # a bpy node socket, or a constant for it
MOUTH_GLOW = 0.10  # of the color: light that bounces in the mouth more often than the render follows it
LINE_SHADE = 0.9  # how much of the groove's color the deepest line of an expression takes


class Nodes:
    """A few words for building node trees."""

    def __init__(self, name: str) -> None:
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.tree.nodes.clear()

    def node(self, kind: str, inputs: Mapping[Any, Socket] | None = None, **settings: Any) -> Any:
        """Add a node, set its properties, link or set its inputs."""
        node = self.tree.nodes.new(kind)
        for setting, value in settings.items():
            setattr(node, setting, value)
        for name_or_number, value in (inputs or {}).items():
            self.put(node.inputs[name_or_number], value)
        return node

    def put(self, target: Any, value: Socket) -> None:
        """Link a socket or set a constant."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, target)
        elif isinstance(value, (tuple, list)) and len(value) == 3 and target.type == "RGBA":
            target.default_value = (*value, 1.0)
        else:
            target.default_value = value

    def attribute(self, name: str) -> Any:
        """Float attribute."""
        return self.node("ShaderNodeAttribute", attribute_name=name).outputs["Fac"]

    def vector(self, name: str) -> Any:
        """Vector attribute."""
        return self.node("ShaderNodeAttribute", attribute_name=name).outputs["Vector"]

    def math(self, operation: str, a: Socket, b: Socket = 0.0, clamp: bool = False) -> Any:
        """Scalar arithmetic."""
        return self.node("ShaderNodeMath", {0: a, 1: b}, operation=operation, use_clamp=clamp).outputs[0]

    def mix(self, factor: Socket, a: Socket, b: Socket, blend: str = "MIX") -> Any:
        """Mix colors."""
        node = self.tree.nodes.new("ShaderNodeMix")
        node.data_type = "RGBA"
        node.blend_type = blend
        node.clamp_factor = True
        self.put(node.inputs[0], factor)
        self.put(node.inputs[6], a)
        self.put(node.inputs[7], b)
        return node.outputs[2]

    def noise(self, vector: Socket, scale: float, detail: float = 2.0, roughness: float = 0.5) -> Any:
        """Noise 0..1."""
        node = self.node("ShaderNodeTexNoise", {"Vector": vector, "Scale": scale, "Detail": detail, "Roughness": roughness})
        return node.outputs["Fac"]

    def image(self, name: str, pixels: Any, place: Socket | None = None) -> Any:
        """Color of a float texture [H, W, 3] whose first row is v = 0, used as it is.

        It lies by the mesh's UV map, or by the vector `place`.

        Images are never removed: with persistent data Cycles knows them by address, and a new image at the address of a
        removed one would show the old pixels. So `name` must name the content, person and all.
        """
        image = bpy.data.images.get(name)
        if image is None:
            height, width = pixels.shape[:2]
            image = bpy.data.images.new(name, width, height, float_buffer=True, is_data=True)
            rgba = np.ones((height, width, 4), np.float32)
            rgba[..., :3] = pixels
            image.pixels.foreach_set(rgba.ravel())
            image.update()
        inputs = {} if place is None else {"Vector": place}
        return self.node("ShaderNodeTexImage", inputs, image=image, interpolation="Linear", extension="EXTEND").outputs[0]

    def ramp(self, value: Socket, low: float, high: float) -> Any:
        """Smooth step from 0 at low to 1 at high (either order)."""
        flip = low > high
        node = self.node(
            "ShaderNodeMapRange",
            {
                "Value": value,
                "From Min": min(low, high),
                "From Max": max(low, high),
                "To Min": 1.0 if flip else 0.0,
                "To Max": 0.0 if flip else 1.0,
            },
            interpolation_type="SMOOTHSTEP",
        )
        return node.outputs[0]

    def finish(self, shader: Socket, albedo: Socket, parts: dict[str, Socket]) -> bpy.types.Material:
        """Connect the surface, and what `passes` reads: its albedo and how much of which of `PARTS` it is."""
        output = self.node("ShaderNodeOutputMaterial")
        self.tree.links.new(shader, output.inputs["Surface"])
        self.node("ShaderNodeOutputAOV", {"Color": albedo}, aov_name=ALBEDO)
        for i, name in enumerate(PART_OUTPUTS):
            own = {k: parts[part] for k, part in enumerate(PARTS[3 * i : 3 * i + 3]) if part in parts}
            if own:
                color = self.node("ShaderNodeCombineColor", {k: own.get(k, 0.0) for k in range(3)}).outputs[0]
                self.node("ShaderNodeOutputAOV", {"Color": color}, aov_name=name)
        return self.material


def skin_material(s: Subject, textures: SkinTextures, subsurface: bool) -> bpy.types.Material:
    """Skin from painted maps; grooves deepen with the vertex attribute `wrinkle`.

    The lines of the expression are the sum of the map's channels times the vertex attribute `lines`; `blood` multiplies the
    color, and so does `depth`, the shade of an open mouth.
    """
    n = Nodes("skin")
    color = n.image(f"{s.name}_albedo", textures.albedo)
    parts = n.node("ShaderNodeSeparateColor", {0: n.image(f"{s.name}_detail", textures.detail)}).outputs
    groove = n.math("MULTIPLY", parts[1], n.attribute("wrinkle"))
    factor = tuple(float(v) for v in textures.groove_albedo)
    color = n.mix(n.math("MULTIPLY", groove, 0.5), color, n.mix(1.0, color, factor, "MULTIPLY"))
    lines = {0: n.image(f"{s.name}_lines", textures.lines), 1: n.vector("lines")}
    relief = n.node("ShaderNodeVectorMath", lines, operation="DOT_PRODUCT").outputs["Value"]
    color = n.mix(n.math("MULTIPLY", relief, -LINE_SHADE), color, n.mix(1.0, color, factor, "MULTIPLY"))
    color = n.mix(1.0, n.mix(1.0, color, n.vector("blood"), "MULTIPLY"), n.attribute("depth"), "MULTIPLY")
    height = n.math("SUBTRACT", parts[0], n.math("MULTIPLY", groove, 0.0018))
    height = n.math("ADD", height, n.math("MULTIPLY", relief, LINE_DEPTH))
    normal = n.node("ShaderNodeBump", {"Height": height, "Strength": 0.6, "Distance": 1.0}).outputs[0]
    inputs: dict[str | int, Socket] = {
        "Base Color": color,
        "Roughness": parts[2],
        "Normal": normal,
        "IOR": 1.42,
        "Specular IOR Level": 0.42,
        "Emission Color": color,
        "Emission Strength": n.math("MULTIPLY", n.attribute("mouth"), MOUTH_GLOW),
    }
    if subsurface:
        inputs |= {
            "Subsurface Weight": 1.0,
            "Subsurface Radius": (1.0, 0.32, 0.17),
            "Subsurface Scale": 0.0028 if s.melanin < 1 else 0.0018,
        }
    mouth = n.attribute("mouth")
    skin = n.math("SUBTRACT", 1.0, mouth)
    return n.finish(n.node("ShaderNodeBsdfPrincipled", inputs).outputs[0], color, {"skin": skin, "mouth": mouth})


def eye_material(s: Subject) -> bpy.types.Material:
    """Sclera with veins, iris with fibres, limbus, pupil, wet coat, in the shade of lids: the vertex attribute `lids`."""
    n = Nodes("eye")
    d = n.vector("rest")
    parts = n.node("ShaderNodeSeparateXYZ", {0: d}).outputs
    angle = n.math("ARCCOSINE", n.math("MINIMUM", n.math("MAXIMUM", parts[2], -1.0), 1.0))
    radial = n.math("ARCTAN2", parts[1], parts[0])
    around = n.node(
        "ShaderNodeCombineXYZ", {0: n.math("COSINE", radial), 1: n.math("SINE", radial), 2: n.math("MULTIPLY", angle, 1.2)}
    ).outputs[0]
    around = n.node("ShaderNodeVectorMath", {0: around, 1: (s.asymmetry % 97, s.asymmetry % 89, 0.0)}, operation="ADD").outputs[
        0
    ]
    fibres = n.noise(around, 9.0, 4.0, 0.7)
    crypts = n.noise(around, 3.0, 2.0, 0.5)
    share = n.math("DIVIDE", angle, s.iris_angle)
    iris = n.mix(
        n.ramp(n.math("ADD", share, n.math("MULTIPLY", n.math("SUBTRACT", fibres, 0.5), 0.5)), 0.45, 0.75), s.iris_inner, s.iris
    )
    iris = n.mix(
        n.ramp(fibres, 0.38, 0.66),
        n.mix(1.0, iris, (0.45, 0.45, 0.45), "MULTIPLY"),
        n.mix(1.0, iris, (1.55, 1.5, 1.45), "MULTIPLY"),
    )
    iris = n.mix(n.math("MULTIPLY", n.ramp(crypts, 0.5, 0.7), 0.4), iris, n.mix(1.0, iris, (0.5, 0.5, 0.5), "MULTIPLY"))
    iris = n.mix(n.ramp(share, 0.76, 1.0), iris, n.mix(1.0, iris, (0.16, 0.16, 0.18), "MULTIPLY"))
    iris = n.mix(
        n.ramp(
            n.math("ADD", angle, n.math("MULTIPLY", n.math("SUBTRACT", fibres, 0.5), 0.02)),
            s.pupil_angle + 0.012,
            s.pupil_angle - 0.012,
        ),
        iris,
        (0.004, 0.004, 0.004),
    )
    veins = n.ramp(n.math("ABSOLUTE", n.math("SUBTRACT", n.noise(d, 7.0, 5.0, 0.75), 0.5)), 0.035, 0.0)
    far = n.ramp(angle, s.iris_angle + 0.10, s.iris_angle + 0.75)
    sclera = n.mix(n.math("MULTIPLY", veins, n.math("MULTIPLY", far, 0.55)), s.sclera, (0.62, 0.16, 0.12))
    sclera = n.mix(n.math("MULTIPLY", far, 0.35), sclera, (0.72, 0.45, 0.38))
    tone = n.mix(n.ramp(angle, *np.radians(LIMBUS)), tuple(IRIS), tuple(WHITE))
    color = n.mix(n.ramp(angle, s.iris_angle - 0.025, s.iris_angle + 0.03), iris, sclera)
    color = n.mix(1.0, n.mix(1.0, color, tone, "MULTIPLY"), n.attribute("lids"), "MULTIPLY")
    return n.finish(
        n.node(
            "ShaderNodeBsdfPrincipled",
            {
                "Base Color": color,
                "Roughness": 0.35,
                "Specular IOR Level": 0.3,
                "Coat Weight": 1.0,
                "Coat Roughness": 0.025,
                "Coat IOR": 1.38,
            },
        ).outputs[0],
        color,
        {"eyes": 1.0},
    )


def teeth_material(s: Subject, textures: TeethTextures, share: float) -> bpy.types.Material:
    """Teeth and gums from painted maps, which cover the rows v < `share` of the UV square."""
    n = Nodes("teeth")
    lower = {0: n.node("ShaderNodeUVMap").outputs[0], 1: (1.0, 1.0 / share, 1.0)}
    place = n.node("ShaderNodeVectorMath", lower, operation="MULTIPLY").outputs[0]
    color = n.image(f"{s.name}_teeth", textures.albedo, place)
    detail = n.image(f"{s.name}_teeth_detail", textures.detail, place)
    height, gum, rough = n.node("ShaderNodeSeparateColor", {0: detail}).outputs
    normal = n.node("ShaderNodeBump", {"Height": height, "Strength": 0.8, "Distance": 1.0}).outputs[0]
    return n.finish(
        n.node(
            "ShaderNodeBsdfPrincipled",
            {
                "Base Color": color,
                "Roughness": rough,
                "Normal": normal,
                "Specular IOR Level": 0.5,
                "Emission Color": color,
                "Emission Strength": MOUTH_GLOW,
                "Coat Weight": 0.3,
                "Coat Roughness": 0.05,
            },
        ).outputs[0],
        color,
        {"teeth": n.math("SUBTRACT", 1.0, gum), "mouth": gum},
    )


def tongue_material(s: Subject) -> bpy.types.Material:
    """Rough pink tongue with a furrow, darker by `depth`."""
    n = Nodes("tongue")
    rest = n.vector("rest")
    papillae = n.node("ShaderNodeTexVoronoi", {"Vector": rest, "Scale": 800.0}).outputs["Distance"]
    x = n.node("ShaderNodeSeparateXYZ", {0: rest}).outputs[0]
    furrow = n.ramp(n.math("ABSOLUTE", x), 0.0025, 0.0)
    color = n.mix(n.noise(rest, 150.0, 3.0), (0.56, 0.19, 0.18), (0.43, 0.12, 0.125))
    color = n.mix(n.math("MULTIPLY", furrow, 0.45), color, (0.30, 0.07, 0.07))
    color = n.mix(1.0, color, n.attribute("depth"), "MULTIPLY")
    normal = n.node(
        "ShaderNodeBump", {"Height": n.math("MULTIPLY", papillae, 0.0005), "Strength": 0.6, "Distance": 1.0}
    ).outputs[0]
    return n.finish(
        n.node(
            "ShaderNodeBsdfPrincipled",
            {
                "Base Color": color,
                "Roughness": 0.36,
                "Normal": normal,
                "Emission Color": color,
                "Emission Strength": MOUTH_GLOW,
            },
        ).outputs[0],
        color,
        {"mouth": 1.0},
    )


def hair_material(name: str, color: tuple[float, float, float], variation: float) -> bpy.types.Material:
    """Strands: a colored body, two glints along the strand (one of its color), darker roots; color varies by strand."""
    n = Nodes(name)
    bright = n.math("ADD", n.math("MULTIPLY", n.attribute("tint"), 2.0 * variation), 1.0 - variation)
    along = n.node("ShaderNodeHairInfo").outputs["Intercept"]
    factor = n.math("MULTIPLY", bright, n.math("ADD", n.math("MULTIPLY", n.ramp(along, 0.0, 0.5), 0.25), 0.75))
    grey = n.node("ShaderNodeCombineColor", {0: factor, 1: factor, 2: factor}).outputs[0]
    tinted = n.mix(1.0, tuple(min(1.0, c) for c in color), grey, "MULTIPLY")
    body = n.node("ShaderNodeBsdfDiffuse", {"Color": tinted, "Roughness": 0.3}).outputs[0]
    # the cuticle reflects white towards the root, what has gone through the fibre comes back colored towards the tip
    white = n.node(
        "ShaderNodeBsdfHair", {"Color": (0.085, 0.083, 0.08), "Offset": -0.07, "RoughnessU": 0.16, "RoughnessV": 0.9}
    ).outputs[0]
    strong = n.mix(1.0, n.mix(0.5, tinted, (0.5, 0.5, 0.5)), (0.85, 0.85, 0.85), "MULTIPLY")
    second = n.mix(1.0, strong, n.mix(1.0, tinted, (1.6, 1.6, 1.6), "MULTIPLY"), "MULTIPLY")
    glint = n.node("ShaderNodeBsdfHair", {"Color": second, "Offset": 0.12, "RoughnessU": 0.30, "RoughnessV": 0.9}).outputs[0]
    both = n.node("ShaderNodeAddShader", {0: white, 1: glint}).outputs[0]
    return n.finish(n.node("ShaderNodeAddShader", {0: body, 1: both}).outputs[0], tinted, {name: 1.0})
