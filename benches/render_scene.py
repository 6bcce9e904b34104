"""Renders a real scene and measures it against its photographs and an independent render.

usage: python benches/render_scene.py --binary target/release/mvs-eval --scene DIR --out DIR [--spot OBJ]

Needs numpy, opencv-python and pillow. Per view: mean absolute difference between photograph and render
on covered pixels (grey levels), and the median sub-pixel shift of blocks of 64 pixels that are covered
altogether, by phase correlation under a Hann window. The view in `reference/` (ray cast by another
program) is compared by quantiles of the depth difference, all views with Open3D's RaycastingScene. Writes
views.csv, reference.csv, open3d.csv, summary.csv and a picture of photograph, render and four times
their difference. `--spot OBJ` also shows that mesh with the texture beside it. Needs open3d.
"""

import argparse
import csv
import itertools
import json
import pathlib
import shutil
import subprocess
import tempfile

import cv2
import numpy as np
from PIL import Image

BLOCK = 64
LEAST_RESPONSE = 0.1
QUANTILES = [0.5, 0.9, 0.99, 0.999, 1.0]


def read_pfm(path):
    with open(path, "rb") as file:
        assert file.readline().strip() == b"Pf"
        width, height = map(int, file.readline().split())
        scale = float(file.readline())
        values = np.frombuffer(file.read(), "<f4" if scale < 0 else ">f4")
    return values.reshape(height, width)[::-1]


def render(binary, mesh, cameras, out, *more):
    command = [binary, "render", "--mesh", str(mesh), "--cameras", str(cameras), "--out", str(out)]
    answer = subprocess.run([*command, "--format", "json", "-q", *more], check=True, capture_output=True)
    return {view["id"]: view for view in json.loads(answer.stdout)["views"]}


