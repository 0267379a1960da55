"""A Curves object from a groom: on the head's surface, so that Blender's hair tools work on it, and moving with the head.

Blender's node *Deform Curves on Surface* carries the curves along. It compares the evaluated head with its resting mesh, for
which the head keeps its resting positions as an attribute.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator

import bpy
import numpy as np

from ...grmm_core.avatar import AssetReference, Hair
from ...grmm_core.controls.frame import Controls
from ...grmm_core.hair import SETTINGS, Groom, HairSettings, library_groom
from ...grmm_core.hair.body import worn
from ...grmm_core.hair.groom import join
from ...grmm_core.hair.knots import tied
from ...grmm_core.hair.pigment import ABSORPTION, BLOND, GINGER, GINGER_ABSORPTION, ROOT_SHADE, WHITE, albedos
from ...grmm_core.hair.prior import random_groom
from ...grmm_core.hair.roots import LASHES, SCALP
from .. import session_host
from ..linking import link_beside
from ..rig.avatar import Avatar
from ..rig.identity import load_head, own_hair
from ..rig.mesh import UV_NAME, to_blender
from .curve_children import OUT, Family, childless
from .curve_sliders import MODIFIER_NAME as SLIDERS
from .curve_sliders import PART, TIED, add_sliders
from .display import AS_SPLATS
from .grooms import NO_HAIR, OWN_HAIR, RANDOM_HAIR
from .read import DEFORM_NODE, HELD, HELD_PREFIX, MADE_OF, TINT, UV_COORDINATE, resting_vertices

GROUP_NAME = MODIFIER_NAME = "GRMM Surface Deform"
_DISPLAY_GAMMA = 2.2
_POINTS = 16  # of a curve that somebody will draw, about
_GLOSS, _GLINT = 0.6, 0.8  # roughness and specular level of the material: as soft and white as glints of splats


def worn_hair(avatar: Avatar) -> Hair | None:
    """Return the groom that an avatar wears where there are no curves, with the panel's settings; None for trained hair.

    With brows, beard and lashes, of which some may be in its Gaussians.

    Raises:
        GrmmError: The avatar's file cannot be read.
    """
    panel, own = avatar.object.grmm.hair, own_hair(avatar.source)
    settings = settings_of(panel)

    def of_own(group: int) -> list[Groom]:
        return [] if own is None or own.groom is None else [own.groom.select(own.groom.groups == group)]

    grooms = []
    if panel.groom == OWN_HAIR:
        if own is None or not own.scalp:
            return None
        grooms, settings = of_own(SCALP), own.settings if settings == HairSettings() else settings
    elif panel.groom != NO_HAIR:
        grooms = [random_groom(str(panel.seed)) if panel.groom == RANDOM_HAIR else library_groom(panel.groom)]
    for part, group in HELD.items():
        name = getattr(panel, part)
        if name != NO_HAIR:
            grooms += of_own(group) if name == OWN_HAIR else [library_groom(name, part=part)]
    grooms = [groom for groom in grooms if len(groom)]
    return Hair(join(grooms) if grooms else None, settings)


def settings_of(panel: bpy.types.PropertyGroup) -> HairSettings:
    """The sliders of the Hair panel."""
    return HairSettings(*(getattr(panel, row.name) for row in SETTINGS))


@contextlib.contextmanager
def selected_curves(avatar: Avatar) -> Iterator[None]:
    """Select the curves that an avatar's hair is, for Blender's exporters; a groom becomes curves for so long."""
    head = avatar.object
    obj, kept = head.grmm.hair.curves, head.add_rest_position_attribute
    worn = worn_hair(avatar) if obj is None else None
    made = make_curves(avatar, worn.groom, worn.settings) if worn is not None and worn.groom is not None else None
    obj = obj or made
    hidden = obj is not None and obj.hide_get()
    try:
        if obj is not None:
            obj.hide_set(False)
            obj.select_set(True)
        with childless(obj.modifiers.get(SLIDERS) if obj is not None else None):
            yield
    finally:
        if made is not None:
            _remove(made)
            head.add_rest_position_attribute = kept
        elif obj is not None:
            obj.hide_set(hidden)


def make_curves(
    avatar: Avatar, groom: Groom | None, settings: HairSettings | None = None, drawn: Groom | None = None
) -> bpy.types.Object:
    """Return a Curves object that stands on an avatar's head and is linked where the head is.

    Args:
        avatar: Whose mesh can be changed.
        groom: Its strands as recorded, or None for no curves yet; the curves are as they are drawn on this person.
        settings: Give the material its color.
        drawn: What `drawing` gave; None asks the session here.
    """
    head = avatar.object
    if groom is None or not len(groom):
        drawn = None
    elif drawn is None:
        drawn = drawing(avatar, groom)()
    data = bpy.data.hair_curves.new(f"{head.name} strands")
    obj = bpy.data.objects.new(data.name, data)
    try:
        _strand(data, head, drawn, settings or HairSettings())
        _put_on(obj, head, groom)
    except BaseException:
        _remove(obj)
        raise
    head.add_rest_position_attribute = True
    return obj


def _strand(data: bpy.types.Curves, head: bpy.types.Object, drawn: Groom | None, settings: HairSettings) -> None:
    """Give new curves their surface, strands, what these were made of, and a material."""
    data.surface, data.surface_uv_map = head, _uv_map(head)
    if drawn is not None:
        _fill(data, head, drawn)
        data[MADE_OF] = head.grmm.hair.groom
        for part, group in HELD.items():
            if group != LASHES or (drawn.groups == LASHES).any():  # usual ones, and those in Gaussians, stay what they are
                data[f"{HELD_PREFIX}{part}"] = getattr(head.grmm.hair, part)
    data.materials.append(_material(data.name, head, settings, drawn is not None and drawn.tints is not None))


def _put_on(obj: bpy.types.Object, head: bpy.types.Object, groom: Groom | None) -> None:
    """Fasten a new object of curves to a head, with sliders and what deforms it."""
    link_beside(obj, head)
    obj.parent = head
    obj.display_type = AS_SPLATS
    obj.lock_location = obj.lock_rotation = obj.lock_scale = (True, True, True)
    points = int(groom.counts.max()) if groom is not None and len(groom) else _POINTS
    model = load_head(AssetReference(head.grmm.head_name))
    add_sliders(obj, head, points, Family.of(groom, np.asarray(model.v_template, float), np.asarray(model.faces)))
    modifier = obj.modifiers.new(MODIFIER_NAME, "NODES")
    modifier.node_group = _deform_group()


def _remove(obj: bpy.types.Object) -> None:
    """Remove curves that `make_curves` made, as far as it came, with what is theirs alone."""
    data, materials, sliders = obj.data, list(obj.data.materials), obj.modifiers.get(SLIDERS)
    nodes = None if sliders is None else sliders.node_group
    bpy.data.objects.remove(obj)
    bpy.data.hair_curves.remove(data)
    if nodes is not None:
        bpy.data.node_groups.remove(nodes)
    for material in materials:
        bpy.data.materials.remove(material)


def drawing(avatar: Avatar, groom: Groom) -> Callable[[], Groom]:
    """Return what gives a groom outside of the person's skin and ended at the bust's rim; for any thread, asks the session."""
    if not avatar.has_network:
        return lambda: groom
    now, source = avatar.controls(bpy.context.evaluated_depsgraph_get()), avatar.source
    rest = Controls(shape=now.shape, z_id=now.z_id, residual_strength=now.residual_strength)
    model = load_head(AssetReference(avatar.object.grmm.head_name))

    def draw() -> Groom:
        still = session_host.get_session().deform(session_host.open_avatar(source).id, rest).vertices
        try:
            return worn(model, still, groom)
        except ImportError:  # a Blender that draws by another Python has no numba
            return groom

    return draw


def _fill(data: bpy.types.Curves, head: bpy.types.Object, groom: Groom) -> None:
    """Write a groom's strands, as they are on the resting mesh."""
    model = load_head(AssetReference(head.grmm.head_name))
    frames = groom.frames(np.asarray(model.v_template, float), np.asarray(model.faces))
    resting = resting_vertices(head)
    points = to_blender(groom.posed(frames, resting))
    corners = np.asarray(model.uv, np.float64)[np.asarray(model.uv_faces)[groom.triangles]]  # [N, 3, 2]
    places = (corners * groom.weights[..., None]).sum(1).astype(np.float32)
    ends = 0.5 * groom.widths[groom.strand_of_point]
    radii = ends[:, 0] + (ends[:, 1] - ends[:, 0]) * groom.along**2
    data.add_curves(groom.counts.tolist())
    data.attributes["position"].data.foreach_set("vector", points.ravel())
    rows = [
        (UV_COORDINATE, "FLOAT2", "CURVE", "vector", places),
        ("radius", "FLOAT", "POINT", "value", radii.astype(np.float32)),
    ]
    rows.append((OUT, "FLOAT_VECTOR", "CURVE", "vector", to_blender(frames.at(resting)[1][:, 2]).astype(np.float32)))
    rows.append((PART, "INT", "CURVE", "value", groom.groups.astype(np.int32) + 1))
    rows.append((TIED, "BOOLEAN", "CURVE", "value", tied(groom, np.asarray(model.v_template, float), model.faces)))
    tints = groom.point_tints
    if tints is not None:
        rows.append((TINT, "FLOAT_VECTOR", "POINT", "vector", tints))
    for name, kind, domain, field, values in rows:
        (data.attributes.get(name) or data.attributes.new(name, kind, domain)).data.foreach_set(field, values.ravel())
    data.update_tag()


