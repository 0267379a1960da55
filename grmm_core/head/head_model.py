"""The head model: FLAME's format as one frozen dataclass of numpy arrays, and what it computes.

Everything that moves a head goes through `HeadModel`: the add-on, the session, the fitting and the decoders. Heads come from
`open_head.load_open_head` (the project's own, the default) and from the user's FLAME file. Needs numpy only; `torch_head`
is the batched, differentiable twin for training. May import neither torch nor anything above it in the core's map.

Units: metres and radians; y up, face towards +z, the subject's left at +x, origin between the ears (a user's
FLAME keeps its own origin).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType

import numpy as np

from ..controls.names import ARKIT_NAMES, JOINT_NAMES
from ..errors import ShapeError
from ..geometry.rotations import euler_to_matrix
from .skinning import posed_vertices

JOINT_COUNT = len(JOINT_NAMES)


@dataclass(frozen=True, eq=False)
class HeadModel:
    """A parametric head: vertices = LBS(template + shape + expression + displacement).

    Attributes:
        name: "open_head", "flame2023" and the like.
        v_template: Mean head in metres, [V, 3].
        faces: Triangles, counter-clockwise from outside, int32, [F, 3].
        shape_dirs: Offsets in metres per unit-variance shape coefficient, [V, 3, S].
        expression_dirs: Offsets in metres per unit of each expression component, before skinning, [V, 3, E].
        posedirs: Pose-corrective offsets per entry of (R_j - I), [V, 3, 36], or None.
        J_regressor: Rest joints as affine mixes of the shaped vertices, [5, V].
        parents: Parent of each joint, -1 for the root, [5].
        weights: Skinning weights, rows sum to 1, [V, 5].
        uv: Texture coordinates, (0, 0) lower left, [T, 2].
        uv_faces: Rows of `uv` for each triangle's corners, int32, [F, 3].
        uv_islands: Island number of each triangle, 0 is the head's skin, [F].
        regions: Region name to sorted vertex indices.
        landmarks68: Triangle of each of the 68 iBUG landmarks, [68], and barycentric coordinates, [68, 3]; or None.
        landmarks478: The same for MediaPipe's 478, or None.
        shape_names: S names.
        expression_names: E names.
        joint_names: root, neck, jaw, left_eye, right_eye.
        expression_pose: XYZ Euler angles in radians that a unit of each component adds to each joint, [E, 5, 3].
        arkit_to_expression: Expression coefficients of each ARKit shape, [52, E].
        arkit_pose: XYZ Euler angles in radians that a unit of each ARKit shape adds to each joint, beside what its expression
            coefficients add by `expression_pose`, [52, 5, 3]. Zero for the open head; FLAME's components turn no joint, so
            its jaw and eyes are turned by this.
        continues: Fingerprints (`model.weights_file.head_fingerprint`) of earlier heads with the same triangles and shape
            space: weights and avatars made on them are drawn on this one.
    """

    name: str
    v_template: np.ndarray
    faces: np.ndarray
    shape_dirs: np.ndarray
    expression_dirs: np.ndarray
    posedirs: np.ndarray | None
    J_regressor: np.ndarray
    parents: np.ndarray
    weights: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    uv_islands: np.ndarray
    regions: Mapping[str, np.ndarray]
    shape_names: tuple[str, ...]
    expression_names: tuple[str, ...]
    expression_pose: np.ndarray
    arkit_to_expression: np.ndarray
    landmarks68: tuple[np.ndarray, np.ndarray] | None = None
    landmarks478: tuple[np.ndarray, np.ndarray] | None = None
    joint_names: tuple[str, ...] = field(default=JOINT_NAMES)
    arkit_pose: np.ndarray = field(default_factory=lambda: np.zeros((len(ARKIT_NAMES), JOINT_COUNT, 3), np.float32))
    continues: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._check_shapes()
        object.__setattr__(self, "regions", MappingProxyType(dict(self.regions)))
        for item in fields(self):
            value = getattr(self, item.name)
            arrays = value.values() if isinstance(value, Mapping) else value if isinstance(value, tuple) else (value,)
            for array in arrays:
                if isinstance(array, np.ndarray):
                    array.flags.writeable = False

    @property
    def vertex_count(self) -> int:
        """V."""
        return len(self.v_template)

    @property
    def shape_count(self) -> int:
        """S."""
        return self.shape_dirs.shape[2]

    @property
    def expression_count(self) -> int:
        """E."""
        return self.expression_dirs.shape[2]

    def marked(self, *regions: str) -> np.ndarray:
        """Which vertices lie in any of the regions, [V] bool; of those that this head lacks none does."""
        inside = np.zeros(self.vertex_count, bool)
        for name in self.regions.keys() & set(regions):
            inside[self.regions[name]] = True
        return inside

    def shaped(self, shape: np.ndarray, expression: np.ndarray | None = None) -> np.ndarray:
        """Template plus shape and expression directions, before skinning.

        Args:
            shape: Coefficients, [<=S]; missing ones are zero.
            expression: Coefficients, [<=E] or None.

        Returns:
            Metres, float32, [V, 3].

        Raises:
            ShapeError: Too many coefficients, or not one row of them.
        """
        result = self._person(shape)[0]
        if expression is None:
            return result.copy()
        return result + self._offsets(self.expression_dirs, expression, "expression")

    def joints(self, shape: np.ndarray) -> np.ndarray:
        """Rest joints of a shaped head in metres, [5, 3]; expressions do not move them (as in FLAME)."""
        return self._person(shape)[1].copy()

    def vertices(
        self,
        shape: np.ndarray,
        expression: np.ndarray,
        pose_euler: np.ndarray,
        displacement: np.ndarray | None = None,
    ) -> np.ndarray:
        """Posed vertices.

        Args:
            shape: Coefficients, [<=S].
            expression: Coefficients, [<=E]. Only their vertex part: the caller adds `expression_pose` to `pose_euler`, as
                `controls.resolve` does and `pose_of` helps with.
            pose_euler: XYZ Euler angles in radians of the five joints, [5, 3].
            displacement: Learned residual (paper, equation 11) added before skinning, metres, [V, 3] or None.

        Returns:
            Metres, float32, [V, 3].

        Raises:
            ShapeError: An argument has the wrong shape.
        """
        pose = np.asarray(pose_euler, np.float32)
        if pose.shape != (JOINT_COUNT, 3):
            raise ShapeError(f"The pose has shape {pose.shape}; it must be ({JOINT_COUNT}, 3).")
        unposed = self.shaped(shape, expression)
        if displacement is not None:
            displacement = np.asarray(displacement, np.float32)
            if displacement.shape != unposed.shape:
                raise ShapeError(f"The displacement has shape {displacement.shape}; it must be {unposed.shape}.")
            unposed = unposed + displacement
        rotations = euler_to_matrix(pose)
        return posed_vertices(unposed, rotations, self.joints(shape), self.weights, self.parents.tolist(), self.posedirs)

    def pose_of(self, expression: np.ndarray, pose_euler: np.ndarray | None = None) -> np.ndarray:
        """Euler angles in radians that expression coefficients [<=E] give, on top of `pose_euler`; [5, 3]."""
        coefficients = np.asarray(expression, np.float32)
        pose = np.einsum("e,ejk->jk", coefficients, self.expression_pose[: len(coefficients)])
        return pose if pose_euler is None else pose + np.asarray(pose_euler, np.float32)

    def landmark_positions(self, vertices: np.ndarray, count: int = 68) -> np.ndarray:
        """Landmarks on posed vertices [V, 3]: [68, 3] or [478, 3].

        Raises:
            ShapeError: The model has no such landmarks.
        """
        embedding = {68: self.landmarks68, 478: self.landmarks478}.get(count)
        if embedding is None:
            raise ShapeError(f"The head model {self.name} has no set of {count} landmarks; use 68.")
        triangles, barycentric = embedding
        return np.einsum("lk,lkx->lx", barycentric, vertices[self.faces[triangles]])

    def expression_index(self, name: str) -> int:
        """Index of an expression component by name. Raises `ShapeError` where there is none."""
        try:
            return self.expression_names.index(name)
        except ValueError as error:
            raise ShapeError(f"The head model {self.name} has no expression component {name!r}.") from error

    @property
    def joint_template(self) -> np.ndarray:
        """Rest joints of the template in metres, [5, 3]."""
        return self._joint_basis()[0]

    @property
    def joint_dirs(self) -> np.ndarray:
        """Offsets of the rest joints in metres per shape coefficient, [5, 3, S]."""
        return self._joint_basis()[1]

    def _person(self, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shaped vertices [V, 3] and joints [5, 3]; the last person is kept: an animation asks for one."""
        shape = np.asarray(shape, np.float32)
        key = (shape.shape, shape.tobytes())
        cached = self.__dict__.get("_last_person")
        if cached is None or cached[0] != key:
            vertices = self.v_template + self._offsets(self.shape_dirs, shape, "shape")
            joints = self.joint_template + self._offsets(self.joint_dirs, shape, "shape")
            cached = (key, (vertices, joints))
            object.__setattr__(self, "_last_person", cached)
        return cached[1]

    def _joint_basis(self) -> tuple[np.ndarray, np.ndarray]:
        """Joints of the template, [5, 3], and per shape coefficient, [5, 3, S]; computed once."""
        cached = self.__dict__.get("_joints")
        if cached is None:
            directions = (self.J_regressor @ self.shape_dirs.reshape(self.vertex_count, -1)).reshape(JOINT_COUNT, 3, -1)
            cached = (self.J_regressor @ self.v_template, directions)
            object.__setattr__(self, "_joints", cached)
        return cached

    @staticmethod
    def _offsets(directions: np.ndarray, coefficients: np.ndarray, what: str) -> np.ndarray:
        coefficients = np.asarray(coefficients, np.float32)
        if coefficients.ndim != 1 or coefficients.size > directions.shape[2]:
            raise ShapeError(
                f"The {what} coefficients have shape {coefficients.shape}; "
                f"give one row of at most {directions.shape[2]} values."
            )
        # trailing zeros are common (sliders): only the used part is multiplied
        used = int(np.flatnonzero(coefficients)[-1]) + 1 if coefficients.any() else 0
        flat = directions.reshape(-1, directions.shape[2])[:, :used] @ coefficients[:used]  # one matrix-vector product
        return flat.reshape(directions.shape[:2])

    def _check_shapes(self) -> None:
        vertices, faces = len(self.v_template), len(self.faces)
        wanted: dict[str, tuple[int | None, ...]] = {
            "v_template": (vertices, 3), "faces": (faces, 3), "shape_dirs": (vertices, 3, None),
            "expression_dirs": (vertices, 3, None), "J_regressor": (JOINT_COUNT, vertices), "parents": (JOINT_COUNT,),
            "weights": (vertices, JOINT_COUNT), "uv": (None, 2), "uv_faces": (faces, 3), "uv_islands": (faces,),
            "expression_pose": (self.expression_dirs.shape[-1], JOINT_COUNT, 3),
            "arkit_to_expression": (len(ARKIT_NAMES), self.expression_dirs.shape[-1]),
            "arkit_pose": (len(ARKIT_NAMES), JOINT_COUNT, 3),
        }  # fmt: skip
        if self.posedirs is not None:
            wanted["posedirs"] = (vertices, 3, 9 * (JOINT_COUNT - 1))
        for name, shape in wanted.items():
            actual = getattr(self, name).shape
            if len(actual) != len(shape) or any(w is not None and w != a for w, a in zip(shape, actual, strict=True)):
                raise ShapeError(f"{name} of head model {self.name} has shape {actual}; it must be {shape}.")
        for name, limit in (("faces", vertices), ("uv_faces", len(self.uv))):
            array = getattr(self, name)
            if array.size and not 0 <= array.min() <= array.max() < limit:
                raise ShapeError(f"{name} of head model {self.name} points outside its {limit} rows.")
