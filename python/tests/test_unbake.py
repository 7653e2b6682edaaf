"""The module against the files it reads and writes, and against the program's own."""

import ast
import gc
import json
import os
import shutil
import signal
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import unbake
from conftest import SMALL


def test_help_says_what_the_stub_says():
    stub = ast.parse((Path(unbake.__file__).parent / "unbake_native.pyi").read_text())
    words = lambda text: (text or "").split()
    members = 0
    for node in stub.body:
        if not isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            continue
        assert words(getattr(unbake, node.name).__doc__) == words(ast.get_docstring(node)) != [], node.name
        for member in getattr(node, "body", []) if isinstance(node, ast.ClassDef) else []:
            said = ast.get_docstring(member) if isinstance(member, ast.FunctionDef) else None
            if said and member.name != "__new__":
                assert words(getattr(getattr(unbake, node.name), member.name).__doc__) == words(said), member.name
                members += 1
    assert members > 30


def test_textures_have_shapes_and_types(solved):
    result, _, _ = solved
    for name, shape, dtype in [
        ("albedo", (128, 128, 3), np.float32),
        ("roughness", (128, 128), np.float32),
        ("irradiance", (128, 128, 3), np.float32),
        ("radiance", (128, 128, 3), np.float32),
        ("emission", (128, 128, 3), np.float32),
        ("confidence", (128, 128, 2), np.float32),
        ("labels", (128, 128), np.uint16),
        ("rooms", (128, 128), np.uint16),
    ]:
        texture = getattr(result, name)
        assert (texture.shape, texture.dtype) == (shape, dtype), name
        assert not texture.flags.writeable and np.isfinite(texture).all(), name
    assert 0.05 < result.albedo.mean() < 0.95 and result.irradiance.max() > 0
    assert result.environment.shape[2] == 3 and result.irradiance_error.shape == (128, 128)
    assert result.metallic is None, "nothing here is metal"
    assert result.transmission is None, "nothing here is glass"


def test_geometry_is_that_of_the_scene(solved, scene):
    result, read = solved[0], unbake.Scene(scene)
    assert result.triangles.dtype == np.uint32 and result.triangles.shape[1] == 3
    assert result.triangles.max() < len(result.positions) == len(result.normals) == len(result.uvs)
    assert result.origin == read.origin
    # solving may turn triangles and part vertices; where the triangles are stays
    centres = [m.positions[m.triangles].mean(axis=1) for m in (result, read)]
    np.testing.assert_allclose(*centres, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(read.normals, axis=1), 1, atol=1e-4)


def test_textures_are_views_and_not_copies(solved):
    result = solved[0]
    assert result.albedo.ctypes.data == result.albedo.ctypes.data
    with pytest.raises(ValueError):
        result.albedo[0, 0] = 1


def test_arrays_outlive_the_result(solved):
    result = unbake.Solution(solved[0].path)
    albedo, expected = result.albedo, result.albedo.copy()
    del result
    gc.collect()
    _ = [np.ones((128, 128, 3), np.float32) for _ in range(50)]
    np.testing.assert_array_equal(albedo, expected)


def test_values_are_those_of_the_files(solved):
    result = solved[0]
    for name, channels in [("albedo", "RGB"), ("irradiance", "RGB"), ("roughness", "Y")]:
        with OpenEXR.File(os.path.join(result.path, f"{name}.exr")) as stored:
            np.testing.assert_array_equal(getattr(result, name), stored.channels()[channels].pixels.astype(np.float32))
    again = unbake.Solution(result.path)
    np.testing.assert_array_equal(result.irradiance, again.irradiance)
    lights = json.load(open(os.path.join(result.path, "lights.json")))["lights"]
    said = result.lamps + result.portals
    assert len(result.lamps) > 0 and [set(x) for x in said] == [set(x) for x in lights]
    for ours, stored in zip(said, lights):
        assert [ours[k] for k in ("id", "kind", "triangles", "clipped")] == [stored[k] for k in ("id", "kind", "triangles", "clipped")]
        for key in ("centre", "size", "area", "power", "radiance", "standard_error"):
            np.testing.assert_allclose(ours[key], stored[key], rtol=1e-6)


