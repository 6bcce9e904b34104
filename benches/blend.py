"""The blend of one 2048 x 1536 image: ours beside scipy's two transforms, one run, one thread each.

usage: python benches/blend.py [REPEATS] [CSV]

Needs numpy and scipy, and `cargo build --release --example blend` first. Both blend the same images
in memory, levels in, levels out, three channels. scipy: I_b = F⁻¹(F(I_r)·H + F(I)·L) by
scipy.fft with one worker, once with complex transforms of f64 (the formula as written) and once with
real-input transforms of f32 (the best of it); making the filter is not timed. `normalized` has no counterpart; it is set against the
same formula.
"""

import csv
import json
import os
import statistics
import subprocess
import sys
import time

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["RAYON_NUM_THREADS"] = "1"

import numpy as np
import scipy
import scipy.fft

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
sys.path.insert(0, os.path.join(ROOT, "tests", "reference"))
from blend_numpy import image

WIDTH, HEIGHT, D0 = 2048, 1536, 5000.0


def low_pass(width_bins, height_bins, dtype):
    return np.exp(-(width_bins[None, :] ** 2 + height_bins[:, None] ** 2) / (2 * D0)).astype(dtype)


def complex_f64(rendered, photograph, low):
    out = np.empty((HEIGHT, WIDTH, 3))
    for channel in range(3):
        first = scipy.fft.fft2(rendered[..., channel].astype(float), workers=1)
        second = scipy.fft.fft2(photograph[..., channel].astype(float), workers=1)
        out[..., channel] = scipy.fft.ifft2(first * (1 - low) + second * low, workers=1).real
    return out


def real_f32(rendered, photograph, low):
    out = np.empty((HEIGHT, WIDTH, 3), np.float32)
    for channel in range(3):
        first = scipy.fft.rfft2(rendered[..., channel].astype(np.float32), workers=1)
        second = scipy.fft.rfft2(photograph[..., channel].astype(np.float32), workers=1)
        spectrum = first * (1 - low) + second * low
        out[..., channel] = scipy.fft.irfft2(spectrum, s=(HEIGHT, WIDTH), workers=1)
    return out


def median_seconds(work, repeats):
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        np.clip(np.rint(result), 0, 255).astype(np.uint8)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds), result


def main():
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    planes = [np.repeat(image(WIDTH, HEIGHT, seed)[..., None], 3, axis=2) for seed in (1, 2)]
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    far = (2 * x - WIDTH) ** 2 * HEIGHT**2 + (2 * y - HEIGHT) ** 2 * WIDTH**2
    planes[0][far > WIDTH**2 * HEIGHT**2] = 0
    rows, peers = scipy.fft.fftfreq(HEIGHT) * HEIGHT, {}
    for name, formula, columns, dtype in (
            ("scipy complex f64", complex_f64, scipy.fft.fftfreq(WIDTH) * WIDTH, float),
            ("scipy real f32", real_f32, scipy.fft.rfftfreq(WIDTH) * WIDTH, np.float32)):
        low = low_pass(columns, rows, dtype)
        peers[name] = median_seconds(lambda: formula(*planes, low), repeats)
    binary = os.path.join(ROOT, "target", "release", "examples", "blend")
    lines = subprocess.run([binary, str(repeats)], check=True, capture_output=True, text=True).stdout
    ours = [json.loads(line) for line in lines.splitlines()]
    truth = peers["scipy complex f64"][1][..., 0].ravel()[::9973]
    off = np.abs(np.array(ours[0]["values"]) - truth).max()
    print(f"2048x1536, three channels, one thread, numpy {np.__version__}, scipy {scipy.__version__}")
    print(f"reference differs from scipy by at most {off:.1e} grey levels")
    rows = [(name, seconds) for name, (seconds, _) in peers.items()]
    rows += [("ours " + mode["mode"], mode["seconds"]) for mode in ours]
    formula, best = rows[0][1], rows[1][1]
    table = [("method", "milliseconds", "times_scipy_formula", "times_scipy_best")]
    table += [(name, f"{1e3 * s:.1f}", f"{formula / s:.2f}", f"{best / s:.2f}") for name, s in rows]
    for row in table:
        print("{:20} {:>14} {:>20} {:>18}".format(*row))
    if len(sys.argv) > 2:
        with open(sys.argv[2], "w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(table)


if __name__ == "__main__":
    main()
