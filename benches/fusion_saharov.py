"""F-scores of the fused depth maps of `scene_saharov/mvs_depth` against its mesh, by mode.

usage: python benches/fusion_saharov.py --binary mvs-eval --data DATA/scene_saharov --work FOLDER
           [--out table.csv]

The maps are real estimates of a commercial photogrammetry program, a quarter of the photographs' size, with
integer pixel centres and without confidence. The truth is 3,000,000 area-uniform samples of the scene's
mesh, which was made from these very maps: precision says whether fusion keeps what the mesh keeps, not
whether the maps are right. The mesh has holes and stands on ground it does not cover, so both clouds are
cropped to the mesh's bounds grown by 0.01. Scores by `mvs-eval score`, voxels of tau/2. Needs trimesh.
"""

import argparse
import json
import os
import subprocess

import numpy as np
import trimesh

from fusion import MODES, write


def write_ply(path, points):
    with open(path, "wb") as file:
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        file.write((header + "property double x\nproperty double y\nproperty double z\nend_header\n").encode())
        file.write(points.astype("<f8").tobytes())


def main():
    parser = argparse.ArgumentParser()
    for name in ("binary", "data", "work"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--out")
    parser.add_argument("--modes", nargs="+", default=MODES)
    args = parser.parse_args()
    os.makedirs(args.work, exist_ok=True)
    models = [name for name in os.listdir(f"{args.data}/model") if name.endswith(".obj")]
    mesh = trimesh.load(f"{args.data}/model/{models[0]}", process=False, force="mesh")
    truth = f"{args.work}/truth.ply"
    points, _ = trimesh.sample.sample_surface(mesh, 3_000_000, seed=1)
    write_ply(truth, np.asarray(points))
    low, high = points.min(axis=0) - 0.01, points.max(axis=0) + 0.01
    crop = {"class_name": "SelectionPolygonVolume", "version_major": 1, "version_minor": 0,
            "orthogonal_axis": "Z", "axis_min": low[2], "axis_max": high[2],
            "bounding_polygon": [[x, y, 0.0] for x, y in ((low[0], low[1]), (high[0], low[1]),
                                                          (high[0], high[1]), (low[0], high[1]))]}
    json.dump(crop, open(f"{args.work}/crop.json", "w"))
    rows = []
    for mode in args.modes:
        cloud = f"{args.work}/{mode}.ply"
        done = subprocess.run([args.binary, "fuse", args.data, "--depths", f"{args.data}/mvs_depth", "--mode", mode,
                        "--pixel-center", "integer", "--crop", f"{args.work}/crop.json", "--out", cloud,
                        "--force", "--quiet", "--format", "json"], check=True, capture_output=True, text=True)
        counts = json.loads(done.stdout)
        for tau in (0.003, 0.005, 0.01):
            found = subprocess.run([args.binary, "score", "--truth", truth, "--reconstruction", cloud, "--tau",
                                    str(tau), "--voxel", str(tau / 2), "--out", f"{args.work}/score", "--force", "--quiet",
                                    "--format", "json"], capture_output=True, text=True)
            score = json.loads(found.stdout)
            rows.append({"mode": mode, "tau": tau, "points": counts["points"],
                         **{key: score[key] for key in ("precision", "recall", "f_score")}})
            print(rows[-1], flush=True)
    if args.out:
        write(args.out, rows)
    print("trimesh", trimesh.__version__, "numpy", np.__version__)


main()
