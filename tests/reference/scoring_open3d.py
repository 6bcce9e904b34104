"""Runs Open3D's crop, voxel grid, distances and ICP on clouds made from formulas.

usage: python tests/reference/scoring_open3d.py      (writes scoring_open3d.json beside itself)

Needs open3d 0.20 and numpy. The clouds come from an integer hash and +, −, × alone, so that
tests/it/parity.rs makes the same bits and no cloud needs to be checked in. The numbers recorded
here are what the Rust code is held to: counts and checksums equal, transforms to 1e-9.
"""

import json
import os

import numpy as np
import open3d as o3d

U64 = np.uint64


def mixed(bits):
    bits = (bits ^ (bits >> U64(30))) * U64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> U64(27))) * U64(0x94D049BB133111EB)
    return bits ^ (bits >> U64(31))


def unit(seed, key):
    """Uniform in [-1, 1), one number per key."""
    with np.errstate(over="ignore"):
        bits = key * U64(0x9E3779B97F4A7C15) ^ U64(seed) * U64(0xD1B54A32D192ED03)
        return (mixed(bits) >> U64(11)).astype(np.float64) / 2.0**52 - 1.0


def surface(seed, count, noise):
    """Points on z = x²/4 − xy/8 + y/16 over the square [-1, 1)², moved by up to `noise` in z."""
    i = np.arange(count, dtype=np.uint64)
    x, y = unit(seed, i * U64(3)), unit(seed, i * U64(3) + U64(1))
    z = 0.25 * x * x - 0.125 * x * y + 0.0625 * y
    return np.stack([x, y, z + unit(seed, i * U64(3) + U64(2)) * noise], axis=1)


def scattered(seed, count):
    keys = np.arange(3 * count, dtype=np.uint64).reshape(-1, 3)
    return unit(seed, keys)


def lattice(size, step):
    """All points of a size³ lattice, x slowest."""
    axis = np.arange(size) * step
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


NOTCHED = [[-0.875, -0.875], [0.875, -0.9375], [0.75, 0.875], [0.0625, -0.25], [-0.8125, 0.9375]]


def cases():
    truth = surface(1, 40000, 0.0)
    rec = surface(2, 30000, 0.03)
    rec = rec[~((rec[:, 0] > 0.25) & (rec[:, 1] > 0.25))]
    rec = np.concatenate([rec, scattered(3, 500)])
    prism = {"axis": 2, "min": -0.5, "max": 0.4375, "polygon": NOTCHED}
    yield {"name": "surface", "tau": 0.02, "crop": prism}, truth, rec
    offset = np.array([448262.5, 5427700.25, 120.0])
    polygon = (np.array(NOTCHED) + offset[:2]).tolist()
    utm = {"axis": 2, "min": 119.5, "max": 120.4375, "polygon": polygon}
    yield {"name": "utm", "tau": 0.02, "crop": utm}, truth + offset, rec + offset
    # Every point lies on voxel borders (size τ/2, start half a voxel lower), many on polygon edges,
    # and where the reconstruction stops many distances are exactly τ.
    grid = lattice(33, 0.0625)
    moved = grid[::2] + np.array([0.0, 0.0, 0.0625])
    moved = moved[moved[:, 1] < 1.0]
    edges = [[0.25, 0.25], [1.75, 0.25], [1.75, 1.25], [1.0, 0.875], [0.25, 1.75]]
    for axis in range(3):
        crop = {"axis": axis, "min": 0.5, "max": 1.5, "polygon": edges}
        yield {"name": f"lattice_{'xyz'[axis]}", "tau": 0.25, "crop": crop}, grid, moved


def cloud(points):
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def volume(crop):
    axis = crop["axis"]
    u, v = [a for a in range(3) if a != axis]
    vertices = np.zeros((len(crop["polygon"]), 3))
    vertices[:, [u, v]] = crop["polygon"]
    out = o3d.visualization.SelectionPolygonVolume()
    out.orthogonal_axis = "XYZ"[axis]
    out.axis_min, out.axis_max = crop["min"], crop["max"]
    out.bounding_polygon = o3d.utility.Vector3dVector(vertices)
    return out


def checksum(values):
    """The same for every order of rows; changes when one bit of one number does."""
    bits = np.ascontiguousarray(values, dtype=np.float64).view(np.uint64).reshape(len(values), -1)
    with np.errstate(over="ignore"):
        row = np.zeros(len(values), dtype=np.uint64)
        for column in bits.T:
            row = mixed(row * U64(0x9E3779B97F4A7C15) + column)
        return f"{int(row.sum(dtype=np.uint64)):016x}"


