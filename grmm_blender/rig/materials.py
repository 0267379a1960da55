"""What the mesh of a head looks like where no splats are drawn: in EEVEE and Cycles, and in solid view without a runtime.

A painting of the person on the UV map, from the avatar's file or drawn by `repaint`, becomes the texture of the head's own
materials, one for each part that solid view, which shows one color a material, has to tell apart: hair, brows and beard, lips,
irises, pupils. Paintings show people in the studio's light, which is taken off, for Blender puts the scene's on. A head without
a painting (a user's FLAME file, random people at first) has a plain face.
"""

from __future__ import annotations

import bpy
import numpy as np

from ...grmm_core.controls.names import JOINT_NAMES
from ...grmm_core.head import HeadModel
from ...grmm_core.model.plain_face import IRIS_DEGREES, PUPIL_DEGREES, UNLIKE, accented, plain_face, unlit
from ...grmm_core.pictures.color import srgb_to_linear
from ...grmm_core.pictures.sampling import bilinear
from .identity import Identity

PART = "grmm_part"  # custom property of a material: which part of a head it was made for
_PLAIN_FACE = "grmm_plain"  # custom property of an image: a plain face where there could be a painting
_LIT = "grmm_lit"  # likewise: a painting off which the studio's light is still to be taken
# part, words of its regions; of parts that heads share: color (linear) and alpha, roughness
_PLAIN = (
    ("Teeth", ("teeth",), (0.72, 0.68, 0.58, 1.0), 0.25),
    ("Back Teeth", (), (0.16, 0.1, 0.085, 1.0), 0.5),  # as in the shade of lips and cheeks, which solid view does not have
    ("Mouth", ("mouth_interior", "tongue"), (0.38, 0.11, 0.1, 1.0), 0.35),
    ("Lashes", ("lash",), (0.03, 0.02, 0.015, 0.15), 0.6),  # sheets: opaque ones look like paint on the lids
)
_PAINTED = {"Skin": 0.5, "Eyes": 0.1, "Irises": 0.1, "Pupils": 0.1, "Lips": 0.35, "Hair": 0.7}  # roughness
_IRIS, _PUPIL = np.cos(np.radians((IRIS_DEGREES, PUPIL_DEGREES)))
_HAIR, _BROW = 0.5, 0.15  # how far from skin to hair a face's color is that counts as hair; brows are narrower than faces
_FRONT_TEETH = 0.009  # metres from the foremost tooth back; those behind show at the corners of lips that do not quite meet
_WHITEST = 0.75  # quantile of an eye's colors: lashes shade most of the white


def add_materials(mesh: bpy.types.Mesh, identity: Identity, flat: np.ndarray | None = None, soon: bool | None = None) -> None:
    """Give the parts of a head's mesh materials; a mesh that has others than these keeps them.

    Args:
        mesh: The head's.
        identity: Of the person.
        flat: `albedo` of the person's painting, where it is known.
        soon: Where it is not, leave the light on the painting for now; `is_lit` says so, and `repaint` has it taken off. None:
            in a window, which would stand still meanwhile.
    """
    if any(material is None or not (PART in material or material.name.startswith("GRMM ")) for material in mesh.materials):
        return
    painting = plain_face(identity.head) if identity.painting is None else accented(identity.head, identity.painting)
    colors = _face_colors(identity.head, painting)
    parts = _parts(identity.head, colors)
    used = [name for name in (*_PAINTED, *(name for name, *_ in _PLAIN)) if (parts == name).any()]
    _remove_painted(mesh)
    soon = not bpy.app.background if soon is None else soon
    if identity.painting is None or (flat is None and soon):
        image = _image(f"{identity.name} painting", painting)
        if identity.painting is not None:
            image[_LIT] = True
        elif identity.z_exp_size:
            image[_PLAIN_FACE] = True
    else:
        image = _image(f"{identity.name} painting", albedo(identity) if flat is None else flat)
    shared = {name: (color, roughness) for name, _, color, roughness in _PLAIN}
    for name in used:
        if name in shared:
            material = _shared(name, *shared[name])
        else:
            color = srgb_to_linear(np.quantile(colors[parts == name], _WHITEST if name == "Eyes" else 0.5, axis=0))
            material = _painted(f"{identity.name} {name}", name, image, color, _PAINTED[name])
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", np.array([used.index(name) for name in parts], np.int32))


