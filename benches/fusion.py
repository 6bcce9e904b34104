"""Times `mvs-eval fuse` against COLMAP's stereo_fusion (pycolmap) and scores both.

usage: python benches/fusion.py --binary target/release/mvs-eval
           --inputs target/release/examples/fusion_inputs --work FOLDER --out FOLDER
           [--scenes tabletop:20x640x480 …] [--memory tabletop:100x640x480@16 …] [--modes hkust …]
           [--repeats 3]

Inputs are the project's synthetic scenes (0.1 % noise, 2 % outliers, flying pixels, holes), written by
`cargo build --release --example fusion_inputs`; for `--memory`, under a budget of so many MiB. COLMAP
gets the depths that pass our confidence filter, exact normals, and a sparse model of exact surface
points from which it chooses neighbours; we get depth and confidence maps and pair.txt. Every run is its
own process on one thread; CPU time and peak memory are the system's account of it, reading, colours and
writing included; an empty run of each tool (Python importing pycolmap; `--version`) is measured too, and
ratios are taken with and without it. No run finds its output already there, and each follows one of the
same that is not measured, so that the system has memory at hand. Clouds are scored by `mvs-eval score`
against samples of the exact surface 0.005 apart at tau = 0.01, thinned by a 0.005 voxel grid; the
surface error is the median exact distance of all points. Needs pycolmap.
"""

import argparse
import csv
import json
import os
import statistics
import subprocess
import sys
import time

MODES = ("hkust", "geo", "dynamic", "gipuma", "cluster")
TAU = 0.01


def run_colmap(workspace, out, settings):
    """One fusion; this process does nothing else."""
    import pycolmap
    options = pycolmap.StereoFusionOptions()
    options.num_threads = 1
    if settings == "strict":
        options.min_num_pixels, options.max_reproj_error = 3, 1
    if settings != "nothing":
        pycolmap.stereo_fusion(out, workspace, "COLMAP", "option-all", "geometric", options, "ply")


