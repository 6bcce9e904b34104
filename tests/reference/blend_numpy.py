"""Golden values of the paper's blend by numpy's two-transform formula.

usage: python tests/reference/blend_numpy.py > tests/reference/blend_numpy.json

I_b = F⁻¹(F(I_r) · H) + F⁻¹(F(I) · L) with L = exp(−(u² + v²) / (2 · D0)), H = 1 − L, u and v integer
bins of the full frame (Yao et al. 2020, section 3.3), per channel, in f64, neither rounded nor
clipped. Images are made from a formula on integers; src/blend/tests.rs makes the same ones.
"""

import json
import sys

import numpy as np

SIZES = [(7, 5), (64, 48), (97, 61), (255, 129), (640, 479), (1031, 523)]
D0S = [50.0, 5000.0]
CHANNEL = 1


def image(width, height, seed):
    """Levels 0 to 255: smooth waves of a triangle shape with noise, H × W."""
    y, x = np.mgrid[0:height, 0:width].astype(np.uint64)
    noise = (((y * width + x) * 2654435761 + seed * 40503) % 2**32) >> np.uint64(13)
    wave = ((3 + seed) * x + 5 * y) % 256
    wave = np.where(wave < 128, wave, 255 - wave)
    return (wave + noise % 128).astype(np.uint8)


def blended(rendered, photograph, d0):
    height, width = rendered.shape
    u, v = np.fft.fftfreq(width) * width, np.fft.fftfreq(height) * height
    low = np.exp(-(u[None, :] ** 2 + v[:, None] ** 2) / (2 * d0))
    spectrum = np.fft.fft2(rendered) * (1 - low) + np.fft.fft2(photograph) * low
    return np.fft.ifft2(spectrum).real


def main():
    cases = []
    for width, height in SIZES:
        rendered, photograph = (image(width, height, seed).astype(float) for seed in (1, 2))
        disc = np.mgrid[0:height, 0:width]
        inside = (2 * disc[1] - width) ** 2 * height**2 + (2 * disc[0] - height) ** 2 * width**2
        rendered[inside > width**2 * height**2] = 0.0
        for d0 in D0S:
            result = blended(rendered, photograph, d0)
            step = max(1, width * height // 40)
            picked = np.arange(0, width * height, step)
            cases.append({
                "width": width, "height": height, "d0": d0, "step": step,
                "sum": float(result.sum()),
                "values": [round(float(value), 7) for value in result.ravel()[picked]],
            })
    json.dump({"numpy": np.__version__, "python": sys.version.split()[0], "cases": cases}, sys.stdout, indent=0)
    print()


if __name__ == "__main__":
    main()
