"""What more threads bring: wall and CPU time of whole commands at several numbers of threads.

usage: python benches/threads.py --binary target/release/mvs-eval [--before OTHER_BINARY]
           --inputs target/release/examples/fusion_inputs --work FOLDER --out FILE.csv
           [--threads 1 2 4 8 16] [--repeats 3] [--views 20] [--points 4000000]
           [--mesh PATH --cameras PATH --photos DIR]

Each row is one command with one number of threads, the medians of its repeats: wall seconds, and user and
system seconds of the child process. `fuse` gets the synthetic tabletop scene at 1920x1080, `score` the two
clouds made of it, and Tanks and Temples the bumpy sphere of score_job.py; with a mesh, cameras and
photographs `render` and `generate` run on those. `--before` runs another build of the program beside,
command by command. A run that does not end with 0 or 1 is counted as failed and not timed.
"""

import argparse
import csv
import os
import resource
import shutil
import statistics
import subprocess
import time

import score_job


def measured(command):
    """Wall, user and system seconds of a run; None where it failed."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    status = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if status.returncode not in (0, 1):
        return None
    return wall, after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime


def commands(args):
    """What is run, by name: arguments, and what is removed before each run."""
    work = args.work
    tabletop, sphere = f"{work}/tabletop", f"{work}/sphere"
    if not os.path.exists(f"{tabletop}/truth.ply"):
        subprocess.run([args.inputs, tabletop, "tabletop", str(args.views), "1920", "1080"], check=True)
    os.makedirs(sphere, exist_ok=True)
    tau = score_job.scene(sphere, args.points)
    maps = [f"{tabletop}/scene", "--depths", f"{tabletop}/depths", "--confidence", f"{tabletop}/confidence"]
    found = {
        f"fuse {mode}": (["fuse", *maps, "--mode", mode], f"{work}/{mode}.ply") for mode in ("hkust", "geo")
    }
    found["score"] = (["score", "--truth", f"{work}/hkust.ply", "--reconstruction", f"{work}/geo.ply",
                       "--tau", "0.01"], f"{work}/plain")
    found["score --protocol tnt"] = (
        ["score", "--protocol", "tnt", "--scene", f"{sphere}/Bench", "--reconstruction", f"{sphere}/rec.ply",
         "--trajectory", f"{sphere}/rec.log", "--tau", str(tau)], f"{work}/tnt")
    if args.mesh:
        scene = ["--mesh", args.mesh, "--cameras", args.cameras]
        found["render"] = (["render", *scene], f"{work}/rendered")
        found["generate"] = (["generate", *scene, "--photos", args.photos], f"{work}/generated")
    return found


def main():
    parser = argparse.ArgumentParser()
    for name in ("--binary", "--inputs", "--work", "--out"):
        parser.add_argument(name, required=True)
    for name in ("--before", "--mesh", "--cameras", "--photos"):
        parser.add_argument(name)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2, 4, 8, 16])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--points", type=int, default=4_000_000)
    args = parser.parse_args()
    builds = [("before", args.before)] if args.before else []
    builds.append(("now", args.binary))
    rows = []
    for name, (arguments, out) in commands(args).items():
        for threads in args.threads:
            for build, binary in builds:
                runs = []
                for _ in range(args.repeats):
                    shutil.rmtree(out, ignore_errors=True)
                    more = ["--threads", str(threads), "--out", out, "--force", "--quiet"]
                    runs.append(measured([binary, *arguments, *more]))
                timed = [run for run in runs if run]
                medians = [statistics.median(column) for column in zip(*timed)] or [float("nan")] * 3
                rows.append({"command": name, "threads": threads, "build": build,
                             "failed": len(runs) - len(timed),
                             **dict(zip(("wall_s", "user_s", "system_s"), (round(m, 2) for m in medians)))})
                print(rows[-1], flush=True)
    with open(args.out, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
