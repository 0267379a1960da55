"""What the mesh of a head looks like where no splats are drawn: in EEVEE and Cycles, and in solid view without a runtime.

An avatar's file carries a painting of the person on the UV map. It becomes the texture of the head's own materials, one for
each part that solid view, which shows one color a material, has to tell apart: hair, brows and beard, lips, irises, pupils.
A head without a painting (a user's FLAME file, avatars of earlier versions) has plain materials that heads share.
"""

from __future__ import annotations

import bpy
import numpy as np

from ...grmm_core.controls.names import JOINT_NAMES
from ...grmm_core.head import HeadModel
from ...grmm_core.pictures.color import srgb_to_linear
from ...grmm_core.pictures.sampling import bilinear
from .identity import Identity

PART = "grmm_part"  # custom property of a material: which part of a head it was made for
# part, words of its regions, color (linear), roughness
_PLAIN = (
    ("Skin", (), (0.58, 0.34, 0.25, 1.0), 0.5),
    ("Eyes", ("eye",), (0.75, 0.74, 0.72, 1.0), 0.1),
    ("Teeth", ("teeth",), (0.72, 0.68, 0.58, 1.0), 0.25),
    ("Mouth", ("mouth_interior", "tongue"), (0.38, 0.11, 0.1, 1.0), 0.35),
    ("Lashes", ("lash",), (0.03, 0.02, 0.015, 1.0), 0.6),
)
_PAINTED = {"Skin": 0.5, "Eyes": 0.1, "Irises": 0.1, "Pupils": 0.1, "Lips": 0.35, "Hair": 0.7}  # roughness
_IRIS, _PUPIL = np.cos(np.radians((23.0, 9.0)))  # half angles on the eyeball
_UNLIKE = 0.12  # display color between hair and skin from which on they are told apart
_HAIR, _BROW = 0.5, 0.15  # how far from skin to hair a face's color is that counts as hair; brows are narrower than faces
_WHITEST = 0.75  # quantile of an eye's colors: lashes shade most of the white


def add_materials(mesh: bpy.types.Mesh, identity: Identity) -> None:
    """Give the parts of a head's mesh materials; a mesh that has others than these keeps them."""
    if any(material is None or not (PART in material or material.name.startswith("GRMM ")) for material in mesh.materials):
        return
    parts = _plain_parts(identity.head)
    materials = {name: _shared(name, color, roughness) for name, _, color, roughness in _PLAIN}
    if identity.painting is not None:
        image = _image(f"{identity.name} painting", identity.painting)
        colors = _face_colors(identity.head, identity.painting)
        parts = _painted_parts(identity.head, parts, colors)
        for name, roughness in _PAINTED.items():
            inside = parts == name
            middle = _WHITEST if name == "Eyes" else 0.5
            color = srgb_to_linear(np.quantile(colors[inside], middle, axis=0)) if inside.any() else np.zeros(3)
            materials[name] = _painted(f"{identity.name} {name}", name, image, color, roughness)
    mesh.materials.clear()
    used = [name for name in materials if (parts == name).any()]
    for name in used:
        mesh.materials.append(materials[name])
    mesh.polygons.foreach_set("material_index", np.array([used.index(name) for name in parts], np.int32))


def _plain_parts(head: HeadModel) -> np.ndarray:
    """Name of the part of each face, [F]; a face belongs to a part when all its corners do."""
    parts = np.full(len(head.faces), _PLAIN[0][0], dtype="<U8")
    for name, words, *_ in _PLAIN:
        inside = _vertices(head, *(r for r in head.regions if "lid" not in r and any(word in r for word in words)))
        parts[inside[head.faces].all(1)] = name
    return parts


def _painted_parts(head: HeadModel, parts: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Divide skin and eyes further: by where they are, and hair by its color [F, 3]."""
    parts = parts.copy()
    joints = head.joints(np.zeros(head.shape_count, np.float32))
    for side in ("left", "right"):
        ball = _vertices(head, f"{side}_eyeball")[head.faces].all(1)
        centre = joints[JOINT_NAMES.index(f"{side}_eye")]
        ways = head.v_template[head.faces].mean(1) - centre
        ahead = ways[:, 2] / np.linalg.norm(ways, axis=1)  # eyes look along +z
        for name, least in (("Irises", _IRIS), ("Pupils", _PUPIL)):
            parts[ball & (ahead > least)] = name
    skin = parts == "Skin"
    lips, brows, apart = (_vertices(head, *names)[head.faces] for names in (("lips",), ("brows",), ("lips", "lids", "brows")))
    tone, hair = (np.median(colors[part], 0) for part in (
        skin & _vertices(head, "face")[head.faces].all(1) & ~apart.any(1), skin & _vertices(head, "scalp")[head.faces].all(1)
    ))  # fmt: skip
    change = hair - tone
    if np.linalg.norm(change) > _UNLIKE:
        least = np.where(brows.sum(1) > 1, _BROW, _HAIR) * (change @ change)
        parts[skin & ((colors - tone) @ change > least)] = "Hair"
    parts[skin & lips.all(1)] = "Lips"
    return parts


def _vertices(head: HeadModel, *regions: str) -> np.ndarray:
    """Which vertices lie in any of the regions, [V]."""
    inside = np.zeros(head.vertex_count, bool)
    for name in regions:
        inside[head.regions.get(name, ())] = True
    return inside


def _face_colors(head: HeadModel, painting: np.ndarray) -> np.ndarray:
    """Display color of the middle of each face, [F, 3]."""
    places = np.asarray(head.uv, np.float32)[head.uv_faces].mean(1) * len(painting)
    return bilinear(painting.astype(np.float32) / 255.0, places)


def _image(name: str, painting: np.ndarray) -> bpy.types.Image:
    height, width = painting.shape[:2]
    image = bpy.data.images.new(name, width, height)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = painting.astype(np.float32) / 255.0
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


def _shared(part: str, color: tuple[float, ...], roughness: float) -> bpy.types.Material:
    """The plain material of a part, which heads share, made on first use."""
    material = bpy.data.materials.get(f"GRMM {part}")
    if material is None or material.library is not None:
        material = _made(f"GRMM {part}", part, color, roughness)[0]
    return material


def _painted(name: str, part: str, image: bpy.types.Image, color: np.ndarray, roughness: float) -> bpy.types.Material:
    """A material with the painting as its texture; `color` [3], linear, is what solid view shows."""
    material, shader = _made(name, part, (*map(float, color), 1.0), roughness)
    nodes = material.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image, texture.location = image, (-320.0, 300.0)
    nodes.active = texture  # what solid view shows where it is set to textures
    material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return material


def _made(name: str, part: str, color: tuple[float, ...], roughness: float) -> tuple[bpy.types.Material, bpy.types.Node]:
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender 5 gives every material nodes
        material.use_nodes = True
    material[PART] = part
    material.diffuse_color, material.roughness = color, roughness
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = color
    shader.inputs["Roughness"].default_value = roughness
    return material, shader
