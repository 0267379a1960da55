"""The expression space: 52 ARKit shapes and 48 further components, split into joint rotations and vertex directions.

A sculpted shape that turns the jaw or an eye is taken apart: the rotation (Procrustes on the lower teeth or the eyeball) goes
to `expression_pose`, and what linear blend skinning with that rotation leaves over, taken back through the inverse of the
blended transform, becomes the vertex direction. At weight 1 the two together give the sculpted shape exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.geometry.rotations import euler_to_matrix
from grmm_core.head.skinning import joint_transforms, skin

from .parts import InnerParts
from .source import Source
from .topology import DECIMETRE, Topology

JAW, LEFT_EYE, RIGHT_EYE = 2, 3, 4
PARENTS = (-1, 0, 1, 1, 1)
NECK_BONES = {"neck01": 0.33, "neck02": 0.67, "neck03": 1.0}
# Bones of the face count fully for the head; those of the trunk and arms stay with the root.
TRUNK = ("spine", "clavicle", "shoulder", "breast", "upperarm", "root", "pelvis")
JAW_SHAPES = ("jawOpen", "jawLeft", "jawRight")
# The source's eyes turn 10 to 15 degrees at weight 1; faces tracked by ARKit turn theirs about 25. The lids follow less.
GAZE_GAIN = 1.7
LID_GAIN = 1.3
TONGUE_JAW = 0.24  # of jawOpen
TONGUE_REACH = (0.0, 0.005, 0.009)  # metres at the tip
UNIT_FOLDERS = ("african", "asian", "caucasian")
# Components made of modelling targets that a living face can also do.
MODELLED = {
    "cheekSuckLeft": ("cheek/l-cheek-inner-decr", 0.8), "cheekSuckRight": ("cheek/r-cheek-inner-decr", 0.8),
    "lipUpperThin": ("mouth/mouth-upperlip-volume-decr", 0.8), "lipLowerThin": ("mouth/mouth-lowerlip-volume-decr", 0.8),
    "eyeBagLeft": ("eyes/l-eye-bag-incr", 0.8), "eyeBagRight": ("eyes/r-eye-bag-incr", 0.8),
    "neckTense": ("neck/neck-scale-depth-incr", 0.35), "neckBreathe": ("neck/neck-scale-horiz-incr", 0.35),
}  # fmt: skip
# Tongue components: Euler angles in radians reached at the tip (quadratic from the root).
TONGUE = {
    "tongueUp": (-0.55, 0.0, 0.0), "tongueDown": (0.3, 0.0, 0.0),
    "tongueLeft": (0.0, 0.4, 0.0), "tongueRight": (0.0, -0.4, 0.0),
    "tongueCurl": (-1.1, 0.0, 0.0), "tongueTwist": (0.0, 0.0, 0.6),
}  # fmt: skip


@dataclass
class ExpressionSpace:
    """Joints, weights and expression components of the open head.

    Attributes:
        names: Component names, E.
        sculpted: What each component does at weight 1 on the template, metres, [E, V, 3].
        directions: Vertex part, [V, 3, E].
        pose: Euler angles per unit weight, [E, 5, 3].
        joints: Rest joints of the template, [5, 3].
        weights: Skinning weights, [V, 5].
    """

    names: tuple[str, ...]
    sculpted: np.ndarray
    directions: np.ndarray
    pose: np.ndarray
    joints: np.ndarray
    weights: np.ndarray


def build_expression_space(source: Source, topology: Topology, parts: InnerParts, template: np.ndarray) -> ExpressionSpace:
    """Split every sculpted shape of the source on the template [V, 3]."""
    base = parts.base
    names, sculpted = _sculpted(source, topology, parts, template)
    lower = topology.parts["lower_teeth"]
    rotation, shift = rigid_fit(base[lower], sculpted[names.index("jawOpen")][lower])
    joints = _rest_joints(source, topology, template, base, rotation, shift)
    offset = template - base  # the template's person is another than the base mesh; pivots move along
    pivot_base = joints[JAW] - _jaw_shift(topology, offset)
    pose = np.zeros((len(names), 5, 3))
    for name in JAW_SHAPES:
        teeth = topology.parts["lower_teeth"]
        arms = base[teeth] - pivot_base
        fitted, _ = rigid_fit(arms, sculpted[names.index(name)][teeth], fixed=True)
        pose[names.index(name), JAW] = matrix_to_euler(fitted)
    for side, joint in (("Left", LEFT_EYE), ("Right", RIGHT_EYE)):
        part = topology.parts[f"{side.lower()}_eyeball"]
        arms = base[part] - base[part].mean(0)
        for index, name in enumerate(names[:52]):
            if name.startswith("eyeLook") and name.endswith(side):
                fitted, _ = rigid_fit(arms, _raw_target(source, topology, name)[part], fixed=False)
                pose[index, joint] = GAZE_GAIN * matrix_to_euler(fitted)
                sculpted[index] *= LID_GAIN
    # mirrored shapes get mirrored angles
    for index, name in enumerate(names[:52]):
        if name.endswith("Left"):
            other = names.index(name[:-4] + "Right")
            joint_map = (0, 1, 2, 4, 3)
            flipped = pose[other][list(joint_map)] * (1, -1, -1)
            pose[index] = 0.5 * (pose[index] + flipped)
            pose[other] = pose[index][list(joint_map)] * (1, -1, -1)
    open_pose = pose[names.index("jawOpen"), JAW]
    open_pose[1:] = 0.0
    weights = _weights(source, topology, template, joints[JAW], euler_to_matrix(open_pose), sculpted[names.index("jawOpen")])

    for index, name in enumerate(names):
        for side, joint in (("left", LEFT_EYE), ("right", RIGHT_EYE)):
            part = topology.parts[f"{side}_eyeball"]
            turn = euler_to_matrix(pose[index, joint])
            sculpted[index][part] = (template[part] - joints[joint]) @ (turn - np.eye(3)).T
        if name in JAW_SHAPES:  # teeth are rigid: exactly the joint's motion
            part = topology.parts["lower_teeth"]
            sculpted[index][part] = (template[part] - joints[JAW]) @ (euler_to_matrix(pose[index, JAW]) - np.eye(3)).T
    _free_tongue(topology, names, template, sculpted, pose, joints, weights)
    directions = np.stack([unpose(template, sculpted[i], pose[i], joints, weights) for i in range(len(names))], -1)
    return ExpressionSpace(tuple(names), sculpted, directions, pose, joints, weights)


def _free_tongue(
    topology: Topology,
    names: list[str],
    template: np.ndarray,
    sculpted: np.ndarray,
    pose: np.ndarray,
    joints: np.ndarray,
    weights: np.ndarray,
) -> None:
    """Let tongueOut open the jaw a little and reach over the lower lip; the source's tongue passes through closed lips.

    Changes `sculpted` and `pose`.
    """
    tongue, jaw = names.index("tongueOut"), names.index("jawOpen")
    unposed = TONGUE_JAW * unpose(template, sculpted[jaw], pose[jaw], joints, weights) + sculpted[tongue]
    unposed[topology.parts["tongue"]] += tongue_reach(template[topology.parts["tongue"]])
    pose[tongue] = TONGUE_JAW * pose[jaw]
    transforms = joint_transforms(euler_to_matrix(pose[tongue]), joints, PARENTS)
    sculpted[tongue] = skin(template + unposed, transforms, weights) - template


def tongue_reach(points: np.ndarray) -> np.ndarray:
    """What tongueOut adds to the source's shape at tongue vertices [n, 3]: forwards and up, from the root to the tip."""
    low, high = points[:, 2].min(), points[:, 2].max()
    along = np.clip((points[:, 2] - low) / (0.8 * (high - low)), 0.0, 1.0)
    return (along**2 * (3 - 2 * along))[:, None] * np.array(TONGUE_REACH)


