"""Nearest distances: ours beside Open3D's, in one run, on one thread each.

usage: python benches/nearest_distances.py [POINTS] [REPEATS]

Builds and runs metrics/examples/nearest_distances.rs, times Open3D's
compute_point_cloud_distance on the same clouds, and compares the distances bit by bit (checksum).
"""

import json
import os
import statistics
import subprocess
import sys
import time

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["RAYON_NUM_THREADS"] = "1"

import numpy as np
import open3d as o3d

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
sys.path.insert(0, os.path.join(ROOT, "tests", "reference"))
from scoring_open3d import cloud, mixed, surface

U64 = np.uint64


def ours(points, repeats):
    command = ["cargo", "run", "-q", "--release", "-p", "mvs-metrics", "--example",
               "nearest_distances", "--", str(points), str(repeats)]
    return json.loads(subprocess.run(command, cwd=ROOT, check=True, capture_output=True).stdout)


def main():
    points = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    repeats = int(sys.argv[2]) if len(sys.argv) > 2 else 3
    truth, queries = cloud(surface(1, points, 0.0)), cloud(surface(2, points, 0.002))
    out = ours(points, repeats)
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        distances = np.asarray(queries.compute_point_cloud_distance(truth))
        seconds.append(time.process_time() - start)
    with np.errstate(over="ignore"):
        checksum = f"{int(mixed(distances.view(np.uint64)).sum(dtype=np.uint64)):016x}"
    peer = statistics.median(seconds)
    # Both ways: two indices, two searches, against two trees and two searches.
    total = out["build_s"] + out["indexed_s"]
    print(f"points a side {points}, one thread, open3d {o3d.__version__}")
    print(f"open3d, tree and search    {peer / points * 1e9:8.1f} ns/query")
    kiddo = out["kiddo_build_s"] + out["kiddo_search_s"]
    print(f"kiddo, tree and search     {kiddo / points * 1e9:8.1f} ns/query")
    for name, value in (("ours, index", out["build_s"]), ("ours, order and search", out["search_s"]),
                        ("ours, search of an index", out["indexed_s"]),
                        ("ours, the same below 5τ", out["bounded_s"]), ("ours, both ways, each", total)):
        print(f"{name:26} {value / points * 1e9:8.1f} ns/query   {peer / value:6.1f} x")
    print("bits equal:", out["checksum"] == checksum and out["equal_to_kiddo"])


if __name__ == "__main__":
    main()
