"""Points on a head model, such as its 478 landmarks, as functions of its parameters, with exact derivatives.

Linear blend skinning is linear in the unposed vertices, so a point on a triangle (a barycentric mix of three vertices) is a sum
over joints of the joint's transform applied to one mixed point: a few points per joint stand for the whole mesh, and for fixed
joint angles they are linear in shape and expression. Used by `solver` and the stages. Needs numpy only, float64.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from ..errors import ShapeError
from ..geometry.rotations import euler_to_matrix
from ..geometry.triangles import face_normals, spread_to_corners
from ..head.head_model import JOINT_COUNT, HeadModel
from ..head.skinning import joint_transforms

_ANGLE_STEP = 1e-5  # radians; central differences in float64 are exact to 1e-9 of a metre
_SMALL_WEIGHT = 1e-9


@dataclass(frozen=True)
class _JointPart:
    """What one joint moves: weighted points, linear in the coefficients.

    Attributes:
        joint: Its index.
        mass: Total weight in each point, [N].
        template: Weighted template points, [N, 3].
        directions: Weighted shape and expression directions, [N * 3, S + E].
        posedirs: Weighted pose-corrective directions, [N, 3, 36], or None.
    """

    joint: int
    mass: np.ndarray
    template: np.ndarray
    directions: np.ndarray
    posedirs: np.ndarray | None


class PointRig:
    """Points on the triangles of a head model.

    Attributes:
        head: The model.
        count: Number of points N.
        shape_count, expression_count: S and E.
    """

    def __init__(self, head: HeadModel, triangles: np.ndarray, barycentric: np.ndarray) -> None:
        """Reduce `head` to points.

        Args:
            head: Head model.
            triangles: Triangle of each point, [N].
            barycentric: Its place there, [N, 3].
        """
        self.head = head
        self.count = len(triangles)
        self.shape_count, self.expression_count = head.shape_count, head.expression_count
        corners = head.faces[triangles]  # [N, 3]
        self._parents = head.parents.tolist()
        self._joint_template = head.joint_template.astype(np.float64)  # [5, 3]
        self._joint_dirs = head.joint_dirs.astype(np.float64)  # [5, 3, S]
        self._expression_pose = head.expression_pose.astype(np.float64)  # [E, 5, 3]
        self._parts: list[_JointPart] = []
        for joint in range(JOINT_COUNT):
            weight = head.weights[corners, joint].astype(np.float64) * barycentric  # [N, 3]
            if np.abs(weight).max(initial=0.0) < _SMALL_WEIGHT:
                continue
            directions = np.concatenate(
                [np.einsum("nk,nkxs->nxs", weight, array[corners]) for array in (head.shape_dirs, head.expression_dirs)], axis=2
            )
            posedirs = None if head.posedirs is None else np.einsum("nk,nkxp->nxp", weight, head.posedirs[corners])
            template = np.einsum("nk,nkx->nx", weight, head.v_template[corners])
            flat = directions.reshape(self.count * 3, -1)
            self._parts.append(_JointPart(joint, weight.sum(1), template, flat, posedirs))

    def of_person(self, shape: np.ndarray, gain: np.ndarray) -> Self:
        """The same points of one person: no shape is left to find, and only the first components of expression are.

        Args:
            shape: [S].
            gain: How far each component that is kept goes on this person, [<=E].
        """
        rig, expressions = copy.copy(self), len(gain)
        rig.shape_count, rig.expression_count = 0, expressions
        rig._joint_template, rig._joint_dirs = self._joints(shape), self._joint_dirs[..., :0]
        rig._expression_pose = self._expression_pose[:expressions] * gain[:, None, None]
        split, end = self.shape_count, self.shape_count + expressions
        rig._parts = [
            replace(
                part,
                template=part.template + (part.directions[:, :split] @ shape).reshape(-1, 3),
                directions=np.ascontiguousarray(part.directions[:, split:end] * gain),
            )
            for part in self._parts
        ]
        return rig

    def positions(self, shape: np.ndarray, expression: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Points in head space.

        Args:
            shape: [S].
            expression: [E].
            pose: Control angles, on top of what the expression turns, radians, [5, 3].

        Returns:
            Metres, [N, 3].
        """
        points = self._unposed(np.concatenate([shape, expression]))
        return self._skinned(points, self._joints(shape), self._total_pose(expression, pose))

    def linearise(
        self, shape: np.ndarray, expression: np.ndarray, pose: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Points and their derivatives.

        Args:
            shape: [S].
            expression: [E].
            pose: Control angles in radians, [5, 3].

        Returns:
            Points [N, 3]; derivatives by shape [N, 3, S], expression [N, 3, E] and the angles [N, 3, 5, 3].
        """
        joints = self._joints(shape)
        total = self._total_pose(expression, pose)
        points = self._unposed(np.concatenate([shape, expression]))
        positions = self._skinned(points, joints, total)
        rotations = euler_to_matrix(total)
        transforms = joint_transforms(rotations, joints, self._parents)  # [5, 3, 4]
        count = self.shape_count + self.expression_count
        derivative = np.zeros((self.count, 3, count))
        for part in self._parts:
            local = part.directions.reshape(self.count, 3, count)
            rotation = transforms[part.joint, :, :3]
            if np.abs(rotation - np.eye(3)).max() < _SMALL_WEIGHT:
                derivative += local
            else:
                derivative += np.matmul(rotation, local)
        # the rest joints move with the shape; the transforms' shifts are linear in them
        repeated = np.broadcast_to(rotations, (self.shape_count, JOINT_COUNT, 3, 3))
        moved = joint_transforms(repeated, self._joint_dirs.transpose(2, 0, 1), self._parents)[:, :, :, 3]  # [S, 5, 3]
        for part in self._parts:
            derivative[:, :, : self.shape_count] += np.einsum("n,sx->nxs", part.mass, moved[:, part.joint])
        by_angle = np.zeros((self.count, 3, JOINT_COUNT, 3))
        for part in self._parts:
            for axis in range(3):
                step = np.zeros((JOINT_COUNT, 3))
                step[part.joint, axis] = _ANGLE_STEP
                difference = self._skinned(points, joints, total + step) - self._skinned(points, joints, total - step)
                by_angle[:, :, part.joint, axis] = difference / (2.0 * _ANGLE_STEP)
        by_expression = derivative[:, :, self.shape_count :]
        by_expression += np.tensordot(by_angle, self._expression_pose, axes=([2, 3], [1, 2]))
        return positions, derivative[:, :, : self.shape_count], by_expression, by_angle

    def _total_pose(self, expression: np.ndarray, pose: np.ndarray) -> np.ndarray:
        return pose + np.tensordot(expression, self._expression_pose, axes=1)

    def _joints(self, shape: np.ndarray) -> np.ndarray:
        return self._joint_template + self._joint_dirs @ shape

    def _unposed(self, coefficients: np.ndarray) -> list[np.ndarray]:
        """Weighted unposed points of each part, [N, 3] each."""
        return [part.template + (part.directions @ coefficients).reshape(-1, 3) for part in self._parts]

    def _skinned(self, points: list[np.ndarray], joints: np.ndarray, pose: np.ndarray) -> np.ndarray:
        rotations = euler_to_matrix(pose)
        transforms = joint_transforms(rotations, joints, self._parents)
        feature = (rotations[1:] - np.eye(3)).reshape(-1)  # [36]
        result = np.zeros((self.count, 3))
        for part, local in zip(self._parts, points, strict=True):
            if part.posedirs is not None:
                local = local + part.posedirs @ feature
            transform = transforms[part.joint]
            result += local @ transform[:, :3].T + part.mass[:, None] * transform[:, 3]
        return result


class LandmarkRig(PointRig):
    """The 478 landmarks of a head model.

    Attributes:
        normals: Outward normals of the mean head at the landmarks, [478, 3].
    """

    def __init__(self, head: HeadModel) -> None:
        """Reduce `head` to its landmarks.

        Raises:
            ShapeError: The head model has no 478 landmarks.
        """
        if head.landmarks478 is None:
            raise ShapeError(f"The head model {head.name} has no 478 landmarks, so photos cannot be fitted with it.")
        triangles, barycentric = head.landmarks478
        super().__init__(head, triangles, barycentric)
        summed = spread_to_corners(face_normals(head.v_template.astype(np.float64), head.faces), head.faces, head.vertex_count)
        normals = np.einsum("nk,nkx->nx", barycentric, summed[head.faces[triangles]])
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    def facing(self, rotation: np.ndarray) -> np.ndarray:
        """How far the skin at each landmark faces the camera: cosines, [478], for a rotation from head to camera, [3, 3]."""
        return -(self.normals @ rotation.T)[:, 2]
