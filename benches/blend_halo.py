"""A constant lighting offset on a bright background: what each blend mode makes of it, as a picture.

usage: python benches/blend_halo.py FOLDER

Needs numpy and pillow, and `cargo build --release` first. The photograph is the rendering plus 15
grey levels, before a background of 230; a sound blend gives the photograph back. Writes halo.png
(rows: photograph, then per mode the blended image and 4 × its difference from the photograph, grey =
none) and halo.csv (difference inside the mask by distance from its edge, through 8-bit JPEG files).
The unrounded figures are in src/blend/tests.rs.
"""

import csv
import os
import subprocess
import sys
import tempfile

import numpy as np
from PIL import Image

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
BINARY = os.path.join(ROOT, "target", "release", "mvs-eval")
WIDTH, HEIGHT, OFFSET, BACKGROUND = 1024, 768, 15, 230


def main():
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    # A disc, and a strip that leaves the image on the right: its wrap-around lands on the left.
    disc = (x - 420) ** 2 + (y - 380) ** 2 < 230**2
    strip = (y > 560) & (y < 700) & (x > 380) | (x < 60) & (y > 100) & (y < 500)
    mask = disc | strip
    surface = 110 + 40 * np.sin(x / 21) * np.cos(y / 17) + 8 * ((x // 8 + y // 8) % 2)
    rendered = np.where(mask, surface, 0).astype(np.uint8)
    photograph = np.where(mask, rendered.astype(int) + OFFSET, BACKGROUND).astype(np.uint8)
    work = tempfile.mkdtemp()
    for name, plane in (("rendered", rendered), ("photos", photograph)):
        os.makedirs(os.path.join(work, name))
        Image.fromarray(plane).convert("RGB").save(os.path.join(work, name, "00000000.png"))
    # How far inside the mask a pixel lies, by peeling.
    inside, depth, rest = np.zeros(mask.shape, int), 0, mask.copy()
    while rest.any() and depth < 40:
        inside[rest] += 1
        padded = np.pad(rest, 1, mode="edge")
        rest = rest & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
        depth += 1
    bands = [("1 to 4 px from the mask's edge", mask & (inside <= 4)),
             ("5 to 10 px", mask & (inside > 4) & (inside <= 10)),
             ("30 px and more", mask & (inside > 30)),
             ("4 px at the image's left border", mask & (x < 4) & (inside > 30))]
    rows = [("mode", "where", "mean_difference", "largest_difference")]
    window = np.s_[60:740:2, 0:WIDTH:2]
    pictures = [np.hstack([photograph[window], np.full_like(photograph[window], 255)])]
    for mode in ("reference", "composite", "normalized"):
        out = os.path.join(work, mode)
        subprocess.run([BINARY, "blend", "--rendered", os.path.join(work, "rendered"), "--photos",
                        os.path.join(work, "photos"), "--out", out, "--mode", mode], check=True,
                       stdout=subprocess.DEVNULL)
        blended = np.asarray(Image.open(os.path.join(out, "00000000.jpg")).convert("L")).astype(int)
        off = np.where(mask, blended - photograph.astype(int), 0)
        for name, band in bands:
            rows.append((mode, name, f"{off[band].mean():.2f}", int(np.abs(off[band]).max())))
        shown = np.clip(128 + 4 * off, 0, 255).astype(np.uint8)
        pictures.append(np.hstack([blended.astype(np.uint8)[window], shown[window]]))
    Image.fromarray(np.vstack(pictures)).save(os.path.join(sys.argv[1], "halo.png"), optimize=True)
    with open(os.path.join(sys.argv[1], "halo.csv"), "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
    for row in rows:
        print("{:12} {:34} {:>16} {:>20}".format(*row))


if __name__ == "__main__":
    main()
