"""Visibility and exact maps: ours beside Embree, in one run, on one thread each, CPU time.

usage: python benches/render_visibility.py OUT_DIR [--binary PATH] [--repeats 3] SIDE...

For each terrain of SIDE x SIDE cells (2 SIDE^2 triangles) three pinhole views of 2048x1536 are taken
with: examples/render_visibility.rs (visibility alone; depth, normal, triangle and weights in f64),
embreex with its robust flag (triangle numbers alone; then everything it returns) and Open3D's
RaycastingScene, which sets Embree's robust flag itself and returns everything. Appends to
OUT_DIR/visibility.csv and build.csv. `--arbitrate SIDE...` counts pixels of the same views that differ from
the exact test of every candidate (arbitration.csv), `--lens SIDE...` times the views through a lens, drawn
and with its rays traced one by one (lens.csv), `--fisheye SIDE...` through fisheyes that see up to 90 degrees
from the axis (fisheye.csv), `--rays SIDE...` the rays of the views' pixels one by one and
together, beside embreex robust on the same rays (rays.csv), `--packets SIDE...` the views beside Embree's
robust single rays and its robust packets of 16, told that rays are coherent and not, called from C without
Python between (embree_packets.c, built with `cc`, the library that embreex brings; packets.csv). `--leaks N` instead counts rays aimed at corners and edges of closed
spheres from inside that hit nothing, N of ours and a tenth of it for embreex with and without the
robust flag, into OUT_DIR/leaks.csv.
"""

import argparse
import csv
import json
import os
import pathlib
import statistics
import subprocess
import tempfile
import time

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["RAYON_NUM_THREADS"] = "1"

import numpy as np
from embreex import mesh_construction, rtcore_scene

ROOT = pathlib.Path(__file__).resolve().parent.parent
EYES = [(0.9, -1.4, 1.1), (-1.1, 0.3, 0.5), (0.1, 0.2, 1.6)]


def terrain(side):
    at = np.arange(side + 1) / side * 2.0 - 1.0
    x, y = np.meshgrid(at, at)
    z = 0.1 * np.sin(7.0 * x) * np.cos(5.0 * y) + 0.02 * np.sin(40.0 * x * y)
    vertices = np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32)
    i, j = np.meshgrid(np.arange(side, dtype=np.int32), np.arange(side, dtype=np.int32))
    a = (j * (side + 1) + i).ravel()
    return vertices, np.stack([a, a + 1, a + side + 2, a, a + side + 2, a + side + 1], -1).reshape(-1, 3)


def sphere(rings):
    around = 2 * rings
    p, t = np.meshgrid(np.pi * np.arange(1, rings) / rings, 2 * np.pi * np.arange(around) / around,
                       indexing="ij")
    ring = np.stack([np.sin(p) * np.cos(t), np.sin(p) * np.sin(t), np.cos(p)], -1).reshape(-1, 3)
    vertices = np.concatenate([[[0, 0, 1]], ring, [[0, 0, -1]]]).astype(np.float32)
    r, s = np.meshgrid(np.arange(rings - 2), np.arange(around), indexing="ij")
    a, b = (1 + r * around + s).ravel(), (1 + r * around + (s + 1) % around).ravel()
    cells = np.stack([a, a + around, b + around, a, b + around, b], -1).reshape(-1, 3)
    s = np.arange(around)
    last = 1 + (rings - 2) * around
    top = np.stack([0 * s, 1 + s, 1 + (s + 1) % around], -1)
    bottom = np.stack([last + s, 0 * s + len(vertices) - 1, last + (s + 1) % around], -1)
    return vertices, np.concatenate([cells, top, bottom]).astype(np.int32)


