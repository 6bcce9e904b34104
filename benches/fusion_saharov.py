"""F-scores of the fused depth maps of `scene_saharov/mvs_depth` against its mesh, by mode.

usage: python benches/fusion_saharov.py --binary mvs-eval --data DATA/scene_saharov --work FOLDER
           [--out table.csv] [--picture picture.jpg] [--sweep table.csv]

The maps are real estimates of a commercial photogrammetry program, a quarter of the photographs' size, with
integer pixel centres and without confidence. The truth is 3,000,000 area-uniform samples of the scene's
mesh, which was made from these very maps: precision says whether fusion keeps what the mesh keeps, not
whether the maps are right. The mesh has holes and stands on ground it does not cover, so both clouds are
cropped to the mesh's bounds grown by 0.01. Scores by `mvs-eval score`, voxels of tau/2. `--picture` draws the
clouds of `hkust` (above) and `geo` into three cameras, a point a pixel, nearest last, turned upright; `--sweep`
fuses `hkust` over the pixel gate and the number of sources at tau = 0.005. Needs trimesh and pillow.
"""

import argparse
import json
import os
import subprocess

import numpy as np
import trimesh
from PIL import Image

from fusion import MODES, write


def write_ply(path, points):
    with open(path, "wb") as file:
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        file.write((header + "property double x\nproperty double y\nproperty double z\nend_header\n").encode())
        file.write(points.astype("<f8").tobytes())


def draw(cloud, cam, shrink=3, size=(1092, 728)):
    words = open(cam).read().split()
    cam_from_world = np.array(words[1:17], dtype=np.float64).reshape(4, 4)
    intrinsic = np.array(words[18:27], dtype=np.float64).reshape(3, 3)
    in_cam = cloud.vertices @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    order = np.argsort(-in_cam[:, 2])
    in_cam, colors = in_cam[order], np.asarray(cloud.colors)[order, :3]
    projected = in_cam @ intrinsic.T
    # Pixel centres are at integers.
    pixel = np.floor((projected[:, :2] / projected[:, 2:] + 0.5) / shrink).astype(int)
    width, height = size[0] // shrink, size[1] // shrink
    inside = (in_cam[:, 2] > 0) & (pixel >= 0).all(axis=1) & (pixel < (width, height)).all(axis=1)
    image = np.full((height, width, 3), 255, np.uint8)
    image[pixel[inside, 1], pixel[inside, 0]] = colors[inside]
    return np.rot90(image)


def picture(args, views=(10, 25, 3)):
    rows = []
    for mode in ("hkust", "geo"):
        cloud = trimesh.load(f"{args.work}/{mode}.ply")
        rows.append(np.hstack([draw(cloud, f"{args.data}/cams/{view:08}_cam.txt") for view in views]))
    Image.fromarray(np.vstack(rows)).save(args.picture, quality=90, optimize=True)


def sweep(args, truth):
    command = [args.binary, "fuse", args.data, "--depths", f"{args.data}/mvs_depth", "--mode", "hkust", "--pixel-center",
               "integer", "--crop", f"{args.work}/crop.json", "--sweep", "--truth", truth, "--tau", "0.005"]
    subprocess.run([*command, "--out", args.sweep, "--force", "--quiet"], check=True, stdout=subprocess.DEVNULL)


def main():
    parser = argparse.ArgumentParser()
    for name in ("binary", "data", "work"):
        parser.add_argument(f"--{name}", required=True)
    for name in ("out", "picture", "sweep"):
        parser.add_argument(f"--{name}")
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
    if args.picture:
        picture(args)
    if args.sweep:
        sweep(args, truth)
    print("trimesh", trimesh.__version__, "numpy", np.__version__)


main()
