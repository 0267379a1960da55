"""A person's furrows on the UV map, and how high the skin stands there in an expression. Needs numpy; numba makes it faster."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np

from ..compute.recent import Recent
from ..controls.names import ARKIT_NAMES
from ..head import HeadModel, PeopleModel
from ..light.shadows import compiled_kernels
from ..model.layout import texel_layout
from .families import FAMILIES, LINE_DEPTH, amounts_of, driven, family_places, line_depth
from .lines import furrowed, paint_lines

FINER = 3
"""Pixels of the relief along a texel's side: 0.5 mm on a forehead, where a furrow is 1 to 2 mm wide."""
_SMOOTH = ("left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "lashes", "mouth_interior")
_LOWEST = 2e-6  # metres of relief that is worth a pixel
_ROUNDING = 1e-8  # metres
_LEAST = 0.02  # of a furrow's weight that is worth a pixel
_LEARNED = {"fold": 0.65}  # of a family's furrows: weights know the shade of a smile's fold already
_MARGIN = 2  # pixels around what has furrows
_WHOLE = 8  # rows and columns come in so many, to be halved for smaller sizes
_YOUNG, _YEARS, _SMOOTHEST = 24.0, 50.0, 0.02  # as the studio's people age


class _Canvas(NamedTuple):
    """What furrows are painted on: pixels of a head's UV map that may have some; the same for everybody.

    Attributes:
        skin: How far they are skin, 0..1, [n].
        rest: Template positions, metres, [n, 3].
        places: Of `families.family_places`, less what weights know, float32 [22, n].
        texel: Flat index of each in a map of `FINER` times the grid, [n].
        face: Number of the face on which it lies, [n].
    """

    skin: np.ndarray
    rest: np.ndarray
    places: np.ndarray
    texel: np.ndarray
    face: np.ndarray

    @staticmethod
    def of(head: HeadModel, uv: np.ndarray, grid: int) -> _Canvas:
        """Find them; arguments as of `Relief.of`."""
        smooth, lips = 1.0 - head.marked(*_SMOOTH), head.marked("lips").astype(float)
        template = np.asarray(head.v_template, np.float64)
        coarse = family_places(template, smooth, lips * smooth).max(0) * furrowed(template)
        near = np.flatnonzero((coarse[head.faces] > _LEAST / 4).any(1))
        layout = texel_layout(uv, head.uv_faces[near], grid * FINER)
        corners = head.faces[near[layout.face]]

        def at(values: np.ndarray) -> np.ndarray:
            found: np.ndarray = np.einsum("nk,nk...->n...", layout.barycentric, np.asarray(values, np.float64)[corners])
            return found

        skin, rest = at(smooth), at(template)
        left = np.array([_LEARNED.get(family.name, 1.0) for family in FAMILIES])
        places = (family_places(rest, skin, at(lips) * skin) * left[:, None]).astype(np.float32)
        some = np.flatnonzero((places.max(0) > _LEAST) & (skin > 0.0))
        return _Canvas(skin[some], rest[some], places[:, some], layout.texel[some], near[layout.face[some]])


_CANVAS: Recent[_Canvas] = Recent(1)


def make_canvas(head: HeadModel, uv: np.ndarray, grid: int) -> _Canvas:
    """What `Relief.of` paints on, found once; arguments as there."""
    return _CANVAS.get((head, uv, grid), lambda: _Canvas.of(head, uv, grid))


class Relief(NamedTuple):
    """Furrows of one person on a part of the UV map.

    Attributes:
        corner: First row and column of the part, [2].
        size: Its rows and columns, [2].
        pixel: Flat index in the part of each pixel that has furrows, [n].
        lines: Relief times the person's depth, metres, by channel of `lines.paint_lines`, [3, n].
        places: Of `families.family_places`, at these pixels, [22, n].
        faces: Numbers of the faces on which they lie, [F].
    """

    corner: np.ndarray
    size: np.ndarray
    pixel: np.ndarray
    lines: np.ndarray
    places: np.ndarray
    faces: np.ndarray

    @staticmethod
    def of(head: HeadModel, uv: np.ndarray, grid: int, seed: int, age: float) -> Relief:
        """Paint it.

        Args:
            head: The open head: furrows are painted over its template.
            uv: Corners of the UV map, [T, 2].
            grid: Texels along a side of the model's maps.
            seed: Of what is the person's own.
            age: How far age has come, 0..1, see `age_of`.
        """
        skin, rest, places, texel, face = make_canvas(head, uv, grid)
        lines = paint_lines(rest, seed, age) * (skin[:, None] * line_depth(age) * LINE_DEPTH)
        kept = np.flatnonzero((np.abs(lines).max(1) > _LOWEST) & (places.max(0) > _LEAST))
        row, column = np.divmod(texel[kept], grid * FINER)
        corner = np.array([row.min(), column.min()]) - _MARGIN
        size = -(-(np.array([row.max(), column.max()]) + 1 + _MARGIN - corner) // _WHOLE) * _WHOLE
        pixel = (row - corner[0]) * size[1] + column - corner[1]
        found = (
            np.ascontiguousarray(lines[kept].T, np.float32),
            places[:, kept],
            np.unique(face[kept]),
        )
        return Relief(corner, size, pixel, *found)

    def driven(self, *expressions: np.ndarray) -> np.ndarray:
        """How far each channel's furrows are driven by the strongest of some expressions, 0..1, [3, n].

        Args:
            expressions: Coefficients of the open head, the first of which are ARKit's, [E] each.
        """
        found = [driven(self.places, self._amounts(e)).T for e in expressions]
        return np.ascontiguousarray(np.max(found, axis=0))

    def heights(self, expression: np.ndarray, held: np.ndarray | None = None) -> np.ndarray | None:
        """How high the skin stands above the smooth one, metres, [*size] float32; None where it is smooth.

        Args:
            expression: As of `driven`.
            held: What colors hold of it already, as of `driven`; None: nothing.
        """
        amounts = self._amounts(expression)
        if not amounts.any():
            return None
        height = np.zeros(int(self.size.prod()), np.float32)
        if compiled_kernels() is None:
            left = driven(self.places, amounts).T if held is None else driven(self.places, amounts).T - held
            height[self.pixel] = (self.lines * np.maximum(left, 0.0)).sum(0)
        else:
            from ..compute.threads import for_rows
            from .furrow_kernels import raise_skin

            used = np.flatnonzero(amounts)
            channels = np.array([FAMILIES[family].channel for family in used])
            held = np.zeros_like(self.lines) if held is None else held
            options = self.places, used, amounts[used].astype(np.float32), channels, held, self.lines, self.pixel, height
            for_rows(raise_skin, len(self.pixel), *options)
        return height.reshape(*self.size) if max(height.max(), -height.min()) > _ROUNDING else None

    def _amounts(self, expression: np.ndarray) -> np.ndarray:
        if not expression.any():
            return np.zeros(len(FAMILIES))
        return amounts_of(dict(zip(ARKIT_NAMES, expression.tolist(), strict=False)))


def age_of(shape: np.ndarray, people: PeopleModel) -> float:
    """How far age has come by what a shape says about it, 0 (24 years or less) .. 1 (74 or more).

    The mean of the years given the coefficients, both normally distributed: right to 9 years in the mean of random people.

    Args:
        shape: Coefficients of the open head, [<= S].
        people: Of the same head.
    """
    known = min(len(shape), people.macro_to_shape.shape[1])
    told = people.macro_to_shape[:, :known] / np.maximum(people.residual_std[:known], 1e-6) ** 2
    precision = told @ people.macro_to_shape[:, :known].T + np.diag(1.0 / np.maximum(people.std, 1e-6) ** 2)
    years = (people.mean + np.linalg.solve(precision, told @ shape[:known]))[people.names.index("age")]
    return float(np.clip((years - _YOUNG) / _YEARS, _SMOOTHEST, 1.0))


def seed_of(shape: np.ndarray) -> int:
    """A number that is one person's own, always the same, from coefficients [S]."""
    return int.from_bytes(hashlib.blake2b(np.ascontiguousarray(shape, np.float32).tobytes(), digest_size=4).digest(), "little")