def scored(rec, truth, transform, case):
    crop, tau = volume(case["crop"]), case["tau"]
    moved = cloud(rec).transform(transform)
    sides = {}
    for name, side in (("reconstruction", moved), ("truth", cloud(truth))):
        cropped = crop.crop_point_cloud(side)
        thinned = cropped.voxel_down_sample(tau / 2)
        sides[name] = thinned
        sides[name + "_out"] = {
            "input": len(side.points),
            "cropped": len(cropped.points),
            "cropped_checksum": checksum(np.asarray(cropped.points)),
            "evaluated": len(thinned.points),
            "evaluated_checksum": checksum(np.asarray(thinned.points)),
        }
    out = {}
    for name, other in (("reconstruction", "truth"), ("truth", "reconstruction")):
        distances = np.asarray(sides[name].compute_point_cloud_distance(sides[other]))
        edges = np.arange(0, tau * 5, tau / 100)
        counts, _ = np.histogram(distances, edges)
        entry = sides[name + "_out"]
        entry["exactly_tau"] = int((distances == tau).sum())
        entry["within"] = int((distances < tau).sum())
        entry["distances_checksum"] = checksum(distances)
        entry["curve"] = np.cumsum(counts).tolist()
        out[name] = entry
    p = out["reconstruction"]["within"] / out["reconstruction"]["evaluated"]
    r = out["truth"]["within"] / out["truth"]["evaluated"]
    out["precision"], out["recall"] = p, r
    out["fscore"] = 2 * p * r / (p + r)
    return out


def icp_stages(rec, truth, start, case, rmse_tolerance):
    """The toolbox's stages 1 and 2 (stage 3 thins only above four million points)."""
    crop, tau = volume(case["crop"]), case["tau"]
    registration = o3d.pipelines.registration
    criteria = registration.ICPConvergenceCriteria(1e-6, rmse_tolerance)
    stages, transform = [], start
    for voxel, reach in ((tau, 80 * tau), (tau / 2, 20 * tau), (None, 2 * tau)):
        source = crop.crop_point_cloud(cloud(rec).transform(transform))
        target = crop.crop_point_cloud(cloud(truth))
        if voxel is not None:
            source, target = source.voxel_down_sample(voxel), target.voxel_down_sample(voxel)
        def run(points):
            return registration.registration_icp(
                cloud(points), target, reach, np.identity(4),
                registration.TransformationEstimationPointToPoint(True), criteria)
        points = np.asarray(source.points)
        result = run(points)
        others = [run(points[np.random.default_rng(seed).permutation(len(points))])
                  for seed in range(16)]
        stages.append({
            "start": transform.tolist(), "voxel": voxel, "reach": reach,
            "source": len(source.points), "target": len(target.points),
            "update": result.transformation.tolist(), "fitness": result.fitness,
            "rmse": result.inlier_rmse, "pairs": len(result.correspondence_set),
            "spread": spread(points, result, others)})
        transform = result.transformation @ transform
    return stages, transform


def spread(points, result, others):
    """How far Open3D's own answers lie apart when only the order of the source points changes."""
    def moved(r):
        return np.asarray(cloud(points).transform(r.transformation).points)
    return {
        "points": max(float(np.abs(moved(o) - moved(result)).max()) for o in others),
        "rmse": max(abs(o.inlier_rmse - result.inlier_rmse) for o in others),
        "pairs": max(abs(len(o.correspondence_set) - len(result.correspondence_set)) for o in others),
    }


def perturbation(centre):
    """A similarity about `centre`: 1 % in scale, about 1° of rotation, 0.02 of translation."""
    c, s = np.cos(0.02), np.sin(0.02)
    linear = 1.01 * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, c, -s], [0, s, c]])
    out = np.identity(4)
    out[:3, :3] = linear
    out[:3, 3] = centre - linear @ centre + np.array([0.02, -0.01, 0.015])
    return out


def main():
    records = []
    for case, truth, rec in cases():
        case["identity"] = scored(rec, truth, np.identity(4), case)
        if not case["name"].startswith("lattice"):
            centre = np.array([448262.5, 5427700.25, 120.0]) if case["name"] == "utm" else np.zeros(3)
            start = perturbation(centre)
            case["start"] = {"transform": start.tolist(), "score": scored(rec, truth, start, case)}
            for profile, rmse_tolerance in (("official", 20.0), ("converged", 1e-6)):
                stages, final = icp_stages(rec, truth, start, case, rmse_tolerance)
                case[profile] = {"stages": stages, "transform": final.tolist(),
                                 "score": scored(rec, truth, final, case)}
        case["arange"] = [len(np.arange(0, t * 5, t / 100)) for t in TAUS]
        records.append(case)
    out = {"made_by": "tests/reference/scoring_open3d.py", "open3d": o3d.__version__,
           "numpy": np.__version__, "taus": TAUS, "cases": records}
    path = os.path.join(os.path.dirname(os.path.abspath(__file__)), "scoring_open3d.json")
    with open(path, "w", encoding="utf-8") as file:
        json.dump(out, file, separators=(",", ":"))
        file.write("\n")
    for case in records:
        print(case["name"], {k: v for k, v in case["identity"].items() if not isinstance(v, dict)})
        for profile in ("official", "converged"):
            if profile in case:
                print("  ", profile, case[profile]["score"]["fscore"],
                      [(s["fitness"], s["rmse"], s["pairs"], s["spread"]) for s in case[profile]["stages"]])


TAUS = [0.01, 0.005, 0.025, 0.003, 0.03, 0.02, 0.1, 0.07, 1.0, 0.013, 0.0077]

if __name__ == "__main__":
    main()
