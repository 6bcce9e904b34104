"""A finished data-set image of 2048 x 1536: `mvs-eval generate` beside a straightforward script.

usage: python benches/generate_image.py [--triangles 200000 1000000] [--views 4] [--repeats 3]
           [--content noise natural] [--csv FILE]
       python benches/generate_image.py --throughput [--triangles 200000 1000000 5000000] [--csv FILE]

Needs open3d, numpy and pillow, and `cargo build --release` first. Both read the same textured OBJ, the
same cameras and photographs and write per view: blended JPEG (quality 95, 4:2:0), masked JPEG, PFM
depth and cam. The script is what one writes in an afternoon: Open3D's RaycastingScene with one ray a
pixel, bilinear texture in numpy, the paper's blend by numpy.fft in f64, pillow. It chooses no source
views, and Open3D and numpy have one thread as we do. Ours runs as a whole (hashes, source views, lists, scene.json included) at 1, 4 and 16 colour
samples a pixel. CPU seconds of the child process, the median of the repeats; seconds per image are of
the whole job. Photographs and texture have two contents: `noise` is smooth colour with noise in every
pixel (3.6 bits a pixel as JPEG of quality 95), `natural` has amplitudes that fall off with 1/f^1.4 (2.8
bits a pixel, like photographs).
With --throughput ours alone runs, at the default 16 samples and with one and two threads. --work keeps
the made-up scenes in a folder for the next run.
"""

import argparse
import csv
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time

WIDTH, HEIGHT, FOCAL = 2048, 1536, 1900.0
ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
BINARY = os.environ.get("MVS_EVAL", os.path.join(ROOT, "target", "release", "mvs-eval"))


