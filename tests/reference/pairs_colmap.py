"""Source views of a small COLMAP model by MVSNet's score, written out plainly with numpy.

    python pairs_colmap.py > pairs_colmap.json

The model is made here (numpy.random.default_rng(5)). It has what the usual converter fails on: image
ids with gaps, names that are no numbers, a lens, two images at one place (whose angle arccos makes NaN
of), an image that shares no point, a point observed twice in one image.
Versions: numpy 2.x; nothing else.
"""

import json

import numpy as np

rng = np.random.default_rng(5)
points = {int(i): rng.uniform(-1, 1, 3) for i in rng.choice(1000, 60, replace=False)}
names = ["left.jpg", "b/right.jpg", "top.jpg", "alone.jpg", "twin.jpg", "far.jpg", "c.jpg"]
ids = [7, 3, 42, 11, 100, 8, 65]
eyes = np.array([[0, 0, -8], [0.7, 0, -8], [0, 1.5, -8], [9, 9, -9], [0, 0, -8], [6, 0, -6], [0.3, 0.1, -7.5]])
lens = [1, 2, 1, 1, 2, 1, 1]
keys = sorted(points)
seen = []
for image in range(7):
    chosen = [] if image == 3 else [key for key in keys if rng.random() < 0.6]
    if image == 0:
        chosen = chosen + chosen[:2]
    seen.append(chosen)

cameras = "# cameras\n1 PINHOLE 640 480 500 510 320 240\n2 SIMPLE_RADIAL 640 480 500 320 240 -0.1\n"
lines = ["# images"]
for image in range(7):
    rotation = rng.normal(size=4)
    w, x, y, z = rotation / np.linalg.norm(rotation)
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    t = -matrix @ eyes[image]
    numbers = " ".join(repr(float(v)) for v in [w, x, y, z, *t])
    lines.append(f"{ids[image]} {numbers} {lens[image]} {names[image]}")
    lines.append(" ".join(f"1.5 2.5 {key}" for key in seen[image] + [-1]))
texts = {
    "cameras.txt": cameras,
    "images.txt": "\n".join(lines) + "\n",
    "points3D.txt": "".join(
        f"{key} {' '.join(repr(float(v)) for v in points[key])} 1 2 3 0.5\n" for key in keys
    ),
}

order = np.argsort(names)  # view ids are places in name order: the names are no numbers
number = {int(image): place for place, image in enumerate(order)}
expected = {}
for i in range(7):
    scores = []
    for j in range(7):
        if i == j:
            continue
        total = 0.0
        for key in set(seen[i]) & set(seen[j]):
            a, b = eyes[i] - points[key], eyes[j] - points[key]
            angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
            total += np.exp(-((angle - 5) ** 2) / (2 * (1.0 if angle <= 5 else 10.0) ** 2))
        if total > 0:
            scores.append([number[j], float(total)])
    expected[number[i]] = sorted(scores, key=lambda pair: (-pair[1], pair[0]))
print(json.dumps({"numpy": np.__version__, "files": texts, "sources": expected}, indent=1, sort_keys=True))
