"""Depths that Open3D's RaycastingScene (Embree, robust flag) sees, for tests/it/render/reference.rs.

usage: python tests/reference/render_open3d.py > tests/reference/render_open3d.json

Vertices and rays are what the Rust test makes, rounded to f32. Every 16th pixel of every 16th row is
written, 0 for no hit, and the number of hits over the whole image.
"""

import json
import sys

import numpy as np
import open3d as o3d

WIDTH, HEIGHT, FOCAL = 512, 384, 400.0
EYES = [(0.9, -1.4, 1.1), (-1.1, 0.3, 0.5), (0.1, 0.2, 1.6)]


def terrain(side):
    at = np.arange(side + 1) / side * 2.0 - 1.0
    x, y = np.meshgrid(at, at)
    z = 0.1 * np.sin(7.0 * x) * np.cos(5.0 * y) + 0.02 * np.sin(40.0 * x * y)
    i, j = np.meshgrid(np.arange(side), np.arange(side))
    a = (j * (side + 1) + i).ravel()
    cells = np.stack([a, a + 1, a + side + 2, a, a + side + 2, a + side + 1], -1)
    return np.stack([x, y, z], -1).reshape(-1, 3), cells.reshape(-1, 3)


def sphere(rings):
    around = 2 * rings
    polar = np.pi * np.arange(rings + 1) / rings
    turn = 2.0 * np.pi * np.arange(around) / around
    p, t = np.meshgrid(polar, turn, indexing="ij")
    vertices = np.stack([np.sin(p) * np.cos(t), np.sin(p) * np.sin(t), np.cos(p)], -1)
    ring, step = np.meshgrid(np.arange(rings), np.arange(around), indexing="ij")
    a = (ring * around + step).ravel()
    b = (ring * around + (step + 1) % around).ravel()
    cells = np.stack([a, a + around, b, b, a + around, b + around], -1)
    return vertices.reshape(-1, 3), cells.reshape(-1, 3)


def rays(eye):
    eye = np.array(eye)
    ahead = -eye / np.linalg.norm(eye)
    right = np.cross(ahead, (0.1, 0.0, 1.0))
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    column, row = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    x, y = (column - WIDTH / 2) / FOCAL, (row - HEIGHT / 2) / FOCAL
    directions = x[..., None] * right + y[..., None] * down + ahead
    return np.concatenate([np.broadcast_to(eye, directions.shape), directions], -1)


def main():
    out = {"open3d": o3d.__version__, "numpy": np.__version__, "views": []}
    for name, (vertices, triangles) in (("terrain", terrain(316)), ("sphere", sphere(60))):
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)),
                            o3d.core.Tensor(triangles.astype(np.uint32)))
        for eye in EYES:
            depth = scene.cast_rays(o3d.core.Tensor(rays(eye).astype(np.float32)))["t_hit"].numpy()
            hits = int(np.isfinite(depth).sum())
            depth = np.where(np.isfinite(depth), depth, 0.0)[::16, ::16]
            out["views"].append({"mesh": name, "eye": eye, "hits": hits,
                                 "depth": [float(f"{value:.9g}") for value in depth.ravel()]})
    json.dump(out, sys.stdout)
    print()


if __name__ == "__main__":
    main()