def _uv_map(head: bpy.types.Object) -> str:
    layers = head.data.uv_layers
    return UV_NAME if UV_NAME in layers else layers.active.name if layers.active is not None else ""


def _deform_group() -> bpy.types.NodeTree:
    """The node group that makes curves follow their surface; one for all."""
    known = bpy.data.node_groups.get(GROUP_NAME)
    if known is not None and any(node.bl_idname == DEFORM_NODE for node in known.nodes):
        return known
    group = bpy.data.node_groups.new(GROUP_NAME, "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    nodes = [group.nodes.new(kind) for kind in ("NodeGroupInput", DEFORM_NODE, "NodeGroupOutput")]
    for number, node in enumerate(nodes):
        node.location.x = 220.0 * number
    for before, after in itertools.pairwise(nodes):
        group.links.new(before.outputs[0], after.inputs[0])
    group.is_modifier = True
    return group


def _material(name: str, head: bpy.types.Object, settings: HairSettings, tinted: bool) -> bpy.types.Material:
    """What Cycles and EEVEE draw the curves with: in the color of the panel's sliders, where these are what is worn.

    Args:
        name: Of the material.
        head: With the sliders.
        settings: That are worn.
        tinted: The curves have `TINT`, as hair of a photo.
    """
    material = bpy.data.materials.new(name)
    color = albedos(settings, np.zeros(1), np.full((1, 2), 0.5))[0].mean(0)
    material.diffuse_color = (*color, 1.0)
    material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    socket = shader.inputs["Base Color"]
    if tinted:
        socket = _tinted_color(material.node_tree, socket)
    socket.default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value, shader.inputs["Specular IOR Level"].default_value = _GLOSS, _GLINT
    if settings == settings_of(head.grmm.hair):
        for channel in range(3):
            _drive_color(socket, channel, head)
    return material


def _tinted_color(tree: bpy.types.NodeTree, socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Let `TINT` be added to a color in display space, and clipped there; returns the socket that the color then has."""
    kinds = ("RGB", "Gamma", "VectorMath", "VectorMath", "Gamma")
    color, display, add, clip, linear = (tree.nodes.new(f"ShaderNode{kind}") for kind in kinds)
    tint = tree.nodes.new("ShaderNodeAttribute")
    tint.attribute_name = TINT
    display.inputs["Gamma"].default_value, linear.inputs["Gamma"].default_value = 1.0 / _DISPLAY_GAMMA, _DISPLAY_GAMMA
    clip.operation = "MAXIMUM"
    clip.inputs[1].default_value = (0.0, 0.0, 0.0)
    steps = [
        (color.outputs[0], display.inputs["Color"]), (display.outputs[0], add.inputs[0]),
        (tint.outputs["Vector"], add.inputs[1]), (add.outputs[0], clip.inputs[0]),
        (clip.outputs[0], linear.inputs["Color"]), (linear.outputs[0], socket),
    ]  # fmt: skip
    for source, target in steps:
        tree.links.new(source, target)
    for number, node in enumerate((color, tint, display, add, clip, linear)):
        node.location = (180.0 * number - 1300.0, 0.0)
    return color.outputs[0]


def _drive_color(socket: bpy.types.NodeSocket, channel: int, head: bpy.types.Object) -> None:
    """Let a channel of a color follow the sliders: `pigment.albedos`, in what Blender computes without running scripts."""
    driver = socket.driver_add("default_value", channel).driver
    dye = ("dye_red", "dye_green", "dye_blue")[channel]
    for letter, name in zip("mrgdxt", ("melanin", "redness", "grey", "dye", dye, "tips"), strict=True):
        variable = driver.variables.new()
        variable.name = letter
        variable.targets[0].id, variable.targets[0].data_path = head, f"grmm.hair.{name}"
    grown = f"(1-r)*{BLOND[channel]}*exp(-{ABSORPTION[channel]}*m)+r*{GINGER[channel]}*exp(-{GINGER_ABSORPTION}*m)"
    color = f"((({grown})*(1-g)+g*{WHITE[channel]})*(1-d)+d*pow((x+.055)/1.055,2.4))"
    driver.expression = f"{color}*.5*({ROOT_SHADE}+(1+1.2*max(t,0))*(1+.7*min(t,0)))+.025*max(t,0)"
