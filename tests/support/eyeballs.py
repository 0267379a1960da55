"""People drawn at random from the open head, and how much of their eyes is seen."""

from __future__ import annotations

import numpy as np


def both(name, value=1.0):
    return {f"{name}Left": value, f"{name}Right": value}


def sphere(points):
    system = np.c_[2 * points, np.ones(len(points))]
    solution = np.linalg.lstsq(system, (points**2).sum(1), rcond=None)[0]
    return solution[:3], np.sqrt(solution[3] + solution[:3] @ solution[:3])


def random_people(count=12):
    return np.random.default_rng(7).standard_normal((count, 300)).astype(np.float32)


def rays_hit(origins, vertices, triangles, tolerance=1e-6):
    """For rays along -z from origins [n, 3]: whether any triangle is hit in front of z of the origin minus its length."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    keep = np.abs(area) > 1e-12
    a, b, c, area = a[keep], b[keep], c[keep], area[keep]
    hit = np.full(len(origins), -np.inf)
    for i, (x, y, _) in enumerate(origins):
        u = ((b[:, 0] - x) * (c[:, 1] - y) - (c[:, 0] - x) * (b[:, 1] - y)) / area
        v = ((c[:, 0] - x) * (a[:, 1] - y) - (a[:, 0] - x) * (c[:, 1] - y)) / area
        w = 1 - u - v
        inside = (u >= -tolerance) & (v >= -tolerance) & (w >= -tolerance)
        if inside.any():
            hit[i] = (u * a[:, 2] + v * b[:, 2] + w * c[:, 2])[inside].max()
    return hit


def eye_visibility(head, vertices, side):
    """Share of a grid of points on the front of an eyeball that no skin covers, seen from the front."""
    part = head.regions[f"{side}_eyeball"]
    centre, radius = sphere(vertices[part])
    angle = np.radians(np.arange(-50, 51, 5.0))
    yaw, pitch = (grid.ravel() for grid in np.meshgrid(angle, angle))
    front = centre + radius * np.stack([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)], 1)
    others = np.concatenate([head.regions[name] for name in ("left_eyeball", "right_eyeball", "lashes")])
    triangles = head.faces[~np.isin(head.faces, others).any(1)]
    middle = vertices[triangles].mean(1)
    near = (np.linalg.norm(middle - centre, axis=1) < 0.04) & (middle[:, 2] > centre[2])
    return float((rays_hit(front, vertices, triangles[near]) < front[:, 2]).mean())