def unpose(template: np.ndarray, sculpted: np.ndarray, pose: np.ndarray, joints: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the offsets [V, 3] before skinning that give `template + sculpted` after skinning with `pose` [5, 3]."""
    transforms = joint_transforms(euler_to_matrix(pose), joints, PARENTS)  # [5, 3, 4]
    blended = np.einsum("vj,jab->vab", weights, transforms)
    wanted = template + sculpted - blended[:, :, 3]
    return np.linalg.solve(blended[:, :, :3], wanted[..., None])[..., 0] - template


def rigid_fit(points: np.ndarray, offsets: np.ndarray, fixed: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Best rotation R and shift t with R p + t = p + offset (Kabsch); t = 0 where `fixed` (rotation about the origin)."""
    moved = points + offsets
    first = np.zeros(3) if fixed else points.mean(0)
    second = np.zeros(3) if fixed else moved.mean(0)
    left, _, right = np.linalg.svd((points - first).T @ (moved - second))
    sign = np.diag([1, 1, np.sign(np.linalg.det(right.T @ left.T))])
    rotation = right.T @ sign @ left.T
    return rotation, second - rotation @ first


def matrix_to_euler(matrix: np.ndarray) -> np.ndarray:
    """XYZ Euler angles of R = Rz Ry Rx, [3]."""
    return np.array([
        np.arctan2(matrix[2, 1], matrix[2, 2]),
        -np.arcsin(np.clip(matrix[2, 0], -1, 1)),
        np.arctan2(matrix[1, 0], matrix[0, 0]),
    ])  # fmt: skip


def _raw_target(source: Source, topology: Topology, name: str) -> np.ndarray:
    return DECIMETRE * (topology.matrix @ source.target(f"faceunits01/targets/faceunits/{name}.target"))


def _sculpted(source: Source, topology: Topology, parts: InnerParts, template: np.ndarray) -> tuple[list[str], np.ndarray]:
    project = parts.keep_spheres
    names = list(ARKIT_NAMES)
    offsets = [_raw_target(source, topology, name) for name in names]
    for path in source.target_names("expression/units/caucasian"):
        mean = sum(source.target(path.replace("caucasian", folder)) for folder in UNIT_FOLDERS) / len(UNIT_FOLDERS)
        names.append("unit" + "".join(word.capitalize() for word in path.rsplit("/", 1)[1].split(".")[0].split("-")))
        offsets.append(project(DECIMETRE * (topology.matrix @ mean)))
    for name, angles in TONGUE.items():
        names.append(name)
        offsets.append(_bend_tongue(topology, template, np.array(angles)))
    for name, (path, weight) in MODELLED.items():
        names.append(name)
        offsets.append(weight * project(DECIMETRE * (topology.matrix @ source.target(f"mpfb2/targets/{path}.target.gz"))))
    return names, np.array(offsets)


def _bend_tongue(topology: Topology, template: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Bend the tongue about its middle third; the angle grows quadratically to the tip. [V, 3]."""
    part = topology.parts["tongue"]
    points = template[part]
    low, high = points[:, 2].min(), points[:, 2].max()
    along = np.clip((points[:, 2] - (low + 0.35 * (high - low))) / (0.65 * (high - low)), 0, 1)
    pivot = np.array([0.0, np.median(points[:, 1][along < 0.2]), low + 0.35 * (high - low)])
    if angles[2]:
        pivot[1] = points[along > 0.5, 1].mean()
    turns = euler_to_matrix(angles * (along**1.5)[:, None])
    offsets = np.zeros_like(template)
    offsets[part] = np.einsum("vab,vb->va", turns, points - pivot) + pivot - points
    return offsets


def _jaw_shift(topology: Topology, offset: np.ndarray) -> np.ndarray:
    """How far the jaw's pivot of the base mesh moves for the template: with the teeth's back ends."""
    return 0.5 * (offset[topology.parts["lower_teeth"]].mean(0) + offset[topology.parts["upper_teeth"]].mean(0)) * (0, 1, 1)


def _rest_joints(
    source: Source, topology: Topology, template: np.ndarray, base: np.ndarray, rotation: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    offset = template - base
    # the hinge of jawOpen in the yz plane: the point that the rigid motion leaves in place
    system = (np.eye(3) - rotation)[1:, 1:]
    hinge = np.array([0.0, *np.linalg.solve(system, shift[1:])])
    neck_cube = DECIMETRE * source.vertices[np.unique(source.groups["joint-neck"])].mean(0)
    skin = topology.parts["skin"]
    near = skin[np.argsort(np.linalg.norm((base[skin] - neck_cube) * (0.2, 1, 1), axis=1))[:60]]
    neck = neck_cube + offset[near].mean(0)
    joints = np.zeros((5, 3))
    joints[1] = (0.0, neck[1], neck[2])
    joints[0] = (0.0, neck[1] - 0.05, neck[2] - 0.01)
    joints[2] = hinge + _jaw_shift(topology, offset)
    joints[3] = template[topology.parts["left_eyeball"]].mean(0)
    joints[4] = template[topology.parts["right_eyeball"]].mean(0)
    return joints


def _weights(
    source: Source, topology: Topology, template: np.ndarray, pivot: np.ndarray, turn: np.ndarray, jaw_open: np.ndarray
) -> np.ndarray:
    """Skinning weights [V, 5]: neck from the rig, jaw from how far the sculpted jawOpen follows the jaw's rotation."""
    bones = {name: topology.matrix @ weights for name, weights in source.bone_weights().items()}
    trunk = sum(w for name, w in bones.items() if name.startswith(TRUNK))
    head = 1.0 - trunk - sum((1 - share) * bones[name] for name, share in NECK_BONES.items())
    arms = (template - pivot) @ (turn - np.eye(3)).T
    jaw = (jaw_open * arms).sum(1) / ((arms**2).sum(1) + 0.002**2)
    jaw = np.clip(jaw, 0.0, 1.0)
    jaw = _smooth(jaw, topology.faces, topology.parts["skin"], steps=2)
    jaw[topology.parts["lower_teeth"]] = 1.0
    jaw[topology.parts["tongue"]] = np.clip(jaw[topology.parts["tongue"]] * 1.05, 0.0, 1.0)
    for part in ("upper_teeth", "lashes", "left_eyeball", "right_eyeball"):
        jaw[topology.parts[part]] = 0.0
    for part, indices in topology.parts.items():
        if part != "skin":
            head[indices] = 1.0
    head = np.clip(head, 0.0, 1.0)
    jaw = np.minimum(jaw, head)
    weights = np.stack([1 - head, head - jaw, jaw, np.zeros_like(jaw), np.zeros_like(jaw)], 1)
    for part, joint in (("left_eyeball", LEFT_EYE), ("right_eyeball", RIGHT_EYE)):
        weights[topology.parts[part]] = np.eye(5)[joint]
    return weights / weights.sum(1, keepdims=True)


def _smooth(values: np.ndarray, faces: np.ndarray, part: np.ndarray, steps: int) -> np.ndarray:
    """Average with the neighbours inside one part; elsewhere unchanged."""
    inside = np.zeros(len(values), bool)
    inside[part] = True
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[inside[edges].all(1)]
    result = values.copy()
    for _ in range(steps):
        total, count = np.zeros_like(values), np.zeros_like(values)
        for a, b in (edges.T, edges.T[::-1]):
            np.add.at(total, a, result[b])
            np.add.at(count, a, 1.0)
        result = np.where(count > 0, 0.5 * result + 0.5 * total / np.maximum(count, 1), result)
    return result


def component_groups(names: Sequence[str]) -> dict[str, str]:
    """Return where each component comes from, for the asset's metadata."""
    groups = {}
    for name in names:
        if name in ARKIT_NAMES:
            groups[name] = "arkit"
        elif name.startswith("unit"):
            groups[name] = "mpfb expression unit"
        elif name in TONGUE:
            groups[name] = "tongue bend"
        else:
            groups[name] = "modelling target"
    return groups
