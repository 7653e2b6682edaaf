"""Time of Blender Cycles' diffuse bake to a given error on the geometry and light of an unbake result; run by scripts/compare.

Arguments: the output folder of `unbake solve`, and optionally unbake's seconds and relative RMSE in percent for a 1024x1024
irradiance texture (from `unbake bench irt`) to compare with. The scene is unlit but for its own emission: every surface sends out
the radiance texture of the result, the world the environment; the direct diffuse bake is then irradiance / pi. Errors are taken
on a 128x128 bake against 1024 samples (error per texel does not depend on the resolution), times on 1024x1024.
"""

import math
import os
import sys
import time

import bpy
import numpy as np


def setup(folder):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=os.path.join(folder, "scene.glb"))
    meshes = [o for o in bpy.context.scene.objects if o.type == "MESH"]
    for o in list(bpy.context.scene.objects):
        if o.type != "MESH":
            bpy.data.objects.remove(o)
    bpy.context.view_layer.objects.active = meshes[0]
    for o in meshes:
        o.select_set(True)
    if len(meshes) > 1:
        bpy.ops.object.join()
    material = bpy.data.materials.new("sends out the observed radiance")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    radiance = nodes.new("ShaderNodeTexImage")
    radiance.image = bpy.data.images.load(os.path.join(folder, "radiance.exr"))
    radiance.image.colorspace_settings.name = "Linear Rec.709"
    emission, diffuse = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    add, output = nodes.new("ShaderNodeAddShader"), nodes.new("ShaderNodeOutputMaterial")
    target = nodes.new("ShaderNodeTexImage")
    links.new(radiance.outputs["Color"], emission.inputs["Color"])
    links.new(emission.outputs[0], add.inputs[0])
    links.new(diffuse.outputs[0], add.inputs[1])
    links.new(add.outputs[0], output.inputs["Surface"])
    mesh = meshes[0].data
    mesh.materials.clear()
    mesh.materials.append(material)
    for polygon in mesh.polygons:
        polygon.material_index = 0
    world = bpy.data.worlds.new("environment")
    bpy.context.scene.world = world
    world.use_nodes = True
    sky = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    path = os.path.join(folder, "environment.exr")
    if os.path.exists(path):
        sky.image = bpy.data.images.load(path)
        world.node_tree.links.new(sky.outputs["Color"], world.node_tree.nodes["Background"].inputs["Color"])
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.max_bounces = 0
    scene.render.bake.margin = 0
    scene.render.bake.use_pass_direct = True
    scene.render.bake.use_pass_indirect = False
    scene.render.bake.use_pass_color = False
    return material, target


def bake(material, target, side, samples, seed):
    image = bpy.data.images.new(f"bake {side} {samples}", side, side, float_buffer=True, is_data=True)
    target.image = image
    material.node_tree.nodes.active = target
    bpy.context.scene.cycles.samples = samples
    bpy.context.scene.cycles.seed = seed
    start = time.perf_counter()
    bpy.ops.object.bake(type="DIFFUSE")
    seconds = time.perf_counter() - start
    pixels = np.empty(side * side * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(-1, 4)[:, :3].astype(np.float64), seconds


def main():
    folder = sys.argv[1]
    ours = [float(a) for a in sys.argv[2:4]]
    material, target = setup(folder)
    print(f"Blender {bpy.app.version_string}, Cycles on {os.cpu_count()} threads, direct diffuse bake of {folder}")
    reference, seconds = bake(material, target, 128, 1024, 1)
    lit = reference.sum(1) > 0
    print(f"  reference: 128x128, 1024 samples, {seconds:.1f} s, {lit.sum()} lit texels")
    errors = []
    for samples in (4, 16, 64):
        value, seconds = bake(material, target, 128, samples, 2)
        d = (value - reference)[lit]
        rmse = math.sqrt((d * d).sum() / (reference[lit] ** 2).sum())
        errors.append((samples, rmse))
        print(f"  {samples:5} samples: relative RMSE {100 * rmse:6.2f} %")
    _, few = bake(material, target, 1024, 4, 3)
    _, more = bake(material, target, 1024, 20, 3)
    per_sample, fixed = (more - few) / 16, few - 4 * (more - few) / 16
    print(f"  1024x1024: {fixed:.1f} s + {per_sample:.3f} s per sample (from 4 and 20 samples)")
    # between and beyond the points by the slope of the last two
    (n1, e1), (n2, e2) = errors[-2:]
    slope = math.log(e2 / e1) / math.log(n2 / n1)
    for percent in [ours[1]] if len(ours) == 2 else [5.0, 2.0, 1.0]:
        samples = n2 * (percent / 100 / e2) ** (1 / slope)
        seconds = max(fixed, 0.0) + per_sample * samples
        compared = f", {seconds / ours[0]:.1f} times unbake's {ours[0]:.1f} s" if len(ours) == 2 else ""
        print(f"  {percent:.2f} % needs about {samples:.0f} samples: {seconds:.0f} s (scaled up){compared}")


main()