def axes(eye):
    ahead = -eye / np.linalg.norm(eye)
    right = np.cross(ahead, (0.1, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return right, np.cross(ahead, right), ahead


def rays(eye):
    eye = np.array(eye)
    right, down, ahead = axes(eye)
    column, row = np.meshgrid(np.arange(2048) + 0.5, np.arange(1536) + 0.5)
    x, y = ((column - 1024) / 1600).ravel(), ((row - 768) / 1600).ravel()
    directions = (x[:, None] * right + y[:, None] * down + ahead).astype(np.float32)
    return np.ascontiguousarray(np.broadcast_to(eye.astype(np.float32), directions.shape)), directions


def timed(repeats, work):
    times = []
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return statistics.median(times), result


def embree(vertices, triangles, robust):
    start = time.process_time()
    scene = rtcore_scene.EmbreeScene(robust=robust)
    mesh_construction.TriangleMesh(scene, vertices, triangles)
    scene.run(vertices[:2], vertices[1:3] - vertices[:2])
    return scene, time.process_time() - start


def append(path, rows):
    new = not path.exists()
    with open(path, "a", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerows(rows)


def compare(binary, side, repeats, out):
    import open3d as o3d

    [ours] = lines_of(binary, repeats, side)
    vertices, triangles = terrain(side)
    scene, embree_build = embree(vertices, triangles, True)
    wide = o3d.t.geometry.RaycastingScene(nthreads=1)
    wide.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(triangles.astype(np.uint32)))
    wide.cast_rays(o3d.core.Tensor(np.ones((1, 6), np.float32)))
    rows = []
    for index, (eye, mine) in enumerate(zip(EYES, ours["views"])):
        origins, directions = rays(eye)
        single, hit = timed(repeats, lambda: scene.run(origins, directions))
        full, _ = timed(repeats, lambda: scene.run(origins, directions, output=True))
        joined = o3d.core.Tensor(np.concatenate([origins, directions], 1))
        open3d, _ = timed(repeats, lambda: wide.cast_rays(joined, nthreads=1))
        rows.append({
            "triangles": int(ours["triangles"]), "view": index, "hits": mine["hits"],
            "embree_hits": int((np.asarray(hit) >= 0).sum()),
            "visibility_ms": 1e3 * mine["visibility_s"], "maps_ms": 1e3 * mine["maps_s"],
            "embree_robust_ms": 1e3 * single, "embree_robust_all_ms": 1e3 * full,
            "open3d_ms": 1e3 * open3d,
            "ratio_visibility": single / mine["visibility_s"], "ratio_maps": full / mine["maps_s"],
            "ratio_maps_open3d": open3d / mine["maps_s"],
        })
    append(out / "visibility.csv", rows)
    append(out / "build.csv", [{
        "triangles": int(ours["triangles"]),
        "build_mtri_s": ours["triangles"] / 1e6 / ours["build_s"],
        "embree_build_mtri_s": ours["triangles"] / 1e6 / embree_build,
        "bytes_per_triangle": ours["bytes_per_triangle"],
        "build_peak_bytes_per_triangle": ours["build_peak_bytes_per_triangle"],
        "process_peak_mib": ours["process_peak_bytes"] / 2**20,
    }])


def lines_of(binary, *arguments):
    answer = subprocess.run([binary, *map(str, arguments)], check=True, capture_output=True, text=True)
    return [json.loads(line) for line in answer.stdout.splitlines()]


def through_lens(binary, lens, sides, out):
    rows = lines_of(binary, lens, *sides)
    for row in rows:
        if lens == "fisheye":
            del row["rays_s"]  # one by one, of pixels that have none, too
    append(out / f"{lens}.csv", rows)


def many_rays(binary, sides, repeats, out):
    for side in sides:
        runs = [lines_of(binary, "rays", side) for _ in range(repeats)]
        vertices, triangles = terrain(side)
        scene, _ = embree(vertices, triangles, True)
        rows = []
        for index, eye in enumerate(EYES):
            mine = {key: statistics.median(run[index][key] for run in runs) for key in runs[0][index]}
            origins, directions = rays(eye)
            full, _ = timed(repeats, lambda: scene.run(origins, directions, output=True))
            occluded, _ = timed(repeats, lambda: scene.run(origins, directions, query="OCCLUDED"))
            few = np.ascontiguousarray(directions[::1021])
            sparse, _ = timed(repeats, lambda: [scene.run(origins[:len(few)], few, query="OCCLUDED")
                                                for _ in range(20)])
            rows.append({
                "triangles": int(mine["triangles"]), "view": index, "hits": int(mine["hits"]),
                "different": int(mine["different"]), "single_s": mine["single_s"],
                "together_s": mine["together_s"], "any_s": mine["any_s"],
                "embree_all_s": full, "embree_any_s": occluded,
                "ratio_any": occluded / mine["any_s"],
                "sparse_us_per_ray": mine["sparse_us_per_ray"],
                "embree_sparse_us_per_ray": 1e6 * sparse / (20 * len(few)),
            })
        append(out / "rays.csv", rows)


def packets(binary, sides, repeats, out):
    import embreex

    [library] = (pathlib.Path(embreex.__file__).parent.parent / "embreex.libs").glob("libembree4*")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        build = ["cc", "-O3", "-march=native", ROOT / "benches/embree_packets.c", "-o", folder / "packets", "-ldl"]
        subprocess.run(build, check=True)
        views = [[*eye, *np.concatenate(axes(np.array(eye)))] for eye in EYES]
        np.savetxt(folder / "views", views)
        for side in sides:
            [ours] = lines_of(binary, repeats, side)
            vertices, triangles = terrain(side)
            vertices.tofile(folder / "vertices")
            triangles.astype(np.uint32).tofile(folder / "triangles")
            runs = []
            for flags in ([], ["coherent"]):
                words = [library, *(folder / name for name in ("vertices", "triangles", "views")), repeats]
                text = subprocess.run([folder / "packets", *map(str, words), *flags], check=True,
                                      capture_output=True, text=True).stdout
                runs.append(np.array([line.split() for line in text.splitlines()], float))
            for index, (mine, apart, coherent) in enumerate(zip(ours["views"], *runs)):
                hits, hits_16, different, *seconds = coherent
                single, single_all, packet, packet_all = 1e3 * np.array(seconds)
                visibility, maps = 1e3 * mine["visibility_s"], 1e3 * mine["maps_s"]
                append(out / "packets.csv", [{
                    "triangles": int(ours["triangles"]), "view": index, "hits": mine["hits"],
                    "embree_hits": int(hits), "packet_hits": int(hits_16), "different": int(different),
                    "visibility_ms": visibility, "maps_ms": maps,
                    "single_ms": single, "single_all_ms": single_all,
                    "packet_ms": packet, "packet_all_ms": packet_all,
                    "incoherent_all_ms": 1e3 * apart[-1],
                    "ratio_visibility": packet / visibility, "ratio_maps": packet_all / maps,
                    "ratio_single": single_all / maps,
                }])


def leaks(binary, count, out):
    rows = [{"tracer": "mvs-eval", **row} for row in lines_of(binary, "leaks", count)]
    random = np.random.default_rng(17)
    for rings in (200, 28):
        vertices, triangles = sphere(rings)
        count_here = count // 20
        chosen = vertices[triangles[random.integers(len(triangles), size=count_here)]]
        along = random.random(count_here)
        along[: count_here // 2] = 0.0
        target = chosen[:, 0] + along[:, None] * (chosen[:, 1] - chosen[:, 0])
        origins = (random.random((count_here, 3)) * 0.8 - 0.4).astype(np.float32)
        for robust in (True, False):
            scene, _ = embree(vertices, triangles, robust)
            missed = np.asarray(scene.run(origins, (target - origins).astype(np.float32))) < 0
            rows.append({"tracer": "embree robust" if robust else "embree default",
                         "mesh": f"sphere, {len(triangles) // 1000} k triangles",
                         "rays": count_here,
                         "leaks_at_corners": int(missed[: count_here // 2].sum()),
                         "leaks_at_edges": int(missed[count_here // 2:].sum())})
    append(out / "leaks.csv", rows)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("sides", type=int, nargs="*")
    parser.add_argument("--binary")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--leaks", type=int)
    parser.add_argument("--arbitrate", type=int, nargs="+")
    parser.add_argument("--lens", type=int, nargs="+")
    parser.add_argument("--fisheye", type=int, nargs="+")
    parser.add_argument("--rays", type=int, nargs="+")
    parser.add_argument("--packets", type=int, nargs="+")
    options = parser.parse_args()
    binary = options.binary
    if binary is None:
        build = ["cargo", "build", "--release", "--example", "render_visibility"]
        subprocess.run(build, cwd=ROOT, check=True)
        binary = str(ROOT / "target/release/examples/render_visibility")
    options.out.mkdir(parents=True, exist_ok=True)
    for side in options.sides:
        compare(binary, side, options.repeats, options.out)
    if options.arbitrate:
        append(options.out / "arbitration.csv", lines_of(binary, "arbitrate", *options.arbitrate))
    if options.lens:
        through_lens(binary, "lens", options.lens, options.out)
    if options.fisheye:
        through_lens(binary, "fisheye", options.fisheye, options.out)
    if options.rays:
        many_rays(binary, options.rays, options.repeats, options.out)
    if options.packets:
        packets(binary, options.packets, options.repeats, options.out)
    if options.leaks:
        leaks(binary, options.leaks, options.out)


if __name__ == "__main__":
    main()