def shifts(photo, color, mask):
    """Sub-pixel (dx, dy) of every covered block that correlates."""
    gray = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) for image in (color, photo)]
    window = cv2.createHanningWindow((BLOCK, BLOCK), cv2.CV_32F)
    found = []
    for top in range(0, mask.shape[0] - BLOCK + 1, BLOCK // 2):
        for left in range(0, mask.shape[1] - BLOCK + 1, BLOCK // 2):
            block = np.s_[top : top + BLOCK, left : left + BLOCK]
            if mask[block].all():
                a, b = (image[block] - image[block].mean() for image in gray)
                shift, response = cv2.phaseCorrelate(a, b, window)
                if response > LEAST_RESPONSE:
                    found.append(shift)
    return np.array(found)


def compare_views(views, out, scene):
    rows, pictures = [], {}
    for number, view in sorted(views.items()):
        name = f"{number:08}"
        photo = np.asarray(Image.open(next((scene / "images").glob(f"{name}.*"))).convert("RGB"))
        color = np.asarray(Image.open(out / "color" / f"{name}.png").convert("RGB"))
        mask = read_pfm(out / "depth" / f"{name}.pfm") > 0
        difference = np.abs(photo.astype(int) - color).mean(axis=2)
        found = shifts(photo, color, mask)
        dx, dy = np.median(found, axis=0)
        rows.append(
            {
                "view": number,
                "coverage": mask.mean(),
                "mean_difference": difference[mask].mean(),
                "blocks": len(found),
                "shift_x": dx,
                "shift_y": dy,
                "mixed": view["mixed"],
                "back_faces": view["back_faces"],
            }
        )
        pictures[number] = (photo, color, mask)
    return rows, pictures


def compare_reference(binary, mesh, scene, folder):
    """The reference's views, with backs of triangles left out and with both sides seen."""
    rows = []
    paths = sorted((scene / "reference" / "depth").glob("*.pfm"))
    (folder / "cams").mkdir()
    for path in paths:
        shutil.copy(scene / "cams" / f"{path.stem}_cam.txt", folder / "cams")
    for path, backs in itertools.product(paths, ("invalid", "valid")):
        out = folder / backs
        if not out.exists():
            more = ("--pixel-center", "integer", "--back-faces", backs, "--samples", "1")
            render(binary, mesh, folder / "cams", out, *more)
        truth, found = read_pfm(path), read_pfm(out / "depth" / path.name)
        both = (truth > 0) & (found > 0)
        relative = np.abs(found[both] / truth[both] - 1)
        row = {"view": int(path.stem), "back_faces": backs, "reference_pixels": int((truth > 0).sum()), "pixels": int((found > 0).sum())}
        row["only_reference"] = int(((truth > 0) & (found == 0)).sum())
        row["only_ours"] = int(((truth == 0) & (found > 0)).sum())
        row |= {f"q{q}": float(np.quantile(relative, q)) for q in QUANTILES}
        rows.append(row)
    return rows


def compare_open3d(binary, mesh, scene, folder):
    """Every view against Open3D's RaycastingScene: masks, and quantiles of the depth difference; its rays, vertices
    and distances are f32, so the depth of the triangle it names is also worked out here in f64 from the files'
    numbers ("exact"), on the ray of the unrounded camera. Where that is not ours, the nearest of all triangles
    decides ("all")."""
    import open3d as o3d

    both_sides = ("--pixel-center", "integer", "--back-faces", "valid", "--samples", "1")
    render(binary, mesh, scene / "cams", folder / "all", *both_sides)
    vertices, triangles = read_obj(mesh)
    caster = o3d.t.geometry.RaycastingScene(nthreads=1)
    caster.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(triangles))
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rows = []
    for path in sorted((folder / "all" / "depth").glob("*.pfm")):
        found = read_pfm(path)
        words = (scene / "cams" / f"{path.stem}_cam.txt").read_text().split()
        pose, k = np.array(words[1:17], float).reshape(4, 4), np.array(words[18:27], float).reshape(3, 3)
        row, column = np.mgrid[: found.shape[0], : found.shape[1]]
        pixels = np.stack([column.ravel(), row.ravel(), np.ones(found.size)])
        directions = (pose[:3, :3].T @ np.linalg.inv(k) @ pixels).T
        origin = np.broadcast_to(-pose[:3, :3].T @ pose[:3, 3], directions.shape)
        rays = np.concatenate([origin, directions], 1).astype(np.float32)
        hits = caster.cast_rays(o3d.core.Tensor(rays), nthreads=1)
        truth = hits["t_hit"].numpy().reshape(found.shape)
        truth[~np.isfinite(truth)] = 0
        both = (truth > 0) & (found > 0)
        relative = np.abs(found[both].astype(float) / truth[both] - 1)
        hit = hits["primitive_ids"].numpy()[both.ravel()]
        height = np.einsum("ij,ij->i", normals[hit], corners[hit, 0] - origin[0])
        exact = height / np.einsum("ij,ij->i", normals[hit], directions[both.ravel()])
        from_exact = np.abs(found[both] / exact - 1)
        counts = {"pixels": int(both.sum()), "only_open3d": int(((truth > 0) & (found == 0)).sum()),
                  "only_ours": int(((truth == 0) & (found > 0)).sum())}
        above = {"above_1e-6": int((relative > 1e-6).sum()), "above_1e-3": int((relative > 1e-3).sum())}
        far = np.flatnonzero(from_exact > 1e-6)
        nearest = [nearest_of_all(corners, origin[0], directions[both.ravel()][at]) for at in far]
        above |= {"above_1e-6_exact": len(far)}
        above |= {"above_1e-6_all": int((np.abs(found[both][far] / np.array(nearest) - 1) > 1e-6).sum())}
        rows.append({"view": int(path.stem), **counts, **above}
                    | {f"q{q}": float(np.quantile(relative, q)) for q in QUANTILES}
                    | {f"q{q}_exact": float(np.quantile(from_exact, q)) for q in (0.5, 0.999999, 1.0)})
    return rows


def nearest_of_all(corners, origin, direction):
    """The nearest crossing of a ray with any triangle, in f64, by signed volumes."""
    a, b, c = (corners[:, i] - origin for i in range(3))
    u, v, w = (np.cross(p, q) @ direction for p, q in ((b, c), (c, a), (a, b)))
    inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
    inside &= u + v + w != 0
    weights = np.stack([u, v, w], 1)[inside]
    points = np.einsum("ij,ijk->ik", weights, np.stack([a, b, c], 1)[inside]) / weights.sum(1)[:, None]
    along = points @ direction / (direction @ direction)
    return along[along > 0].min()


def read_obj(path):
    """Vertices and triangles of an OBJ whose faces are triangles."""
    vertices, triangles = [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(word) for word in words[1:4]])
        elif words[:1] == ["f"]:
            triangles.append([int(word.split("/")[0]) - 1 for word in words[1:4]])
    return np.array(vertices), np.array(triangles, np.uint32)


def write(path, rows):
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)


