"""The 68 iBUG landmarks on the open head's mean person, found in pictures of it.

Front views of the template are rasterised with triangle numbers; eye and lip contours are read off where skin meets eyeball
or the open mouth, brows, nose and jaw from their place on the profile and the outline. Each landmark is a triangle and
barycentric coordinates. Order: jaw 0-16 from the subject's right ear to the left, brows 17-26, nose 27-35, right eye 36-41,
left eye 42-47, outer lips 48-59, inner lips 60-67.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

PIXEL = 0.00025  # metres
WINDOW = (-0.085, 0.085, -0.11, 0.1)  # metres: x from, x to, y from, y to


class FrontView:
    """An orthographic picture along -z: which triangle is seen at each pixel, and where in it."""

    def __init__(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        pixel: float = PIXEL,
        window: tuple[float, float, float, float] = WINDOW,
    ) -> None:
        self._pixel, self._window = pixel, window
        self.width = round((window[1] - window[0]) / pixel)
        self.height = round((window[3] - window[2]) / pixel)
        self.triangle = np.full((self.height, self.width), -1)
        self.barycentric = np.zeros((self.height, self.width, 3))
        self.depth = np.full((self.height, self.width), -np.inf)
        column = (vertices[:, 0] - window[0]) / pixel - 0.5
        row = (vertices[:, 1] - window[2]) / pixel - 0.5
        for number, corners in enumerate(faces):
            self._draw(number, column[corners], row[corners], vertices[corners, 2])

    def _draw(self, number: int, column: np.ndarray, row: np.ndarray, depth: np.ndarray) -> None:
        area = (column[1] - column[0]) * (row[2] - row[0]) - (column[2] - column[0]) * (row[1] - row[0])
        if area <= 1e-9:  # seen from behind
            return
        left, right = max(int(np.ceil(column.min())), 0), min(int(column.max()), self.width - 1)
        low, high = max(int(np.ceil(row.min())), 0), min(int(row.max()), self.height - 1)
        if left > right or low > high:
            return
        x, y = np.meshgrid(np.arange(left, right + 1), np.arange(low, high + 1))
        first = ((column[1] - x) * (row[2] - y) - (column[2] - x) * (row[1] - y)) / area
        second = ((column[2] - x) * (row[0] - y) - (column[0] - x) * (row[2] - y)) / area
        weights = np.stack([first, second, 1 - first - second], -1)
        z = weights @ depth
        view = (slice(low, high + 1), slice(left, right + 1))
        seen = (weights.min(-1) >= 0) & (z > self.depth[view])
        self.depth[view][seen] = z[seen]
        self.triangle[view][seen] = number
        self.barycentric[view][seen] = weights[seen]

    def pixel(self, x: float, y: float) -> tuple[int, int]:
        """Row and column of the pixel that shows a point (metres, head axes, orthographic)."""
        return round((y - self._window[2]) / self._pixel - 0.5), round((x - self._window[0]) / self._pixel - 0.5)

    def at(self, row: int, column: int) -> tuple[int, np.ndarray]:
        """Triangle and barycentric coordinates seen at a pixel. Raises `RuntimeError` where nothing is."""
        if self.triangle[row, column] < 0:
            raise RuntimeError(f"Nothing is seen at pixel {row}, {column}.")
        return int(self.triangle[row, column]), self.barycentric[row, column]


def place_landmarks68(
    template: np.ndarray, open_mouth: np.ndarray, faces: np.ndarray, regions: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Place the 68 landmarks.

    Args:
        template: Mean person, [V, 3].
        open_mouth: The same with the jaw a little open, to see the inner lips' edges, [V, 3].
        faces: [F, 3].
        regions: Vertex sets by name.

    Returns:
        Triangle indices [68] and barycentric coordinates [68, 3].
    """
    bare = ~_touches(faces, regions["lashes"])
    numbers = np.flatnonzero(bare)
    closed, opened = FrontView(template, faces[numbers]), FrontView(open_mouth, faces[numbers])
    label = {name: _touches(faces[numbers], regions[name], whole=True) for name in regions}
    found = [*_jaw(template, faces, numbers, regions), *_brows(closed), *_nose(closed)]
    found += _eye(closed, label["right_eyeball"], -1) + _eye(closed, label["left_eyeball"], 1)
    found += _outer_lips(closed, label["lips"]) + _inner_lips(opened, label)
    triangles = np.array([numbers[triangle] for triangle, _ in found], np.int32)
    return triangles, np.array([weights for _, weights in found], np.float32)


def _touches(faces: np.ndarray, vertices: np.ndarray, whole: bool = False) -> np.ndarray:
    mark = np.isin(faces, vertices)
    return mark.all(1) if whole else mark.any(1)


def _jaw(
    template: np.ndarray, faces: np.ndarray, numbers: np.ndarray, regions: Mapping[str, np.ndarray]
) -> list[tuple[int, np.ndarray]]:
    """17 vertices on the outline of the face, by angle around a point between the mouth corners' height and the eyes."""
    face = np.setdiff1d(regions["face"], regions["ears"])
    face = face[(template[face, 2] > -0.005) & (template[face, 1] < 0.04)]
    centre = np.array([0.0, 0.02])
    arms = template[face, :2] - centre
    angle = np.degrees(np.arctan2(arms[:, 1], arms[:, 0]))  # -180..180
    angle = np.where(angle > 90, angle - 360, angle)
    radius = np.linalg.norm(arms, axis=1)
    result = []
    for wanted in np.linspace(-185.0, 5.0, 17):
        near = np.flatnonzero(np.abs(angle - wanted) < 5.5)
        vertex = face[near[np.argmax(radius[near] - 0.0008 * np.abs(angle[near] - wanted))]]
        triangle = int(np.flatnonzero((faces[numbers] == vertex).any(1))[0])
        result.append((triangle, (faces[numbers][triangle] == vertex).astype(float)))
    return result


