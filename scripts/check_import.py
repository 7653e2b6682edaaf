"""Called by scripts/check_import: writes captures with other programs and compares the scenes."""
import json
import os
import pathlib
import subprocess
import sys

import numpy as np
import pycolmap
from PIL import Image

work = pathlib.Path(sys.argv[1])
unbake = os.environ["UNBAKE"]
failed = 0


def judge(name, value, limit):
    global failed
    good = value <= limit
    failed += not good
    print(f"{'ok  ' if good else 'FAIL'} {name}: {value:.3g} (limit {limit:g})", flush=True)


def prepare(folder, out, *extra):
    command = [unbake, "prepare", str(folder), "-o", str(out), "--json", "-q", *extra]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")
    return json.loads(done.stdout), json.loads((out / "transforms.json").read_text())


# Every camera model with mild distortion, one image each, on random upright poses.
PARAMETERS = {
    "SIMPLE_PINHOLE": [60, 32, 16], "PINHOLE": [60, 61, 32, 16], "SIMPLE_RADIAL": [60, 32, 16, 0.1],
    "RADIAL": [60, 32, 16, 0.1, -0.02], "OPENCV": [60, 61, 32, 16, 0.1, -0.02, 0.001, 0.002],
    "OPENCV_FISHEYE": [30, 31, 32, 16, 0.01, -0.002, 0, 0],
    "FULL_OPENCV": [60, 61, 32, 16, 0.1, -0.02, 0.001, 0.002, 0.01, 0.02, 0, 0],
    "FOV": [60, 61, 32, 16, 0.5], "SIMPLE_RADIAL_FISHEYE": [30, 32, 16, 0.01],
    "RADIAL_FISHEYE": [30, 32, 16, 0.01, -0.002],
    "THIN_PRISM_FISHEYE": [30, 31, 32, 16, 0.01, 0.002, 0.001, -0.001, 0, 0, 0.001, 0.001],
    "RAD_TAN_THIN_PRISM_FISHEYE": [30, 31, 32, 16, .01, .002, 0, 0, 0, 0, .001, -.001, .001, 0, .001, 0],
    "SIMPLE_DIVISION": [60, 32, 16, -0.1], "DIVISION": [60, 61, 32, 16, -0.1],
    "SIMPLE_FISHEYE": [30, 32, 16], "FISHEYE": [30, 31, 32, 16], "EUCM": [60, 61, 32, 16, 0.5, 1.1],
    "EQUIRECTANGULAR": [64, 32],
}
NATIVE = {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "EQUIRECTANGULAR"}
rng = np.random.default_rng(7)
colmap = work / "colmap"
(colmap / "images").mkdir(parents=True, exist_ok=True)
model = pycolmap.Reconstruction()
truth = {}
for i, (name, parameters) in enumerate(PARAMETERS.items(), start=1):
    camera = pycolmap.Camera(model=name, width=64, height=32, params=parameters, camera_id=i)
    model.add_camera_with_trivial_rig(camera)
    turn = rng.uniform(-np.pi, np.pi)
    # y down, as COLMAP has it: a turn about the vertical, then a position
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    translation = rng.normal(size=3)
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), translation)
    image = pycolmap.Image(name=f"{name.lower()}.png", camera_id=i, image_id=i)
    model.add_image_with_trivial_frame(image, pose)
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = rotation.T, -rotation.T @ translation
    truth[name.lower()] = world @ np.diag([1, -1, -1, 1])
    # colours that tell the pixel: column in red, row in green
    x, y = np.meshgrid(np.arange(64), np.arange(32))
    rgb = np.stack([x * 4, y * 8, np.full_like(x, 128)], axis=-1).astype(np.uint8)
    Image.fromarray(rgb).save(colmap / "images" / f"{name.lower()}.png")