def measured(command, output=None, warm=False):
    if warm:
        measured(command, output)
    if output and os.path.exists(output):
        os.remove(output)
    start = time.perf_counter()
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    trouble = child.stderr.read()
    _, status, usage = os.wait4(child.pid, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise SystemExit(f"{command} failed: {trouble.decode()[-400:]}")
    return {"cpu_s": usage.ru_utime + usage.ru_stime, "wall_s": time.perf_counter() - start,
            "peak_mib": usage.ru_maxrss / 1024}


def ours(args, folder, mode, out):
    return [args.binary, "fuse", f"{folder}/scene", "--depths", f"{folder}/depths", "--confidence",
            f"{folder}/confidence", "--mode", mode, "--threads", "1", "--force", "--quiet", "--out", out]


def colmap(folder, settings, out):
    return [sys.executable, __file__, "--colmap", f"{folder}/workspace", out, settings]


def scored(args, folder, cloud):
    """Points, P, R, F and surface error of a cloud."""
    command = [args.binary, "score", "--truth", f"{folder}/truth.ply", "--reconstruction", cloud, "--tau",
               str(TAU), "--voxel", str(TAU / 2), "--force", "--quiet", "--format", "json", "--out",
               f"{folder}/score"]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    kind = os.path.basename(folder).split(":")[0]
    error = subprocess.run([args.inputs, "error", kind, cloud], check=True, capture_output=True, text=True)
    with open(cloud, "rb") as file:
        lines = iter(file.readline, b"end_header\n")
        points = next(int(line.split()[2]) for line in lines if line.startswith(b"element vertex"))
    return {"points": points, **{key: found[key] for key in ("precision", "recall", "f_score")},
            "surface_error": float(error.stdout.split()[0])}


def written(args, name, *more):
    """The folder of a scene, made unless it is there."""
    folder = f"{args.work}/{name}"
    if not os.path.exists(f"{folder}/done{len(more)}"):
        kind, size = name.split(":")
        subprocess.run([args.inputs, folder, kind, *size.split("x"), *more], check=True)
        open(f"{folder}/done{len(more)}", "w", encoding="utf-8").close()
    return folder


def compare(args, name):
    folder = written(args, name, "workspace")
    outputs = {("mvs-eval", mode): f"{folder}/{mode}.ply" for mode in MODES}
    commands = {key: ours(args, folder, key[1], out) for key, out in outputs.items()}
    for settings in ("defaults", "strict", "nothing"):
        out = outputs["COLMAP", settings] = f"{folder}/colmap-{settings}.ply"
        commands["COLMAP", settings] = colmap(folder, settings, out)
    commands["mvs-eval", "nothing"] = [args.binary, "--version"]
    runs = [{"scene": name, "tool": tool, "settings": settings, "repeat": repeat,
             **measured(command, outputs.get((tool, settings)), warm=True)}
            for repeat in range(args.repeats) for (tool, settings), command in commands.items()]
    medians = []
    for tool, settings in commands:
        mine = [run for run in runs if (run["tool"], run["settings"]) == (tool, settings)]
        medians.append({"scene": name, "tool": tool, "settings": settings,
                        **{key: statistics.median(run[key] for run in mine) for key in ("cpu_s", "peak_mib")}})
        print(medians[-1], flush=True)
    return runs, medians, folder


def with_scores(args, folder, medians):
    cpu = {row["settings"]: row["cpu_s"] for row in medians if row["tool"] == "COLMAP"}
    empty = {row["tool"]: row["cpu_s"] for row in medians if row["settings"] == "nothing"}
    for row in medians:
        if row["settings"] == "nothing":
            continue
        for peer in ("defaults", "strict"):
            row[f"ratio_{peer}"] = cpu[peer] / row["cpu_s"]
            row[f"net_{peer}"] = (cpu[peer] - empty["COLMAP"]) / (row["cpu_s"] - empty[row["tool"]])
        name = row["settings"] if row["tool"] == "mvs-eval" else f"colmap-{row['settings']}"
        row.update(scored(args, folder, f"{folder}/{name}.ply"))
        print(row, flush=True)


def memory(args, case):
    name, _, budget = case.partition("@")
    budget = budget or "512"
    folder = written(args, name)
    rows = []
    for mode in args.modes:
        out = f"{folder}/{mode}.ply"
        command = ours(args, folder, mode, out) + ["--memory", budget]
        rows.append({"scene": name, "mode": mode, "memory_mib": budget, **measured(command)})
        os.remove(out)
        print(rows[-1], flush=True)
    return rows


def write(path, rows):
    if not rows:
        return
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main():
    parser = argparse.ArgumentParser()
    for name in ("--binary", "--inputs", "--work", "--out"):
        parser.add_argument(name)
    parser.add_argument("--scenes", nargs="*", default=["tabletop:20x640x480", "tabletop:12x1920x1080",
                                                        "facade:20x640x480", "facade:12x1920x1080"])
    parser.add_argument("--memory", nargs="*", default=[])
    parser.add_argument("--modes", nargs="*", default=MODES, help="of --memory")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--colmap", nargs=3, metavar=("WORKSPACE", "OUT", "SETTINGS"))
    args = parser.parse_args()
    if args.colmap:
        return run_colmap(*args.colmap)
    os.makedirs(args.out, exist_ok=True)
    all_runs, all_medians, remembered = [], [], []
    for name in args.scenes:
        runs, medians, folder = compare(args, name)
        with_scores(args, folder, medians)
        all_runs += runs
        all_medians += medians
    for case in args.memory:
        remembered += memory(args, case)
    write(f"{args.out}/runs.csv", all_runs)
    write(f"{args.out}/fusion.csv", all_medians)
    write(f"{args.out}/memory.csv", remembered)


if __name__ == "__main__":
    main()