def _remove_painted(mesh: bpy.types.Mesh) -> None:
    """Take all materials from a mesh; those that were painted for it alone go, with their picture, so that names are free."""
    painted = [material for material in mesh.materials if material.get(PART) in _PAINTED]
    images = {image for material in painted for image in _images(material)}
    mesh.materials.clear()
    bpy.data.batch_remove([material for material in painted if not material.users])
    bpy.data.batch_remove([image for image in images if not image.users])


def albedo(identity: Identity) -> np.ndarray:
    """A person's painting without the studio's light. Takes seconds the first time; touches no data of Blender."""
    if identity.painting is None:
        raise ValueError(f"{identity.name} has no painting.")
    return unlit(identity.head, identity.vertices, accented(identity.head, identity.painting))


def take_light_off(mesh: bpy.types.Mesh, flat: np.ndarray) -> None:
    """Put a painting's `albedo` in its place."""
    for image in _marked(mesh, _LIT):
        _paint(image, flat)
        del image[_LIT]


def is_plain(mesh: bpy.types.Mesh) -> bool:
    """Whether a head has a plain face though a network could draw the person."""
    return bool(_marked(mesh, _PLAIN_FACE))


def is_lit(mesh: bpy.types.Mesh) -> bool:
    """Whether the studio's light is still on a head's painting."""
    return bool(_marked(mesh, _LIT))


def _marked(mesh: bpy.types.Mesh, mark: str) -> set[bpy.types.Image]:
    return {image for material in mesh.materials if material for image in _images(material) if mark in image}


def _images(material: bpy.types.Material) -> list[bpy.types.Image]:
    nodes = material.node_tree.nodes if material.node_tree else ()
    return [node.image for node in nodes if node.type == "TEX_IMAGE" and node.image]


def _parts(head: HeadModel, colors: np.ndarray) -> np.ndarray:
    """Name of the part of each face, [F], by where it is, and hair by its color [F, 3].

    A face belongs to a part when all its corners do.
    """
    parts = np.full(len(head.faces), "Skin", dtype="<U10")
    for name, words in (("Eyes", ("eye",)), *((name, words) for name, words, *_ in _PLAIN)):
        regions = [region for region in head.regions if "lid" not in region and any(word in region for word in words)]
        parts[head.marked(*regions)[head.faces].all(1)] = name
    ahead, teeth = head.v_template[head.faces].mean(1)[:, 2], parts == "Teeth"
    parts[teeth & (ahead < ahead.max(where=teeth, initial=-np.inf) - _FRONT_TEETH)] = "Back Teeth"
    joints = head.joints(np.zeros(head.shape_count, np.float32))
    for side in ("left", "right"):
        ball = head.marked(f"{side}_eyeball")[head.faces].all(1)
        centre = joints[JOINT_NAMES.index(f"{side}_eye")]
        ways = head.v_template[head.faces].mean(1) - centre
        ahead = ways[:, 2] / np.linalg.norm(ways, axis=1)  # eyes look along +z
        for name, least in (("Irises", _IRIS), ("Pupils", _PUPIL)):
            parts[ball & (ahead > least)] = name
    skin = parts == "Skin"
    lips, brows, apart = (head.marked(*names)[head.faces] for names in (("lips",), ("brows",), ("lips", "lids", "brows")))
    tone, hair = (np.median(colors[part], 0) for part in (
        skin & head.marked("face")[head.faces].all(1) & ~apart.any(1), skin & head.marked("scalp")[head.faces].all(1)
    ))  # fmt: skip
    change = hair - tone
    if np.linalg.norm(change) > UNLIKE:
        least = np.where(brows.sum(1) > 1, _BROW, _HAIR) * (change @ change)
        parts[skin & ((colors - tone) @ change > least)] = "Hair"
    parts[skin & lips.all(1)] = "Lips"
    return parts


def _face_colors(head: HeadModel, painting: np.ndarray) -> np.ndarray:
    """Display color of the middle of each face, [F, 3]."""
    places = np.asarray(head.uv, np.float32)[head.uv_faces].mean(1) * len(painting)
    return bilinear(painting.astype(np.float32) / 255.0, places)


def _image(name: str, painting: np.ndarray) -> bpy.types.Image:
    height, width = painting.shape[:2]
    image = bpy.data.images.new(name, width, height)
    _paint(image, painting)
    return image


def _paint(image: bpy.types.Image, painting: np.ndarray) -> None:
    pixels = np.ones((*painting.shape[:2], 4), np.float32)
    pixels[..., :3] = painting.astype(np.float32) / 255.0
    image.pixels.foreach_set(pixels.ravel())
    image.pack()


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
    shader.inputs["Alpha"].default_value = color[3]
    shader.inputs["Roughness"].default_value = roughness
    return material, shader
