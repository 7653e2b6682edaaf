"""Bakes of diffuse light by Blender Cycles, for scripts/compare_blender.py and scripts/compare_bake.py."""

import math
import time

import bpy
import numpy as np


def joined(glb):
    """The only mesh of an empty scene into which a file's meshes are joined."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(glb))
    meshes = [o for o in bpy.context.scene.objects if o.type == "MESH"]
    bpy.ops.object.select_all(action="DESELECT")
    for o in meshes:
        o.select_set(True)
    bpy.context.view_layer.objects.active = meshes[0]
    if len(meshes) > 1:
        bpy.ops.object.join()
    return meshes[0]


def environment(path):
    """Light from outside by a panorama: its world's node tree and texture node."""
    world = bpy.data.worlds.new("environment")
    bpy.context.scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    sky = tree.nodes.new("ShaderNodeTexEnvironment")
    sky.image = bpy.data.images.load(str(path))
    tree.links.new(sky.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    return tree, sky


def bakes_diffuse(indirect):
    """Settings of bakes of direct and, if asked, indirect light without the surfaces' colour, every sample taken and none denoised."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.render.bake.margin = 0
    scene.render.bake.use_pass_direct = True
    scene.render.bake.use_pass_indirect = indirect
    scene.render.bake.use_pass_color = False


def pixels(image):
    """Rows from the bottom, four channels."""
    width, height = image.size
    out = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(out)
    return out.reshape(height, width, 4)


def bake(targets, side, samples, seed):
    """Irradiance / pi, which texels are covered, and seconds. `targets` are a material's nodes and its node for the image, per material."""
    image = bpy.data.images.new(f"bake {side} {samples}", side, side, alpha=True, float_buffer=True, is_data=True)
    image.generated_color = (0, 0, 0, 0)
    for nodes, node in targets:
        node.image = image
        nodes.active = node
    bpy.context.scene.cycles.samples = samples
    bpy.context.scene.cycles.seed = seed
    start = time.perf_counter()
    bpy.ops.object.bake(type="DIFFUSE")
    seconds = time.perf_counter() - start
    baked = pixels(image)
    bpy.data.images.remove(image)
    return baked[..., :3].astype(np.float64), baked[..., 3] > 0, seconds


def times(targets, side):
    """Seconds that a bake takes whatever its samples, and per sample: from 4 and 20 samples at 1024², more where they are quick."""
    few, more = (samples * max(1, (1024 // side) ** 2) for samples in (4, 20))
    took_few, took_more = (bake(targets, side, samples, 3)[2] for samples in (few, more))
    per_sample = (took_more - took_few) / (more - few)
    return took_few - few * per_sample, per_sample


def samples_for(error, errors):
    """Samples at which an error is reached, between and beyond (samples, error) by the slope of the last two."""
    (n1, e1), (n2, e2) = errors[-2:]
    return n2 * (error / e2) ** (math.log(n2 / n1) / math.log(e2 / e1))
