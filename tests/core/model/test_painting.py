"""A person painted onto the UV map: what views show arrives where it is on the mesh."""

from __future__ import annotations

import numpy as np

from grmm_core.controls.frame import Controls
from grmm_core.geometry.zbuffer import triangle_depth
from grmm_core.model.layout import texel_layout
from grmm_core.model.painting import View, paint

PIXELS = 64


def colors_at(points):
    """A color for every place around the head, 0.2..0.8."""
    return 0.5 + 0.3 * np.sin(points * (9.0, 7.0, 8.0))


def test_colors_of_views_arrive_where_they_are_on_the_mesh(head):
    rest = np.zeros(head.shape_count, np.float32)
    asked = []

    def draw(controls, camera):
        asked.append(dict(controls))
        vertices = head.vertices(rest, Controls().set_named({}).expression, np.zeros((5, 3), np.float32))
        depth = triangle_depth(vertices[head.faces], camera).astype(np.float64)
        row, column = np.indices(depth.shape) + 0.5
        local = np.stack([(column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, np.ones_like(row)], -1)
        matrix = np.linalg.inv(camera.world_to_camera)
        cover = (depth < 10.0).astype(np.float32)
        places = local * np.minimum(depth, 10.0)[..., None] @ matrix[:3, :3].T + matrix[:3, 3]
        return View(vertices, (colors_at(places) * cover[..., None]).astype(np.float32), cover)

    painting = paint(head, draw, PIXELS)
    assert painting.shape == (PIXELS, PIXELS, 3)
    assert painting.dtype == np.uint8
    layout = texel_layout(head.uv, head.uv_faces, PIXELS)
    corners = head.v_template[head.faces[layout.face]]
    places = (corners * layout.barycentric[..., None]).sum(1)
    error = np.abs(painting.reshape(-1, 3)[layout.texel] / 255.0 - colors_at(places)).max(1)
    skin = (head.uv_islands[layout.face] == 0) & (places[:, 2] > 0.05)  # the face
    assert np.median(error[skin]) < 0.01
    assert np.quantile(error[skin], 0.9) < 0.06  # inside nose and lids nobody sees anything
    assert painting.min() > 30  # what lies off the map takes the colors around it
    assert {} in asked
    assert any("eyeBlinkLeft" in controls for controls in asked)