def test_the_program_gives_the_same_bits(solved, scene, tmp_path):
    flags = [f"--{k.replace('_', '-')}={v}" for k, v in SMALL.items()]
    command = [os.environ["UNBAKE"], "solve", scene, "-o", tmp_path / "out", "--seed", "3", "--quiet", *flags]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    for name in ["albedo.exr", "roughness.exr", "irradiance.exr", "scene.glb"]:
        assert (tmp_path / "out" / name).read_bytes() == open(os.path.join(solved[0].path, name), "rb").read(), name


def test_progress_and_notes_are_heard(solved):
    _, steps, notes = solved
    stages = [name for name, done, _ in steps if done == 0]
    assert "reading the scene" in stages and "report" in stages and len(stages) > 8
    assert all(done <= total for _, done, total in steps)
    assert notes and all(isinstance(n, str) for n in notes)


def test_verdict_and_manifest(solved):
    result = solved[0]
    assert result.verdict["level"] in {"good", "limited", "untrusted"} and result.verdict["text"]
    manifest = result.manifest
    assert manifest["command"][0] == "unbake.solve" and manifest["seed"] == 3
    assert manifest["options"]["solve"]["quality"] == "draft"
    assert manifest["options"]["effective"]["albedo-size"] == 128


class Enough(Exception):
    pass


def test_an_exception_from_the_callback_stops(scene, tmp_path):
    def progress(stage, done, total):
        if "irradiance" in stage:
            raise Enough(stage)

    out = tmp_path / "out"
    with pytest.raises(Enough):
        unbake.solve(scene, out, progress=progress, **SMALL)
    left = {p.name for p in out.iterdir()}
    assert not left & {"albedo.exr", "scene.glb", "manifest.json"}, left
    # nothing holds the folder, and the same call ends
    assert unbake.solve(scene, out, **SMALL).albedo.shape == (128, 128, 3)


def test_ctrl_c_stops(scene, tmp_path):
    def interrupt(stage, done, total):
        if "irradiance" in stage:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        unbake.solve(scene, tmp_path / "out", progress=interrupt, **SMALL)


def test_other_threads_run_meanwhile(scene, tmp_path):
    ticks, stop = [], threading.Event()

    def tick():
        while not stop.wait(0.01):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    started = time.monotonic()
    unbake.solve(scene, tmp_path / "out", **SMALL)
    seconds = time.monotonic() - started
    stop.set()
    thread.join()
    assert len(ticks) > 5 * seconds, (len(ticks), seconds)


def test_a_damaged_scene_is_named(scene, tmp_path):
    damaged = tmp_path / "damaged"
    shutil.copytree(scene, damaged)
    image = next(p for p in (damaged / "images").iterdir())
    image.write_bytes(image.read_bytes()[:200])
    with pytest.raises(unbake.InputError, match=image.name):
        unbake.solve(damaged, tmp_path / "out", **SMALL)
    assert any(image.name in p for p in unbake.check(damaged)["problems"])
    (damaged / "transforms.json").write_text("{")
    with pytest.raises(ValueError, match="transforms.json"):
        unbake.Scene(damaged)
    with pytest.raises(unbake.Error, match="is not a folder"):
        unbake.Solution(tmp_path / "none")


def test_check_of_a_good_scene(scene):
    found = unbake.check(scene)
    assert found["problems"] == [] and found["alignment"]["verdict"] != "misaligned" and found["text"]


