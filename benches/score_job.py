"""Times the whole Tanks and Temples job of mvs-eval against the same pipeline on Open3D 0.20.

usage: python benches/score_job.py --binary target/release/mvs-eval --out FOLDER [--points N …] [--alone N …]

Both run in their own process, pinned to one thread, on the same files: read the clouds, align by
RANSAC over the camera centres and three ICP stages (profile official), crop, voxels, distances both
ways, counts, outputs. CPU time and peak memory are the system's account of the child process. The
Open3D side does what the toolbox does, the unused normals included. Needs open3d, numpy.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

CAMERAS = 60


def scene(folder, count):
    """A bumpy sphere, its noisy reconstruction in another frame, cameras and a crop."""
    rng = np.random.default_rng(0)

    def surface(n, noise):
        d = rng.standard_normal((n, 3))
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        r = 1 + 0.1 * np.sin(5 * d[:, :1]) * np.cos(7 * d[:, 1:2]) + noise * rng.standard_normal((n, 1))
        return d * r

    tau = 1.2 * np.sqrt(4 * np.pi / count)
    truth, rec = surface(count, 0.0), surface(count, 0.3 * tau)
    centres = 2.5 * surface(CAMERAS, 0.02)
    own = 0.37
    os.makedirs(f"{folder}/Bench")
    write_ply(f"{folder}/Bench/Bench.ply", truth)
    write_ply(f"{folder}/rec.ply", rec[:, [1, 2, 0]] * own + [0.3, -0.2, 0.1])
    write_log(f"{folder}/Bench/Bench_COLMAP_SfM.log", centres)
    noisy = centres + rng.standard_normal(centres.shape) * 0.003
    write_log(f"{folder}/rec.log", noisy[:, [1, 2, 0]] * own + [0.3, -0.2, 0.1])
    np.savetxt(f"{folder}/Bench/Bench_trans.txt", np.eye(4))
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    polygon = np.stack([1.3 * np.cos(angles), 1.3 * np.sin(angles), 0 * angles], axis=1)
    with open(f"{folder}/Bench/Bench.json", "w", encoding="utf-8") as file:
        json.dump({"class_name": "SelectionPolygonVolume", "orthogonal_axis": "Z", "axis_min": -0.9,
                   "axis_max": 1.3, "bounding_polygon": polygon.tolist(), "version_major": 1,
                   "version_minor": 0}, file)
    return tau


def write_ply(path, points):
    with open(path, "wb") as file:
        file.write((f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
                    "property float x\nproperty float y\nproperty float z\nend_header\n").encode())
        file.write(points.astype("<f4").tobytes())


def write_log(path, centres):
    with open(path, "w", encoding="utf-8") as file:
        for i, c in enumerate(centres):
            file.write(f"{i} {i} 0\n1 0 0 {c[0]!r}\n0 1 0 {c[1]!r}\n0 0 1 {c[2]!r}\n0 0 0 1\n"
                       .replace("np.float64(", "").replace(")", ""))


def run_open3d(folder, tau):
    """The official pipeline; this process does nothing else."""
    import open3d as o3d
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(0)
    read = o3d.io.read_point_cloud
    truth, rec = read(f"{folder}/Bench/Bench.ply"), read(f"{folder}/rec.ply")
    crop = o3d.visualization.read_selection_polygon_volume(f"{folder}/Bench/Bench.json")

    def cloud(points):
        return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))

    def centres(path):
        rows = [line.split() for line in open(path, encoding="utf-8")]
        return np.array([[float(rows[5 * i + k][3]) for k in (1, 2, 3)] for i in range(len(rows) // 5)])

    pairs = np.repeat(np.arange(CAMERAS, dtype=np.int32)[:, None], 2, axis=1)
    ransac = registration.RANSACConvergenceCriteria()
    ransac.max_iteration = 100000
    estimation = registration.TransformationEstimationPointToPoint(True)
    motion = registration.registration_ransac_based_on_correspondence(
        cloud(centres(f"{folder}/rec.log")), cloud(centres(f"{folder}/Bench/Bench_COLMAP_SfM.log")),
        o3d.utility.Vector2iVector(pairs), 0.2, estimation, 6, criteria=ransac).transformation

    def prepared(points, transform, voxel):
        moved = crop.crop_point_cloud(o3d.geometry.PointCloud(points).transform(transform))
        return moved.voxel_down_sample(voxel) if voxel else moved

    for voxel, reach in ((tau, 80 * tau), (tau / 2, 20 * tau), (None, 2 * tau)):
        source, target = prepared(rec, motion, voxel), prepared(truth, np.eye(4), voxel)
        result = registration.registration_icp(source, target, reach, np.eye(4), estimation,
                                               registration.ICPConvergenceCriteria(1e-6, 20))
        motion = result.transformation @ motion
    s, t = prepared(rec, motion, tau / 2), prepared(truth, np.eye(4), tau / 2)
    for side in (s, t):
        side.estimate_normals(search_param=o3d.geometry.KDTreeSearchParamKNN(knn=20))
    d1 = np.asarray(s.compute_point_cloud_distance(t))
    d2 = np.asarray(t.compute_point_cloud_distance(s))
    for name, side in (("precision", s), ("recall", t)):
        o3d.io.write_point_cloud(f"{folder}/o3d_{name}.ply", side)
    p, r = (d1 < tau).mean(), (d2 < tau).mean()
    print(json.dumps({"f": 2 * p * r / (p + r), "n": [len(d1), len(d2)]}))


def measured(command, env):
    start = time.perf_counter()
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=env)
    out = child.stdout.read()
    _, status, usage = os.wait4(child.pid, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise SystemExit(f"{command} failed")
    answer = json.loads(out)
    return {"cpu_s": usage.ru_utime + usage.ru_stime, "wall_s": time.perf_counter() - start,
            "peak_mib": usage.ru_maxrss / 1024, "f_score": answer.get("f_score", answer.get("f"))}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary")
    parser.add_argument("--out")
    parser.add_argument("--points", type=int, nargs="*", default=[1_000_000])
    parser.add_argument("--alone", type=int, nargs="*", default=[], help="points a side timed without Open3D")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--open3d", nargs=2, metavar=("FOLDER", "TAU"))
    parser.add_argument("--scene", nargs=2, metavar=("FOLDER", "POINTS"))
    args = parser.parse_args()
    if args.scene:
        return print(repr(float(scene(args.scene[0], int(args.scene[1])))))
    if args.open3d:
        return run_open3d(args.open3d[0], float(args.open3d[1]))
    env = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
    rows, tools = [], ("mvs-eval", "open3d")
    for count in args.points + args.alone:
        with tempfile.TemporaryDirectory() as folder:
            # Made elsewhere: a child's peak begins with what its parent holds.
            maker = [sys.executable, __file__, "--scene", folder, str(count)]
            tau = float(subprocess.run(maker, check=True, capture_output=True).stdout)
            for repeat in range(args.repeats):
                ours = [args.binary, "score", "--protocol", "tnt", "--scene", f"{folder}/Bench",
                        "--reconstruction", f"{folder}/rec.ply", "--trajectory", f"{folder}/rec.log",
                        "--tau", repr(float(tau)), "--profile", "official", "--one-profile",
                        "--threads", "1", "--force", "--format", "json", "--out", f"{folder}/out"]
                theirs = [sys.executable, __file__, "--open3d", folder, repr(float(tau))]
                for tool, command in zip(tools, (ours, theirs)[:2 if count in args.points else 1]):
                    row = {"points": count, "tool": tool, "repeat": repeat, **measured(command, env)}
                    print(row, flush=True)
                    rows.append(row)
    os.makedirs(args.out, exist_ok=True)
    write_rows(f"{args.out}/score_job.csv", rows)
    medians, growth = [], []
    for count in args.points + args.alone:
        def median(tool, key):
            return float(np.median([r[key] for r in rows if r["points"] == count and r["tool"] == tool]))
        keys = ("cpu_s", "peak_mib", "f_score")
        mine = {key: median("mvs-eval", key) for key in keys}
        growth.append({"points": count, "cpu_s": mine["cpu_s"], "us_per_point": mine["cpu_s"] / count * 1e6,
                       "peak_mib": mine["peak_mib"], "bytes_per_point": mine["peak_mib"] * 2**20 / count})
        if count in args.points:
            peer = {key: median("open3d", key) for key in keys}
            medians.append({"points": count, "cpu_s": mine["cpu_s"], "open3d_cpu_s": peer["cpu_s"],
                            "cpu_ratio": peer["cpu_s"] / mine["cpu_s"], "peak_mib": mine["peak_mib"],
                            "open3d_peak_mib": peer["peak_mib"],
                            "peak_ratio": peer["peak_mib"] / mine["peak_mib"],
                            "f_score": mine["f_score"], "open3d_f_score": peer["f_score"]})
            print(medians[-1])
    if medians:
        write_rows(f"{args.out}/medians.csv", medians)
    write_rows(f"{args.out}/growth.csv", sorted(growth, key=lambda row: row["points"]))


def write_rows(path, rows):
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
