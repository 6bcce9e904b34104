"""Do the cameras, the mesh and the photographs of a scene agree? Without any rendered colour.

usage: python benches/scene_consistency.py --scene DIR --rendered DIR --out DIR

Needs numpy and opencv-python. SIFT features of neighbouring photographs are matched (ratio .75, one
motion by MAGSAC); `--rendered` is a folder that `mvs-eval render` wrote for the scene, for its depth maps.
Per pair of views: the distance of matches to the epipolar line of the given cameras, and where the mesh
point that the first view sees lies in the second, counted from the match. Writes consistency.csv.
"""

import argparse
import csv
import pathlib

import cv2
import numpy as np
from render_scene import read_pfm


def camera(scene, view):
    words = (scene / "cams" / f"{view:08}_cam.txt").read_text().split()
    return np.array(words[18:27], float).reshape(3, 3), np.array(words[1:17], float).reshape(4, 4)


def features(scene, rendered, view):
    image = cv2.imread(str(next((scene / "images").glob(f"{view:08}.*"))), cv2.IMREAD_GRAYSCALE)
    depth = read_pfm(rendered / "depth" / f"{view:08}.pfm")
    keypoints, descriptors = cv2.SIFT_create(6000).detectAndCompute(image, None)
    points = np.array([keypoint.pt for keypoint in keypoints])
    column, row = points.round().astype(int).T
    z = depth[row.clip(0, depth.shape[0] - 1), column.clip(0, depth.shape[1] - 1)]
    return points[z > 0], descriptors[z > 0], z[z > 0]


def compare(scene, first, second, a, b):
    (p, at_p, z), (q, at_q, _) = first, second
    pairs = cv2.BFMatcher().knnMatch(at_p, at_q, k=2)
    pairs = [best for best, other in pairs if best.distance < 0.75 * other.distance]
    here, there = [m.queryIdx for m in pairs], [m.trainIdx for m in pairs]
    p, z, q = p[here], z[here], q[there]
    _, agrees = cv2.findFundamentalMat(p, q, cv2.USAC_MAGSAC, 1.5, 0.9999, 10000)
    agrees = agrees.ravel() > 0
    p, z, q = np.c_[p, np.ones(len(p))][agrees], z[agrees], np.c_[q, np.ones(len(q))][agrees]
    (ka, pose_a), (kb, pose_b) = camera(scene, a), camera(scene, b)
    between = pose_b @ np.linalg.inv(pose_a)
    x, y, w = between[:3, 3]
    cross = np.array([[0, -w, y], [w, 0, -x], [-y, x, 0]])
    lines = p @ (np.linalg.inv(kb).T @ cross @ between[:3, :3] @ np.linalg.inv(ka)).T
    epipolar = abs((lines * q).sum(1)) / np.hypot(lines[:, 0], lines[:, 1])
    seen = kb @ (between[:3, :3] @ (np.linalg.inv(ka) @ p.T * z) + between[:3, 3:])
    offset = (seen[:2] / seen[2]).T - q[:, :2]
    return {
        "first": a,
        "second": b,
        "matches": len(p),
        "epipolar_median": np.median(epipolar),
        "offset_x": np.median(offset[:, 0]),
        "offset_y": np.median(offset[:, 1]),
        "offset_median": np.median(np.hypot(*offset.T)),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=pathlib.Path, required=True)
    parser.add_argument("--rendered", type=pathlib.Path, required=True)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    options = parser.parse_args()
    cv2.setRNGSeed(1)
    views = sorted(int(path.name[:8]) for path in (options.scene / "cams").glob("*_cam.txt"))
    found = {view: features(options.scene, options.rendered, view) for view in views}
    pairs = zip(views, [*views[1:], views[0]])
    rows = [compare(options.scene, found[a], found[b], a, b) for a, b in pairs]
    with open(options.out / "consistency.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
