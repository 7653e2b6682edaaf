"""Time of Blender Cycles' diffuse bake to a given error on the geometry and light of an unbake result; run by scripts/compare.

Arguments: the output folder of `unbake solve`, and optionally unbake's seconds and relative RMSE in percent for a 1024x1024
irradiance texture (from `unbake bench irt`) to compare with. The scene is unlit but for its own emission: every surface sends out
the radiance texture of the result, the world the environment; the direct diffuse bake is then irradiance / pi. Errors are taken
on a 128x128 bake against 1024 samples (error per texel does not depend on the resolution), times on 1024x1024.
"""

import math
import os
import sys

import bpy
import cycles_bake as cycles


def setup(folder):
    joined = cycles.joined(os.path.join(folder, "scene.glb"))
    for o in list(bpy.context.scene.objects):
        if o.type != "MESH":
            bpy.data.objects.remove(o)
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
    mesh = joined.data
    mesh.materials.clear()
    mesh.materials.append(material)
    for polygon in mesh.polygons:
        polygon.material_index = 0
    path = os.path.join(folder, "environment.exr")
    if os.path.exists(path):
        cycles.environment(path)
    cycles.bakes_diffuse(indirect=False)
    bpy.context.scene.cycles.max_bounces = 0
    return [(nodes, target)]


def main():
    folder = sys.argv[1]
    ours = [float(a) for a in sys.argv[2:4]]
    targets = setup(folder)
    print(f"Blender {bpy.app.version_string}, Cycles on {os.cpu_count()} threads, direct diffuse bake of {folder}")
    reference, _, seconds = cycles.bake(targets, 128, 1024, 1)
    lit = reference.sum(2) > 0
    print(f"  reference: 128x128, 1024 samples, {seconds:.1f} s, {lit.sum()} lit texels")
    errors = []
    for samples in (4, 16, 64):
        value, _, _ = cycles.bake(targets, 128, samples, 2)
        d = (value - reference)[lit]
        rmse = math.sqrt((d * d).sum() / (reference[lit] ** 2).sum())
        errors.append((samples, rmse))
        print(f"  {samples:5} samples: relative RMSE {100 * rmse:6.2f} %")
    fixed, per_sample = cycles.times(targets, 1024)
    print(f"  1024x1024: {fixed:.1f} s + {per_sample:.3f} s per sample (from 4 and 20 samples)")
    for percent in [ours[1]] if len(ours) == 2 else [5.0, 2.0, 1.0]:
        samples = cycles.samples_for(percent / 100, errors)
        seconds = max(fixed, 0.0) + per_sample * samples
        compared = f", {seconds / ours[0]:.1f} times unbake's {ours[0]:.1f} s" if len(ours) == 2 else ""
        print(f"  {percent:.2f} % needs about {samples:.0f} samples: {seconds:.0f} s (scaled up){compared}")


main()