def brow_height(x: np.ndarray | float) -> np.ndarray | float:
    """Height of the brows' middle line on the mean person at a distance x from the midline, metres."""
    return 0.0485 + 0.0035 * np.sin(np.pi * np.clip((np.abs(x) - 0.008) / 0.055, 0.0, 1.0))


def _brows(view: FrontView) -> list[tuple[int, np.ndarray]]:
    right = [-0.051, -0.0425, -0.033, -0.0225, -0.0115]
    return [view.at(*view.pixel(x, float(brow_height(x)))) for x in (*right, *(-x for x in reversed(right)))]


def _nose(view: FrontView) -> list[tuple[int, np.ndarray]]:
    column = view.pixel(0.0, 0.0)[1]
    profile = view.depth[:, column]
    rows = np.arange(view.height)
    eye_row, mouth_row = view.pixel(0, 0.036)[0], view.pixel(0, -0.03)[0]
    between = (rows > mouth_row) & (rows < eye_row)
    tip = int(rows[between][np.argmax(profile[between])])
    bridge = (rows > tip) & (rows < eye_row + 40)
    nasion = int(rows[bridge][np.argmin(profile[bridge])])
    below = (rows > tip - 90) & (rows < tip - 10)
    # under the nose the profile falls back to the philtrum: the steepest place is the base of the septum
    base = int(rows[below][np.argmax(np.diff(profile, append=profile[-1])[below])]) - 2
    points = [view.at(round(row), column) for row in np.linspace(nasion, tip, 4)]
    for x in (-0.0145, -0.0075, 0.0, 0.0075, 0.0145):
        lift = 8 if abs(x) > 0.01 else 0
        points.append(view.at(base + lift, view.pixel(x, 0.0)[1]))
    return points


def _eye(view: FrontView, eyeball: np.ndarray, side: int) -> list[tuple[int, np.ndarray]]:
    """Six points of one eye in image order: the corner at smaller x first, upper lid, other corner, lower lid back."""
    seen = (view.triangle >= 0) & eyeball[view.triangle]
    columns = np.flatnonzero(seen.any(0))
    left, right = columns[0], columns[-1]

    def edge(column: int, upper: bool) -> tuple[int, np.ndarray]:
        rows = np.flatnonzero(seen[:, column])
        return view.at(int(rows[-1]) + 2 if upper else int(rows[0]) - 2, column)

    def corner(column: int, step: int) -> tuple[int, np.ndarray]:
        return view.at(int(np.median(np.flatnonzero(seen[:, column]))), column + step)

    inner = [round(left + share * (right - left)) for share in (0.32, 0.68)]
    return [
        corner(left, -3), edge(inner[0], True), edge(inner[1], True),
        corner(right, 3), edge(inner[1], False), edge(inner[0], False),
    ]  # fmt: skip


def _outer_lips(view: FrontView, lips: np.ndarray) -> list[tuple[int, np.ndarray]]:
    seen = (view.triangle >= 0) & lips[view.triangle]
    columns = np.flatnonzero(seen.any(0))
    left, right = int(columns[0]), int(columns[-1])
    middle, half = 0.5 * (left + right), 0.5 * (right - left)

    def edge(share: float, upper: bool) -> tuple[int, np.ndarray]:
        column = round(middle + share * half)
        rows = np.flatnonzero(seen[:, column])
        return view.at(int(rows[-1] if upper else rows[0]), column)

    corners = [view.at(int(np.median(np.flatnonzero(seen[:, column]))), column) for column in (left + 1, right - 1)]
    upper = [edge(share, True) for share in (-0.58, -0.22, 0.0, 0.22, 0.58)]
    lower = [edge(share, False) for share in (0.58, 0.25, 0.0, -0.25, -0.58)]
    return [corners[0], *upper, corners[1], *lower]


def _inner_lips(view: FrontView, label: Mapping[str, np.ndarray]) -> list[tuple[int, np.ndarray]]:
    inside = label["mouth_interior"] | label["upper_teeth"] | label["lower_teeth"] | label["tongue"]
    seen = (view.triangle >= 0) & inside[view.triangle]
    seen[view.pixel(0, 0.0)[0] :] = False
    columns = np.flatnonzero(seen.any(0))
    left, right = int(columns[0]), int(columns[-1])

    def edge(share: float, upper: bool) -> tuple[int, np.ndarray]:
        column = round(left + share * (right - left))
        rows = np.flatnonzero(seen[:, column])
        return view.at(int(rows[-1]) + 2 if upper else int(rows[0]) - 2, column)

    corners = [
        view.at(int(np.median(np.flatnonzero(seen[:, column]))), column + step) for column, step in ((left, -2), (right, 2))
    ]
    upper = [edge(share, True) for share in (0.25, 0.5, 0.75)]
    lower = [edge(share, False) for share in (0.75, 0.5, 0.25)]
    return [corners[0], *upper, corners[1], *lower]