def noisy(random, width, height):
    """Smooth colours and noise in every pixel."""
    import numpy as np
    from PIL import Image

    coarse = random.integers(40, 216, (height // 32, width // 32, 3), np.uint8)
    large = np.asarray(Image.fromarray(coarse).resize((width, height), Image.BICUBIC)).astype(np.int16)
    noise = random.integers(-12, 13, (height, width, 1))
    return Image.fromarray(np.clip(large + noise, 0, 255).astype(np.uint8))


def natural(random, width, height):
    """Amplitudes that fall off with a power of the frequency, more in brightness than in colour."""
    import numpy as np
    from PIL import Image

    u, v = np.fft.rfftfreq(width) * width, np.fft.fftfreq(height) * height
    amplitude = np.maximum(np.hypot(u[None, :], v[:, None]), 1) ** -1.4

    def plane(deviation):
        phase = np.exp(2j * np.pi * random.random(amplitude.shape))
        values = np.fft.irfft2(amplitude * phase, s=(height, width))
        return values * (deviation / values.std())

    brightness = 118 + plane(45)
    channels = [np.clip(np.rint(brightness + plane(12)), 0, 255) for _ in range(3)]
    return Image.fromarray(np.stack(channels, -1).astype(np.uint8))


def terrain(folder, triangles, views, content):
    """A hilly square of `triangles` with a 4096² texture, cameras above it, photographs of noise."""
    import numpy as np

    side = int(round((triangles / 2) ** 0.5))
    t = np.linspace(-1, 1, side + 1)
    x, y = np.meshgrid(t, t)
    z = 0.08 * np.sin(5 * x + 1) * np.cos(4 * y) + 0.01 * np.sin(31 * x) * np.sin(37 * y)
    index = np.arange((side + 1) ** 2).reshape(side + 1, side + 1) + 1
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    with open(os.path.join(folder, "mesh.obj"), "w") as out:
        out.write("mtllib mesh.mtl\nusemtl ground\n")
        np.savetxt(out, np.stack([x, y, z], -1).reshape(-1, 3), fmt="v %.7f %.7f %.7f")
        np.savetxt(out, np.stack([x + 1, y + 1], -1).reshape(-1, 2) / 2, fmt="vt %.7f %.7f")
        np.savetxt(out, np.repeat(faces, 2, axis=1), fmt="f %d/%d %d/%d %d/%d")
    with open(os.path.join(folder, "mesh.mtl"), "w") as out:
        out.write("newmtl ground\nKd 1 1 1\nmap_Kd ground.jpg\n")
    random = np.random.default_rng(1)

    def picture(width, height):
        return {"noise": noisy, "natural": natural}[content](random, width, height)

    picture(4096, 4096).save(os.path.join(folder, "ground.jpg"), quality=95)
    os.makedirs(os.path.join(folder, "photos"))
    frames = []
    for view in range(views):
        angle = 0.15 * view
        eye = np.array([0.5 * np.sin(angle), -0.5 * np.cos(angle), 1.5])
        back = eye / np.linalg.norm(eye)
        right = np.cross([0.0, 1.0, 0.0], back)
        right /= np.linalg.norm(right)
        up = np.cross(back, right)
        matrix = np.eye(4)
        matrix[:3] = np.stack([right, up, back, eye], -1)
        name = f"photos/{view:08d}.jpg"
        frames.append({"file_path": name, "transform_matrix": matrix.tolist()})
        picture(WIDTH, HEIGHT).save(os.path.join(folder, name), quality=95)
    camera = {"w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2}
    with open(os.path.join(folder, "transforms.json"), "w") as out:
        json.dump({**camera, "frames": frames}, out)
    return len(faces)


def straightforward(folder, out):
    """The script that one writes in an afternoon."""
    import numpy as np
    import open3d as o3d
    from PIL import Image

    for name in ("blended_images", "cams", "rendered_depth_maps"):
        os.makedirs(os.path.join(out, name))
    model = o3d.io.read_triangle_mesh(os.path.join(folder, "mesh.obj"))
    texture = np.asarray(Image.open(os.path.join(folder, "ground.jpg"))).astype(np.float32)
    corners = np.asarray(model.triangle_uvs).reshape(-1, 3, 2)
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(model))
    camera = json.load(open(os.path.join(folder, "transforms.json")))
    intrinsic = np.array([[camera["fl_x"], 0, camera["cx"]], [0, camera["fl_y"], camera["cy"]], [0, 0, 1]])
    u, v = np.fft.fftfreq(WIDTH) * WIDTH, np.fft.fftfreq(HEIGHT) * HEIGHT
    low = np.exp(-(u[None, :] ** 2 + v[:, None] ** 2) / (2 * 5000.0))
    for index, frame in enumerate(camera["frames"]):
        extrinsic = np.linalg.inv(np.array(frame["transform_matrix"]) @ np.diag([1.0, -1, -1, 1]))
        rays = scene.create_rays_pinhole(intrinsic, extrinsic, WIDTH, HEIGHT)
        hits = scene.cast_rays(rays, nthreads=1)
        t, face = hits["t_hit"].numpy(), hits["primitive_ids"].numpy()
        mask = np.isfinite(t)
        depth = np.where(mask, t, 0).astype(np.float32)  # directions have z = 1 in the camera
        bary = hits["primitive_uvs"].numpy()[mask]
        uv = corners[face[mask]]
        at = uv[:, 0] * (1 - bary.sum(1))[:, None] + uv[:, 1] * bary[:, :1] + uv[:, 2] * bary[:, 1:]
        height, width = texture.shape[:2]
        x = np.clip(at[:, 0] * width - 0.5, 0, width - 1.001)
        y = np.clip((1 - at[:, 1]) * height - 0.5, 0, height - 1.001)
        column, row = x.astype(int), y.astype(int)
        fx, fy = (x - column)[:, None], (y - row)[:, None]
        color = (texture[row, column] * (1 - fx) + texture[row, column + 1] * fx) * (1 - fy)
        color += (texture[row + 1, column] * (1 - fx) + texture[row + 1, column + 1] * fx) * fy
        rendered = np.zeros((HEIGHT, WIDTH, 3))
        rendered[mask] = color
        photograph = np.asarray(Image.open(os.path.join(folder, frame["file_path"])))
        blended = np.empty_like(rendered)
        for channel in range(3):
            first, second = np.fft.fft2(rendered[..., channel]), np.fft.fft2(photograph[..., channel])
            blended[..., channel] = np.fft.ifft2(first * (1 - low) + second * low).real
        blended = np.clip(np.rint(blended), 0, 255).astype(np.uint8)
        stem = os.path.join(out, "blended_images", f"{index:08d}")
        Image.fromarray(blended).save(stem + ".jpg", quality=95, subsampling=2)
        Image.fromarray(blended * mask[..., None]).save(stem + "_masked.jpg", quality=95, subsampling=2)
        with open(os.path.join(out, "rendered_depth_maps", f"{index:08d}.pfm"), "wb") as pfm:
            pfm.write(b"Pf\n%d %d\n-1.000000\n" % (WIDTH, HEIGHT))
            pfm.write(np.ascontiguousarray(depth[::-1]).tobytes())
        near, far = np.percentile(depth[mask], [1, 99])
        with open(os.path.join(out, "cams", f"{index:08d}_cam.txt"), "w") as cam:
            cam.write("extrinsic\n" + "\n".join(" ".join(map(repr, map(float, r))) for r in extrinsic))
            cam.write("\n\nintrinsic\n" + "\n".join(" ".join(map(repr, map(float, r))) for r in intrinsic))
            cam.write(f"\n\n{near} {(far - near) / 128} 128.0 {far}\n")


def measured(command):
    """CPU and wall seconds of a child, and its peak memory in MiB."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def ours(folder, out, samples, threads):
    return [BINARY, "generate", "--mesh", os.path.join(folder, "mesh.obj"), "--cameras",
            os.path.join(folder, "transforms.json"), "--photos", os.path.join(folder, "photos"), "--out",
            out, "--name", "terrain", "--samples", str(samples), "--threads", str(threads)]


def scene(work, triangles, views, content):
    """The folder of a made-up scene, made if it is not there."""
    folder = os.path.join(work, f"terrain-{triangles}-{views}-{content}")
    if os.path.exists(os.path.join(folder, "transforms.json")):
        return folder
    os.makedirs(folder, exist_ok=True)
    # In a child: its memory and time are not the measured ones'.
    pid = os.fork()
    if pid == 0:
        terrain(folder, triangles, views, content)
        os._exit(0)
    assert os.waitpid(pid, 0)[1] == 0
    return folder


def medians(command, threads, repeats):
    """CPU and wall seconds of a command that writes into a folder."""
    os.environ["OMP_NUM_THREADS"] = str(threads)
    seconds = []
    for _ in range(repeats):
        out = tempfile.mkdtemp()
        seconds.append(measured(command(out)))
        shutil.rmtree(out)
    return sorted(seconds)[len(seconds) // 2]


def throughput(args):
    table = [("triangles", "threads", "images_per_s", "cpu_s_per_image")]
    for triangles in args.triangles:
        folder = scene(args.work, triangles, args.views, args.content[0])
        for threads in args.threads:
            cpu, wall = medians(lambda out: ours(folder, out, 16, threads), threads, args.repeats)
            table.append((triangles, threads, f"{args.views / wall:.3f}", f"{cpu / args.views:.3f}"))
            print("{:>9} triangles {:>2} threads {:>8} images/s {:>8} CPU s/image".format(*table[-1]), flush=True)
    return table


def comparison(args):
    table = [("triangles", "content", "method", "threads", "cpu_s_per_image", "wall_s_per_image",
              "times_script_cpu")]
    for triangles, content in [(t, c) for t in args.triangles for c in args.content]:
        folder = scene(args.work, triangles, args.views, content)
        runs = [("script", 1, lambda out: [sys.executable, os.path.abspath(__file__),
                                           "--straightforward", folder, out])]
        for samples in (1, 4, 16):
            for threads in args.threads:
                runs.append((f"mvs-eval {samples} samples", threads,
                             lambda out, s=samples, n=threads: ours(folder, out, s, n)))
        script = None
        for name, threads, command in runs:
            cpu, wall = medians(command, threads, args.repeats)
            script = script or cpu
            row = (triangles, content, name, threads, f"{cpu / args.views:.3f}", f"{wall / args.views:.3f}",
                   f"{script / cpu:.2f}")
            table.append(row)
            print("{:>9} {:8} {:22} {:>2} threads {:>8} CPU s/image {:>8} s/image {:>7} x".format(*row), flush=True)
    return table


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--throughput", action="store_true")
    parser.add_argument("--triangles", type=int, nargs="+")
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--threads", type=int, nargs="+")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--content", nargs="+", choices=["noise", "natural"], default=["noise", "natural"])
    parser.add_argument("--work")
    parser.add_argument("--csv")
    parser.add_argument("--straightforward", nargs=2)
    args = parser.parse_args()
    if args.straightforward:
        return straightforward(*args.straightforward)
    args.triangles = args.triangles or [200_000, 1_000_000] + [5_000_000] * args.throughput
    args.threads = args.threads or ([1, 2] if args.throughput else [1])
    with tempfile.TemporaryDirectory() as work:
        args.work = args.work or work
        table = throughput(args) if args.throughput else comparison(args)
    if args.csv:
        with open(args.csv, "w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(table)


if __name__ == "__main__":
    main()
