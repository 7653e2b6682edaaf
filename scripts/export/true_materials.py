"""Lays a scene's ground-truth images onto the atlas of its reconstruction: true_materials.py UNBAKE SCENE OUT TRUTH

TRUTH becomes a copy of OUT with the true albedo and roughness wherever an image of gt/ looks at a labelled surface (elsewhere the
images of gt/ hold zeros, and `unbake eval` leaves those pixels out too). Texture coordinates per pixel come from
`unbake render --show albedo` of a copy whose albedo is (u, v, 1). For evaluation only.
"""
import json, shutil, subprocess, sys, tempfile
from pathlib import Path
import numpy as np
import mitsuba as mi

mi.set_variant("scalar_rgb")
unbake, scene, out, truth = sys.argv[1], *map(Path, sys.argv[2:5])


def read(path, channels=3):
    kind = mi.Bitmap.PixelFormat.RGB if channels == 3 else mi.Bitmap.PixelFormat.Y
    return np.array(mi.Bitmap(str(path)).convert(kind, mi.Struct.Type.Float32, srgb_gamma=False)).reshape(-1, channels)


def shape(path):
    size = mi.Bitmap(str(path)).size()
    return int(size[0]), int(size[1])


def copy(target, replaced):
    target.mkdir(parents=True, exist_ok=True)
    for f in out.iterdir():
        if f.suffix in (".exr", ".png", ".glb") and f.name not in replaced:
            shutil.copy(f, target / f.name)


with tempfile.TemporaryDirectory(dir=truth.parent) as work:
    work = Path(work)
    w, h = shape(out / "albedo.exr")
    v, u = np.meshgrid((np.arange(h) + 0.5) / h, (np.arange(w) + 0.5) / w, indexing="ij")
    copy(work / "uv", ["albedo.exr"])
    mi.Bitmap(np.stack([u, v, np.ones_like(u)], 2).astype(np.float32)).write(str(work / "uv/albedo.exr"))
    subprocess.run([unbake, "render", work / "uv", "--scene", scene, "--views", "all", "--show", "albedo", "--exposure", "0",
                    "--to", work / "frames", "--quiet"], check=True, stdout=subprocess.DEVNULL)
    copy(truth, ["albedo.exr", "roughness.exr"])
    for name, channels in [("albedo", 3), ("roughness", 1)]:
        w, h = shape(out / f"{name}.exr")
        sums, counts = np.zeros((h * w, channels)), np.zeros(h * w)
        for frame in json.loads((scene / "transforms.json").read_text())["frames"]:
            stem = Path(frame["file_path"]).stem
            image = scene / "gt" / name / f"{stem}.exr"
            if not image.exists():
                continue
            uv, values = read(work / f"frames/{stem}.exr"), read(image, channels)
            if len(uv) != len(values):
                sys.exit(f"{image}: another size than the view")
            at = np.floor(uv[:, :2] * [w, h]).astype(int)
            label = frame.get("label_path")
            labelled = np.array(mi.Bitmap(str(scene / label))).reshape(len(uv), -1).any(1) if label else True
            seen = labelled & (uv[:, 2] > 0.5) & (at >= 0).all(1) & (at < [w, h]).all(1)
            cell = at[seen, 1] * w + at[seen, 0]
            np.add.at(sums, cell, values[seen])
            np.add.at(counts, cell, 1)
        # holes between the pixels that hit: means over ever larger blocks of texels
        mean, level = np.zeros((h, w, channels)), 0
        total, number = sums.reshape(h, w, channels), counts.reshape(h, w)
        own = read(out / f"{name}.exr", channels).reshape(h, w, channels)
        done = np.zeros((h, w), bool)
        while level < 4:
            block = 1 << level
            t = total.reshape(h // block, block, w // block, block, channels).sum((1, 3))
            n = number.reshape(h // block, block, w // block, block).sum((1, 3))
            fill = np.kron(t / np.maximum(n, 1)[..., None], np.ones((block, block, 1)))
            new = ~done & (np.kron(n, np.ones((block, block))) > 0)
            mean[new] = fill[new]
            done |= new
            level += 1
        print(f"{name}: {100 * done.mean():.0f} % of the atlas from gt/", file=sys.stderr)
        mean[~done] = own[~done]
        mi.Bitmap(mean.astype(np.float32) if channels == 3 else mean[..., 0].astype(np.float32)).write(str(truth / f"{name}.exr"))
