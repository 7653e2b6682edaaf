"""Tests the Blender add-on: arguments are the output folder of `unbake solve`, the program, and a folder for pictures.

Lights must carry the power that lights.json states, a room lit by them must be as bright as by the luminous surfaces that they stand
for, the panorama must stand the right way round, and a baked scene must look as Cycles sees the scene it was baked from.
"""

import importlib.util
import json
import math
import shutil
import sys
from pathlib import Path

import bpy
import mathutils
import numpy as np

result, program, out = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
out.mkdir(parents=True, exist_ok=True)
spec = importlib.util.spec_from_file_location(
    "unbake_import", Path(__file__).resolve().parents[2] / "python" / "blender" / "unbake_import.py"
)
addon = importlib.util.module_from_spec(spec)
sys.modules["unbake_import"] = addon
spec.loader.exec_module(addon)


def fresh(samples):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", samples, False
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 12
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    return scene


def matte():
    """Nothing but diffuse reflection: what a lightmap holds. Lamps shine to the front only, as unbake's."""
    for material in bpy.data.materials:
        if material.node_tree:
            for n in material.node_tree.nodes:
                if n.type == "BSDF_PRINCIPLED":
                    level = n.inputs["Specular IOR Level"]
                    level.default_value = 0
                    for link in list(level.links):
                        material.node_tree.links.remove(link)


def shoot(scene, name, place, size=(96, 48)):
    """A panorama from `place`, (rows, columns, 3)."""
    data = bpy.data.cameras.new(name)
    data.type, data.clip_start = "PANO", 0.01
    data.panorama_type = "EQUIRECTANGULAR"
    camera = bpy.data.objects.new(name, data)
    scene.collection.objects.link(camera)
    camera.location = place
    camera.rotation_euler = (math.pi / 2, 0, 0)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.filepath = str(out / f"{name}.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.empty(size[0] * size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(size[1], size[0], 4)[::-1, :, :3]


def brightness(picture, ceiling):
    """Mean of what is no lamp."""
    return float(np.minimum(picture, ceiling).mean())


def check(what, ours, expected, tolerance):
    print(f"{what}: {ours:.4g}, expected {expected:.4g} within {tolerance:.0%}")
    assert abs(ours / expected - 1) <= tolerance, what


def middle(mesh_object):
    corners = np.array([mesh_object.matrix_world @ mathutils.Vector(c) for c in mesh_object.bound_box])
    return corners.mean(0) + (0, 0, 0.1)


def lamps():
    scene = fresh(128)
    mesh, count = addon.import_result(result, "SURFACES")
    assert count == 0
    matte()
    surfaces = shoot(scene, "surfaces", middle(mesh))
    scene = fresh(128)
    assert bpy.ops.import_scene.unbake(filepath=str(result / "scene.glb"), lamps="LIGHTS") == {"FINISHED"}
    matte()
    stated = [x for x in json.loads((result / "lights.json").read_text())["lights"] if x["triangles"]]
    lights = [o for o in scene.objects if o.type == "LIGHT"]
    assert len(lights) == len(stated) > 0
    for lamp in stated:
        light = bpy.data.lights[f"{lamp['kind']} {lamp['id']}"]
        np.testing.assert_allclose(np.array(light.color) * light.energy, lamp["power"], rtol=1e-4)
    mesh = next(o for o in scene.objects if o.type == "MESH" and o.name != "lamps")
    assert bpy.data.objects["lamps"].data.polygons and len(mesh.data.polygons) > 0
    lit = shoot(scene, "lights", middle(mesh))
    ceiling = float(np.quantile(surfaces, 0.97))
    check("room lit by lights against luminous surfaces", brightness(lit, ceiling), brightness(surfaces, ceiling), 0.1)
    for o in lights:
        o.hide_render = True
    scene.world = None
    dark = shoot(scene, "dark", middle(mesh))
    assert np.median(dark) < 0.02 * np.median(lit), "lamps that are lights no longer shine as surfaces"


def panorama():
    scene = fresh(1)
    folder = out / "panorama"
    folder.mkdir(exist_ok=True)
    image = bpy.data.images.new("directions", 64, 32, float_buffer=True, is_data=True)
    pixels = np.ones((32, 64, 4), np.float32)
    pixels[..., 0] = (np.arange(64) + 0.5) / 64
    pixels[..., 1] = ((np.arange(32) + 0.5) / 32)[:, None]
    image.pixels.foreach_set(pixels.ravel())
    image.file_format, image.filepath_raw = "OPEN_EXR", str(folder / "environment.exr")
    image.save()
    addon.surround(folder)
    # a camera whose middle is +y of Blender, -z of glTF, sees the panorama as it is
    seen = shoot(scene, "directions", (0, 0, 0), (64, 32))
    np.testing.assert_allclose(seen[:, 2:-2, 0], pixels[::-1, 2:-2, 0], atol=0.02)
    np.testing.assert_allclose(seen[2:-2, :, 1], pixels[::-1][2:-2, :, 1], atol=0.02)
    print("panorama: the right way round")


def baked():
    scene = fresh(128)
    mesh, _ = addon.import_result(result, "SURFACES", environment=False)
    matte()
    place = middle(mesh)
    traced = shoot(scene, "traced", place)
    shutil.rmtree(out / "bake", ignore_errors=True)
    addon.bake(program, out / "bake", samples=64, size=512)
    scene.cycles.max_bounces = 0
    mapped = shoot(scene, "mapped", place)
    ceiling = float(np.quantile(traced, 0.97))
    check("baked scene against Cycles", brightness(mapped, ceiling), brightness(traced, ceiling), 0.1)
    try:
        addon.bake(program, out / "bake", samples=64, size=15)
    except ValueError as e:
        assert "--size" in str(e), e
    else:
        raise AssertionError("a wrong size was taken")


def refused():
    fresh(1)
    try:
        bpy.ops.import_scene.unbake(filepath=str(out / "nothing" / "scene.glb"))
    except RuntimeError as e:
        assert "unbake solve" in str(e), e
    else:
        raise AssertionError("a folder without a result was taken")


addon.register()
refused()
panorama()
lamps()
baked()
addon.unregister()
print("the add-on works in Blender", bpy.app.version_string)