half_turn = np.diag([1, -1, -1, 1])
for form in ("binary", "text"):
    sparse = colmap / "sparse" / "0"
    sparse.mkdir(parents=True, exist_ok=True)
    for old in sparse.iterdir():
        old.unlink()
    (model.write_binary if form == "binary" else model.write_text)(str(sparse))
    made, scene = prepare(colmap, work / f"from_{form}")
    frames = {pathlib.Path(f["file_path"]).stem: f for f in scene["frames"]}
    assert made["frames"] == len(PARAMETERS) == len(frames), made
    worst = max(np.abs(np.array(frames[k]["transform_matrix"]) - half_turn @ truth[k]).max() for k in truth)
    judge(f"COLMAP {form}: {len(frames)} poses, largest difference", worst, 1e-6)

# Resampled lenses: the colour of a pixel says where pycolmap's camera would have to project it.
folder = work / "from_binary"
for name in PARAMETERS:
    if name in NATIVE:
        continue
    frame = frames[name.lower()]
    image = np.asarray(Image.open(folder / frame["file_path"])).astype(float)
    mask = np.ones(image.shape[:2], bool)
    if "mask_path" in frame:
        mask = np.asarray(Image.open(folder / frame["mask_path"])) > 0
    h, w = mask.shape
    j, i = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    if frame["camera_model"] == "EQUIRECTANGULAR":
        lon, lat = 2 * np.pi * (j / w - 0.5), np.pi * (0.5 - i / h)
        rays = np.stack([np.sin(lon) * np.cos(lat), -np.sin(lat), np.cos(lon) * np.cos(lat)], -1)
    else:
        rays = np.stack([(j - frame["cx"]) / frame["fl_x"], (i - frame["cy"]) / frame["fl_y"], np.ones_like(i)], -1)
    camera = next(c for c in model.cameras.values() if c.model.name == name)
    off, seen = [], 0
    for ray, colour in zip(rays[mask], image[mask]):
        point = camera.img_from_cam(ray)
        if point is None or not (1 < point[0] < 63 and 1 < point[1] < 31):
            continue
        seen += 1
        off.append(max(abs(colour[0] / 4 + 0.5 - point[0]), abs(colour[1] / 8 + 0.5 - point[1])))
    # bilinear in linear light, stored as sRGB: half a pixel at the dark end, where the curve is steep
    judge(f"{name}: {seen} pixels, median distance from where pycolmap projects", float(np.median(off)), 0.25)

room = pathlib.Path(os.environ["SHARED"]) / "captures/roomplan/Room.usdz"
try:
    from pxr import Usd, UsdGeom
except ImportError:
    print("skipped: usd-core is not here")
    sys.exit(failed > 0)
if not room.exists():
    print(f"skipped: {room} is not here")
    sys.exit(failed > 0)
stage = Usd.Stage.Open(str(room))
corners, cache = [], UsdGeom.XformCache()
for prim in stage.Traverse():
    matrix = np.array(cache.GetLocalToWorldTransform(prim))
    if prim.IsA(UsdGeom.Cube):
        s = UsdGeom.Cube(prim).GetSizeAttr().Get() / 2
        points = np.array([[x, y, z] for x in (-s, s) for y in (-s, s) for z in (-s, s)])
    elif prim.IsA(UsdGeom.Mesh):
        points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get())
    else:
        continue
    corners.append(np.c_[points, np.ones(len(points))] @ matrix)
corners = np.concatenate(corners)[:, :3] * UsdGeom.GetStageMetersPerUnit(stage)
flat = work / "room.usdc"
stage.Flatten().Export(str(flat))
distance = lambda a, b: max(np.abs(b - p).sum(axis=1).min() for p in a)
for form, source in (("usdz", room), ("binary", flat)):
    prepare(source, work / f"from_{form}")
    raw = (work / f"from_{form}" / "mesh.ply").read_bytes()
    header, body = raw.split(b"end_header\n", 1)
    count = int(next(l for l in header.decode().splitlines() if l.startswith("element vertex")).split()[-1])
    ours = np.frombuffer(body, "<f8", count * 3).reshape(-1, 3)
    judge(f"RoomPlan {form}: {len(ours)} vertices against usd-core's {len(corners)}, farthest", distance(ours, corners), 1e-5)
    judge(f"RoomPlan {form}: the other way round", distance(corners, ours), 1e-5)
sys.exit(failed > 0)
