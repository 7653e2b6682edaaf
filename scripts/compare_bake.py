"""Time of `unbake bake` and of Blender Cycles to a lightmap within 1 % of what each converges to, of the same glTF file, layout and light;
run by scripts/compare.

Arguments: unbake, the file, a folder for results, and optionally a panorama of the light from outside. Error: root mean square of the
texels that both programs light, over their mean. Cycles bakes diffuse light, direct and indirect, without the surfaces' colour, onto the
second UV map that unbake made, without denoiser (its bake has none). Its error per texel does not depend on the resolution: it is
measured at a quarter of the side, time at the whole side.
"""

import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import bpy
import cycles_bake as cycles
import numpy as np

SIDE = int(os.environ.get("SIDE", 256))
PATHS = int(os.environ.get("PATHS", 16384))
GOAL = 0.01
BOUNCES = 64  # as many as unbake's path tracer follows at most


def lightmap(folder):
    """Irradiance of a lightmap, rows from the bottom as Blender has them."""
    image = bpy.data.images.load(str(folder / "lightmap.exr"))
    image.colorspace_settings.name = "Non-Color"
    out = cycles.pixels(image)[..., :3].astype(np.float64)
    bpy.data.images.remove(image)
    return out


def relative(values, reference, covered):
    return math.sqrt(((values - reference)[covered] ** 2).sum() / covered.sum()) / reference[covered].sum(1).mean()


class Unbake:
    """The program on one file and light."""

    def __init__(self, program, file, folder, environment):
        self.command = [program, "bake", file, "--size", SIDE, "--quiet"]
        self.command += ["--environment", environment] if environment else []
        self.folder = folder

    def bake(self, name, samples, seed):
        """Lightmap, seconds and bake.json."""
        out = self.folder / name
        command = [*self.command, "-o", out, "--samples", samples, "--seed", seed]
        start = time.perf_counter()
        subprocess.run([str(c) for c in command], check=True, stdout=subprocess.DEVNULL)
        return lightmap(out), time.perf_counter() - start, json.loads((out / "bake.json").read_text())

    def time_to_goal(self, reference, covered):
        """Seconds of the first doubling that is as good; None if none is."""
        samples = 16
        while samples < PATHS:
            value, seconds, about = self.bake("timed", samples, 0)
            error = relative(value, reference, covered)
            print(f"  {samples:6} paths: {seconds:7.1f} s, error {100 * error:5.2f} %, stated {100 * about['error']:.2f} %")
            if error <= GOAL:
                return seconds
            samples *= 2
        return None


def setup(glb, environment):
    mesh = cycles.joined(glb)
    layers = mesh.data.uv_layers
    layers.active = layers[len(layers) - 1]
    targets = []
    for slot in mesh.material_slots:
        slot.material.use_nodes = True
        nodes = slot.material.node_tree.nodes
        targets.append((nodes, nodes.new("ShaderNodeTexImage")))
    if environment:
        tree, sky = cycles.environment(environment)
        sky.image.colorspace_settings.name = "Linear Rec.709"
        # a panorama's middle is -z in the file, which is +y in Blender; Blender's own is +x
        turn, place = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
        turn.inputs["Rotation"].default_value[2] = math.radians(-90)
        tree.links.new(place.outputs["Generated"], turn.inputs["Vector"])
        tree.links.new(turn.outputs["Vector"], sky.inputs["Vector"])
    cycles.bakes_diffuse(indirect=True)
    settings = bpy.context.scene.cycles
    settings.sample_clamp_indirect = 0
    # Blender stops diffuse light after four bounces
    settings.max_bounces = settings.diffuse_bounces = settings.glossy_bounces = BOUNCES
    return targets


def time_of_cycles(targets):
    """Seconds to the goal, by error and time per sample."""
    small = max(SIDE // 4, 16)
    reference, covered, taken = cycles.bake(targets, small, 16384, 1)
    print(f"  reference: {small}x{small}, 16384 samples, {taken:.1f} s, {covered.sum()} texels")
    errors = []
    for samples in (64, 256, 1024):
        value, _, _ = cycles.bake(targets, small, samples, 2)
        errors.append((samples, relative(value, reference, covered)))
        print(f"  {samples:6} samples: error {100 * errors[-1][1]:5.2f} %")
    fixed, per_sample = cycles.times(targets, SIDE)
    needed = cycles.samples_for(GOAL, errors)
    seconds = max(fixed, 0.0) + per_sample * needed
    print(f"  {100 * GOAL:.0f} % needs about {needed:.0f} samples: {seconds:.0f} s (scaled up, {per_sample:.4f} s each)")
    return seconds


def main():
    program, file, folder = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    environment = Path(sys.argv[4]) if len(sys.argv) > 4 else None
    folder.mkdir(parents=True, exist_ok=True)
    unbake = Unbake(program, file, folder, environment)
    reference, seconds, about = unbake.bake("reference", PATHS, 1)
    targets = setup(folder / "reference/scene.glb", environment)
    whole, covered, _ = cycles.bake(targets, SIDE, 256, 4)
    covered &= reference.sum(2) > 0
    print(f"unbake bake of {file.name} on {os.cpu_count()} threads")
    print(f"  reference: {SIDE}x{SIDE}, {PATHS} paths, {seconds:.1f} s, stated error {100 * about['error']:.2f} %, {covered.sum()} texels")
    ours = unbake.time_to_goal(reference, covered)
    print(f"Blender {bpy.app.version_string}, Cycles on {os.cpu_count()} threads")
    theirs = time_of_cycles(targets)
    if ours:
        print(f"{100 * GOAL:.0f} %: unbake {ours:.1f} s, Cycles {theirs:.0f} s, {theirs / ours:.1f} times as long")
    else:
        print(f"unbake does not reach {100 * GOAL:.0f} % below {PATHS} paths; Cycles {theirs:.0f} s")
    # inside of bodies and under things Cycles finds little light, and unbake takes that beside them
    seen = covered & (math.pi * whole.sum(2) > 0.5 * reference.sum(2))
    ratio = math.pi * whole[seen].sum() / reference[seen].sum()
    print(f"light of the {100 * seen.sum() / covered.sum():.0f} % of the texels that are not hidden: Cycles / unbake {ratio:.3f}")


main()
