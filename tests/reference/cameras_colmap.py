"""Where COLMAP's camera models put points: the numbers of tests/it/lenses.rs.

pycolmap 4.2.1 (COLMAP 4.2). Run: python tests/reference/cameras_colmap.py > tests/reference/cameras_colmap.json
"""

import json

import numpy as np
import pycolmap

SIZE = (640, 480)
MODELS = {
    "SIMPLE_PINHOLE": [500, 321.5, 239],
    "PINHOLE": [500, 510, 321.5, 239],
    "SIMPLE_RADIAL": [500, 321.5, 239, -0.12],
    "RADIAL": [500, 321.5, 239, -0.2, 0.05],
    "OPENCV": [500, 510, 321.5, 239, -0.28, 0.07, 0.002, -0.003],
    "FULL_OPENCV": [500, 510, 321.5, 239, 0.4, 0.2, -0.001, 0.001, 0.1, 0.7, 0.1, 0.02],
    "OPENCV_FISHEYE": [400, 410, 321.5, 239, -0.02, 0.01, -0.005, 0.0005],
    "SIMPLE_FISHEYE": [400, 321.5, 239],
    "FISHEYE": [400, 410, 321.5, 239],
    "SIMPLE_RADIAL_FISHEYE": [400, 321.5, 239, 0.03],
    "RADIAL_FISHEYE": [400, 321.5, 239, 0.03, -0.01],
    "THIN_PRISM_FISHEYE": [400, 410, 321.5, 239, -0.03, 0.02, 0.002, -0.001, -0.004, 0.0003, 0.003, -0.002],
    "FOV": [400, 410, 321.5, 239, 0.9],
}
POINTS = [[0, 0, 1], [0.3, -0.2, 1], [-0.5, 0.4, 1], [0.62, 0.45, 1], [-0.001, 0.0004, 1], [1.2, -0.9, 3]]


def record(model, params):
    camera = pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=params)
    pixels = camera.img_from_cam(np.array(POINTS, float))
    return {"model": model, "params": params, "pixels": [list(map(float, p)) for p in pixels]}


print(
    json.dumps(
        {
            "pycolmap": pycolmap.__version__,
            "size": SIZE,
            "points": POINTS,
            "cameras": [record(*item) for item in MODELS.items()],
        },
        indent=1,
    )
)