def test_arguments_are_checked(scene, tmp_path):
    out = tmp_path / "out"
    for options, said in [
        (dict(albedo_sise=3), "albedo_sise"),
        (dict(quality="best"), "quality"),
        (dict(albedo_size=0), "albedo-size"),
        (dict(threads=0), "threads"),
        (dict(edges=3), "edges"),
    ]:
        with pytest.raises(unbake.UsageError, match=said):
            unbake.solve(scene, out, **options)
    with pytest.raises(unbake.UsageError, match="is the scene itself"):
        unbake.solve(scene, scene, **SMALL)


def test_cameras(scene):
    read = unbake.Scene(scene)
    cameras = read.cameras()
    assert len(cameras) == 6 and len(read.cameras("test")) == 1 and all(c.panorama for c in cameras)
    assert (cameras[0].width, cameras[0].height) == (128, 64) and cameras[0].lens is None
    frames = json.load(open(scene / "transforms.json"))["frames"]
    np.testing.assert_allclose(cameras[0].position, np.array(frames[0]["transform_matrix"])[:3, 3], atol=1e-5)
    np.testing.assert_allclose(cameras[0].world_from_camera, np.array(frames[0]["transform_matrix"])[:3, :3], atol=1e-5)
    looking = unbake.Camera.look_at((1, 2, 3), (1, 2, 0), 40, 30, fov=90)
    np.testing.assert_allclose(looking.world_from_camera, np.eye(3), atol=1e-6)
    assert looking.position == (1, 2, 3) and looking.lens["fl_x"] == pytest.approx(20)
    again = unbake.Camera(looking.position, looking.world_from_camera, 40, 30, fov=90)
    assert again.lens == looking.lens
    for wrong in [dict(fov=200), dict(width=0), dict(world_from_camera=[[2, 0, 0], [0, 1, 0], [0, 0, 1]])]:
        good = dict(position=(0, 0, 0), world_from_camera=np.eye(3).tolist(), width=8, height=8)
        with pytest.raises(unbake.UsageError):
            unbake.Camera(**(good | wrong))


def test_photographs_and_renderings_agree(solved, scene):
    result, read = solved[0], unbake.Scene(scene)
    held_out = read.cameras("test")
    rendered = result.render(held_out)
    assert isinstance(rendered, list) and rendered[0].shape == (64, 128, 3)
    photograph = read.photograph(held_out[0].name)
    error = np.mean((np.clip(rendered[0], 0, 1) - np.clip(photograph, 0, 1)) ** 2)
    assert -10 * np.log10(error) > 15
    one = result.render(held_out[0])
    np.testing.assert_array_equal(one, rendered[0])
    albedo = result.render(held_out[0], show="albedo", width=64)
    assert albedo.shape == (32, 64, 3) and albedo.max() <= 1
    assert len(result.render(read.cameras("train")[:2], path=3, width=16)) == 3
    with pytest.raises(unbake.UsageError, match="no option exposure"):
        result.render(held_out[0], exposure=1)


def test_relit_pictures_follow_their_light(solved, scene):
    result = solved[0]
    camera = unbake.Scene(scene).cameras("test")[0]
    options = dict(width=32, samples=16, max_samples=16, no_denoise=True)
    dark = result.relight(camera, lamps=[{"off": True}], environment={"off": True}, **options)
    assert dark.shape == (16, 32, 3) and np.all(dark == 0)
    lit = result.relight(camera, environment={"off": True}, **options)
    double = result.relight(camera, environment={"off": True}, lamps=[{"scale": 2.0}], **options)
    np.testing.assert_allclose(double, 2 * lit, rtol=1e-4, atol=1e-6)
    bulb = {"kind": "point", "position": list(camera.position), "intensity": [1, 0, 0]}
    red = result.relight(camera, lamps=[{"off": True}], environment={"off": True}, add=[bulb], **options)
    assert red[..., 0].max() > 0 and red[..., 1:].max() == 0
    with pytest.raises(unbake.UsageError, match="lamp 99"):
        result.relight(camera, lamps=[{"group": 99}], **options)
