"""Drives the official Tanks and Temples procedure through Open3D on a scene made from formulas.

usage: python tests/reference/tnt_open3d.py      (writes tnt_open3d.json beside itself)

Needs open3d 0.20 and numpy. Trajectory alignment by RANSAC over several seeds, then the three ICP
stages, crop, voxels, distances, counts and curves, from the start that the first seed gave. The
scene comes from the integer hash of scoring_open3d.py and from products with powers of two, so that
tests/it/score makes the same bits and no cloud needs to be checked in.
"""

import json
import os

import numpy as np
import open3d as o3d

from scoring_open3d import NOTCHED, cloud, scattered, surface, unit, volume

TAU = 0.02
CAMERAS = 40
SEEDS = 8
CROP = {"axis": 2, "min": -0.5, "max": 0.4375, "polygon": NOTCHED}
# Frame of the reconstruction: axes turned and halved. Frame of the reference: turned and quartered.
OWN_FROM_SCAN = 0.5 * np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
REF_FROM_SCAN = 0.25 * np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])


def clouds():
    """Truth and reconstruction, the latter with noise, outliers and a missing quarter."""
    truth = surface(1, 40000, 0.0)
    rec = surface(2, 30000, 0.03)
    rec = rec[~((rec[:, 0] > 0.25) & (rec[:, 1] > 0.25))]
    rec = np.concatenate([rec, scattered(3, 500)])
    return truth, rec[:, [1, 2, 0]] * 0.5


def cameras():
    keys = np.arange(3 * CAMERAS, dtype=np.uint64).reshape(-1, 3)
    centres = unit(4, keys) * np.array([2.0, 2.0, 0.5]) + np.array([0.0, 0.0, 2.0])
    given = centres + unit(5, keys) * 0.02
    return centres, given[:, [1, 2, 0]] * 0.5


def given_centres(case, given):
    """The centres as the toolbox sees them: unregistered ones stand at the origin."""
    given = given.copy()
    if case == "unregistered":
        given[::5] = 0.0
    if case == "video":
        video = np.zeros((45 * CAMERAS, 3))
        frames = 1 + 45 * np.arange(CAMERAS)
        video[frames - 1] = given
        given = video[frames - 1]
    return given


def align(given, centres, seed):
    o3d.utility.random.seed(seed)
    registration = o3d.pipelines.registration
    pairs = np.repeat(np.arange(len(centres), dtype=np.int32)[:, None], 2, axis=1)
    criteria = registration.RANSACConvergenceCriteria()
    criteria.max_iteration = 100000
    result = registration.registration_ransac_based_on_correspondence(
        cloud(given), cloud(centres), o3d.utility.Vector2iVector(pairs), 0.2,
        registration.TransformationEstimationPointToPoint(True), 6, criteria=criteria)
    return result.transformation


def refine(rec, truth, start):
    crop, registration = volume(CROP), o3d.pipelines.registration
    # As shipped: the toolbox's 20 iterations arrive as the RMSE tolerance.
    criteria = registration.ICPConvergenceCriteria(1e-6, 20)
    stages, transform = [], start
    for voxel, reach in ((TAU, 80 * TAU), (TAU / 2, 20 * TAU), (None, 2 * TAU)):
        source = crop.crop_point_cloud(cloud(rec).transform(transform))
        target = crop.crop_point_cloud(cloud(truth))
        if voxel is not None:
            source, target = source.voxel_down_sample(voxel), target.voxel_down_sample(voxel)
        result = registration.registration_icp(
            source, target, reach, np.identity(4),
            registration.TransformationEstimationPointToPoint(True), criteria)
        transform = result.transformation @ transform
        stages.append({"source": len(source.points), "target": len(target.points),
                       "fitness": result.fitness, "rmse": result.inlier_rmse,
                       "transform": transform.tolist()})
    return stages, transform


def score(rec, truth, transform):
    crop = volume(CROP)
    moved = cloud(rec).transform(transform)
    out, thinned = {}, {}
    for name, side in (("reconstruction", moved), ("truth", cloud(truth))):
        cropped = crop.crop_point_cloud(side)
        thinned[name] = cropped.voxel_down_sample(TAU / 2)
        out[name] = {"input": len(side.points), "cropped": len(cropped.points),
                     "evaluated": len(thinned[name].points)}
    fractions = []
    for name, other in (("reconstruction", "truth"), ("truth", "reconstruction")):
        distances = np.asarray(thinned[name].compute_point_cloud_distance(thinned[other]))
        bins = np.arange(0, TAU * 5, TAU / 100)
        curve = np.cumsum(np.histogram(distances, bins)[0]).astype(float) / len(distances)
        out[name]["within"] = int((distances < TAU).sum())
        out[name]["curve"] = curve[::50].tolist()
        fractions.append(out[name]["within"] / len(distances))
    p, r = fractions
    return {**out, "precision": p, "recall": r, "f_score": 2 * p * r / (p + r)}


def main():
    truth, rec = clouds()
    centres, given = cameras()
    cases = {}
    for case in ("clean", "unregistered", "video"):
        seen = given_centres(case, given)
        starts = [align(seen, centres, seed) for seed in range(SEEDS)]
        f_scores = [score(rec, truth, refine(rec, truth, start)[1])["f_score"] for start in starts]
        stages, final = refine(rec, truth, starts[0])
        cases[case] = {"start": starts[0].tolist(), "stages": stages,
                       "score": score(rec, truth, final), "f_over_seeds": f_scores}
        print(case, f_scores)
    out = {"made_by": "tests/reference/tnt_open3d.py", "open3d": o3d.__version__,
           "numpy": np.__version__, "tau": TAU, "cases": cases}
    path = os.path.join(os.path.dirname(os.path.abspath(__file__)), "tnt_open3d.json")
    with open(path, "w", encoding="utf-8") as file:
        json.dump(out, file, indent=1)
        file.write("\n")


if __name__ == "__main__":
    main()
