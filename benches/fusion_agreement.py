"""How many pixels `mvs-eval fuse --mode geo` and PatchmatchNet's evaluation script decide alike.

usage: python benches/fusion_agreement.py --binary mvs-eval --scene SCENE --depths DIR
           --confidence DIR --eval eval.py [--out table.csv]

`eval.py` is that of https://github.com/FangjinhuaWang/PatchmatchNet, as it is; only its functions
`reproject_with_depth` and `check_geometric_consistency` are run, with its rule around them: 1 pixel,
1 %, confidence above 0.8, three sources of all in pair.txt. It takes pixel centres at integers, so the
cams are read so by both. Ours says by its filtered depth maps which pixels it keeps. Needs numpy and
OpenCV, whose remap has weights in 1/32 pixel; `exact` replaces it by bilinear weights in f32.
"""

import argparse
import ast
import os
import subprocess
import tempfile

import cv2
import numpy as np

from fusion import write


def read_pfm(path):
    with open(path, "rb") as file:
        assert file.readline().strip() == b"Pf"
        width, height = map(int, file.readline().split())
        assert float(file.readline()) < 0
        return np.frombuffer(file.read(), "<f4").reshape(height, width)[::-1].copy()


def read_cam(path):
    words = open(path).read().split()
    extrinsic = np.array(words[1:17], dtype=np.float64).reshape(4, 4)
    return np.array(words[18:27], dtype=np.float64).reshape(3, 3), extrinsic


def read_pairs(path):
    words = open(path).read().split()
    at, pairs = 1, {}
    for _ in range(int(words[0])):
        reference, count = int(words[at]), int(words[at + 1])
        pairs[reference] = [int(words[at + 2 + 2 * i]) for i in range(count)]
        at += 2 + 2 * count
    return pairs


def exact_remap(image, x, y, interpolation):
    x, y = x.astype(np.float64), y.astype(np.float64)
    image = image.astype(np.float64)
    height, width = image.shape
    left, top = np.floor(x), np.floor(y)
    total = np.zeros(x.shape)
    for dy in (0, 1):
        for dx in (0, 1):
            column, row = left + dx, top + dy
            inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
            weight = (1 - np.abs(x - column)) * (1 - np.abs(y - row))
            value = image[np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int)]
            total += np.where(inside, weight * value, 0)
    return total.astype(np.float32)


def functions(path, remap):
    """The two functions of the script, without what it imports."""
    wanted = ("reproject_with_depth", "check_geometric_consistency")
    tree = ast.parse(open(path).read())
    tree.body = [node for node in tree.body if getattr(node, "name", None) in wanted]

    class Cv:
        INTER_LINEAR = cv2.INTER_LINEAR

    Cv.remap = staticmethod(remap)
    from typing import Tuple

    names = {"np": np, "cv2": Cv, "Tuple": Tuple}
    exec(compile(tree, path, "exec"), names)
    return names["check_geometric_consistency"]


def main():
    parser = argparse.ArgumentParser()
    for name in ("binary", "scene", "depths", "confidence", "eval"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--out")
    args = parser.parse_args()
    cams = os.path.join(args.scene, "cams")
    pairs = read_pairs(f"{cams}/pair.txt")
    folder = tempfile.mkdtemp()
    subprocess.run([args.binary, "fuse", args.scene, "--depths", args.depths, "--confidence", args.confidence,
                    "--mode", "geo", "--pixel-center", "integer", "--filtered-depths", f"{folder}/depths",
                    "--out", f"{folder}/cloud.ply", "--quiet", "--threads", "1"],
                   check=True, stdout=subprocess.DEVNULL)
    rows = []
    for name, remap in (("script", cv2.remap), ("exact", exact_remap)):
        check = functions(args.eval, remap)
        views = {view: (read_pfm(f"{args.depths}/{view:08}.pfm"), *read_cam(f"{cams}/{view:08}_cam.txt"))
                 for view in pairs}
        pixels = differ = script_points = our_points = interior = interior_differ = 0
        off = []
        for view, sources in pairs.items():
            depth, *camera = views[view]
            sure = read_pfm(f"{args.confidence}/{view:08}.pfm") > 0.8
            count = np.zeros(depth.shape, int)
            total = depth.astype(np.float32)
            with np.errstate(all="ignore"):
                for source in sources[:10]:
                    there, *other = views[source]
                    mask, back = check(depth, *camera, there, *other, 1.0, 0.01)
                    count += mask
                    total = total + back
            keeps = sure & (count >= 3) & (depth > 0)
            ours = read_pfm(f"{folder}/depths/{view:08}.pfm")
            unlike = keeps != (ours > 0)
            both = keeps & (ours > 0)
            off.append(np.abs(ours[both] / (total / (count + 1))[both] - 1))
            pixels, differ = pixels + depth.size, differ + int(unlike.sum())
            interior, interior_differ = interior + int((depth > 0).sum()), interior_differ + int(unlike.sum())
            script_points, our_points = script_points + int(keeps.sum()), our_points + int((ours > 0).sum())
        off = np.concatenate(off)
        rows.append({"remap": name, "pixels": pixels, "differ": differ, "agreement": 1 - differ / pixels,
                     "agreement_of_pixels_with_depth": 1 - interior_differ / interior,
                     "script_points": script_points, "our_points": our_points,
                     "median_relative_depth_difference": float(np.median(off)),
                     "max_relative_depth_difference": float(off.max())})
        print(rows[-1], flush=True)
    if args.out:
        write(args.out, rows)
    print("numpy", np.__version__, "OpenCV", cv2.__version__)


main()