def picture(path, shown):
    """Photograph, render, four times the difference, cut to what is covered and halved."""
    bands = []
    for photo, color, mask in shown:
        rows, columns = np.where(mask)
        cut = np.s_[rows.min() : rows.max(), columns.min() : columns.max()]
        difference = np.clip(4 * np.abs(photo.astype(int) - color), 0, 255) * mask[..., None]
        parts = [Image.fromarray(part[cut].astype(np.uint8)) for part in (photo, color, difference)]
        height = 300
        parts = [part.resize((round(part.width * height / part.height), height), Image.LANCZOS) for part in parts]
        bands.append(np.concatenate([np.asarray(part) for part in parts], axis=1))
    width = max(band.shape[1] for band in bands)
    bands = [np.pad(band, ((0, 0), (0, width - band.shape[1]), (0, 0))) for band in bands]
    Image.fromarray(np.concatenate(bands)).save(path, quality=88)


def spot_picture(binary, mesh, path):
    """The textured cow by three cameras, through a pinhole and through a wide lens."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        mesh = with_material(mesh, folder)
        panels = []
        for model in ("PINHOLE 480 360 520 520 240 180", "OPENCV_FISHEYE 480 360 210 210 240 180 0 0 0 0"):
            write_colmap(folder / "cameras", model, [20, 140, 250], 2.6 if "PIN" in model else 1.45)
            out = folder / model.split()[0]
            render(binary, mesh, folder / "cameras", out, "--back-faces", "valid")
            images = [np.asarray(Image.open(p)) for p in sorted((out / "color").glob("*.png"))]
            panels.append(np.concatenate(images, axis=1))
        Image.fromarray(np.concatenate(panels)).resize((960, 480), Image.LANCZOS).save(path, quality=88)


def with_material(mesh, folder):
    """A copy of an OBJ that names no material, with the texture that lies beside it."""
    texture = next(mesh.parent.glob("*_texture.png"))
    shutil.copy(texture, folder / texture.name)
    (folder / "textured.mtl").write_text(f"newmtl textured\nmap_Kd {texture.name}\n")
    copy = folder / "textured.obj"
    copy.write_text("mtllib textured.mtl\nusemtl textured\n" + mesh.read_text())
    return copy


def write_colmap(folder, model, angles, distance):
    folder.mkdir(exist_ok=True)
    (folder / "cameras.txt").write_text(f"1 {model}\n")
    lines = []
    for number, degrees in enumerate(angles):
        angle = np.radians(degrees)
        eye = distance * np.array([np.sin(angle), 0.25, -np.cos(angle)])
        forward = -eye / np.linalg.norm(eye)
        right = np.cross(forward, [0, 1, 0])
        right /= np.linalg.norm(right)
        rotation = np.array([right, np.cross(forward, right), forward])
        w = np.sqrt(max(0, 1 + np.trace(rotation))) / 2
        if w > 0.1:
            x, y, z = (
                (rotation[2, 1] - rotation[1, 2]) / (4 * w),
                (rotation[0, 2] - rotation[2, 0]) / (4 * w),
                (rotation[1, 0] - rotation[0, 1]) / (4 * w),
            )
        else:
            values, vectors = np.linalg.eig(rotation)
            axis = np.real(vectors[:, np.argmin(abs(values - 1))])
            w, (x, y, z) = 0.0, axis / np.linalg.norm(axis)
        t = -rotation @ eye
        lines.append(f"{number + 1} {w} {x} {y} {z} {t[0]} {t[1]} {t[2]} 1 {number}.png\n\n")
    (folder / "images.txt").write_text("".join(lines))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--binary", required=True)
    parser.add_argument("--scene", type=pathlib.Path, required=True)
    parser.add_argument("--spot", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "rendered"
        mesh = options.scene / "model" / "model.obj"
        views = render(options.binary, mesh, options.scene / "cams", out, "--pixel-center", "integer")
        rows, pictures = compare_views(views, out, options.scene)
        write(options.out / "views.csv", rows)
        reference = compare_reference(options.binary, mesh, options.scene, pathlib.Path(folder))
        write(options.out / "reference.csv", reference)
        open3d = compare_open3d(options.binary, mesh, options.scene, pathlib.Path(folder))
        write(options.out / "open3d.csv", open3d)
        picture(options.out / "saharov.jpg", [pictures[number] for number in (0, 9)])
    column = lambda name: np.array([row[name] for row in rows])
    worst = np.maximum(abs(column("shift_x")), abs(column("shift_y")))
    summary = {
        "views": len(rows),
        "mean_difference": column("mean_difference").mean(),
        "largest_difference": column("mean_difference").max(),
        "median_shift_x": np.median(column("shift_x")),
        "median_shift_y": np.median(column("shift_y")),
        "worst_view_shift": worst.max(),
    }
    write(options.out / "summary.csv", [summary])
    print(json.dumps({name: float(value) for name, value in summary.items()}, indent=1))
    if options.spot:
        spot_picture(options.binary, options.spot, options.out / "spot.jpg")


if __name__ == "__main__":
    main()
