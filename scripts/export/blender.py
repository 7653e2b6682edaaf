"""Opens scene.glb (and scene.usda) in Blender and saves, for each camera, the base colour that Cycles sees and, of the glTF file, what
Cycles renders under the file's lamps and the exported environment."""
import json, sys
from pathlib import Path
import bpy, mathutils
import numpy as np

folder, out = Path(sys.argv[1]), Path(sys.argv[2])


def fresh():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 16
    scene.cycles.use_denoising = False
    scene.render.film_transparent = False
    scene.render.filter_size = 0.5
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.color_mode = "RGB"
    return scene


def albedo_only():
    """What is looked at is the base colour itself: emission of exactly that colour."""
    for material in bpy.data.materials:
        if not material.node_tree:
            continue
        tree = material.node_tree
        shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
        link = shader.inputs["Base Color"].links[0]
        emission = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(link.from_socket, emission.inputs["Color"])
        output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
        tree.links.new(emission.outputs[0], output.inputs["Surface"])


def diffuse_under_own_light(scene):
    """The exported light on diffuse, flat triangles: what `unbake render --renderer path --diffuse-only --flat` shows."""
    scene.cycles.samples = 64
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 64
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0
    for material in bpy.data.materials:
        if not material.node_tree:
            continue
        tree = material.node_tree
        shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
        shader.inputs["Specular IOR Level"].default_value = 0
        for link in list(shader.inputs["Specular IOR Level"].links):
            tree.links.remove(link)
        # a double-sided glTF material shines to both sides; unbake's lamps shine to the front
        front = tree.nodes.new("ShaderNodeMath")
        front.operation = "MULTIPLY_ADD"
        strength = shader.inputs["Emission Strength"].default_value
        front.inputs[1].default_value, front.inputs[2].default_value = -strength, strength
        tree.links.new(tree.nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"], front.inputs[0])
        tree.links.new(front.outputs[0], shader.inputs["Emission Strength"])
    for mesh in bpy.data.meshes:
        if "custom_normal" in mesh.attributes:
            mesh.attributes.remove(mesh.attributes["custom_normal"])
        mesh.shade_flat()
    file = folder / "mitsuba_environment.exr"
    if file.exists():
        image = bpy.data.images.load(str(file))
        w, h = image.size
        pixels = np.empty(w * h * 4, np.float32)
        image.pixels.foreach_get(pixels)
        # Blender's panoramas begin a quarter of a turn away from Mitsuba's
        turned = bpy.data.images.new("environment", w, h, float_buffer=True, is_data=True)
        turned.pixels.foreach_set(np.roll(pixels.reshape(h, w, 4), -w // 4, axis=1).ravel())
        scene.world = bpy.data.worlds.new("world")
        scene.world.use_nodes = True
        tree = scene.world.node_tree
        texture = tree.nodes.new("ShaderNodeTexEnvironment")
        texture.image = turned
        background = next(n for n in tree.nodes if n.type == "BACKGROUND")
        tree.links.new(texture.outputs[0], background.inputs["Color"])


def shoot(scene, prefix):
    for frame in json.loads((folder / "cameras.json").read_text())["frames"]:
        data = bpy.data.cameras.new("camera")
        data.sensor_fit, data.sensor_width, data.clip_start = "HORIZONTAL", 36.0, 0.01
        data.lens = frame["fl_x"] / frame["w"] * 36.0
        camera = bpy.data.objects.new("camera", data)
        scene.collection.objects.link(camera)
        # glTF's y-up world becomes Blender's z-up world: (x, y, z) -> (x, -z, y)
        turn = mathutils.Matrix(((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1)))
        camera.matrix_world = turn @ mathutils.Matrix(frame["transform_matrix"])
        scene.camera = camera
        scene.render.resolution_x, scene.render.resolution_y = frame["w"], frame["h"]
        scene.render.resolution_percentage = 100
        scene.render.filepath = str(out / f"{prefix}_{Path(frame['file_path']).stem}.exr")
        bpy.ops.render.render(write_still=True)


scene = fresh()
bpy.ops.import_scene.gltf(filepath=str(folder / "scene.glb"))
own = [m for m in bpy.data.materials if m.node_tree]
shader = next(n for n in own[0].node_tree.nodes if n.type == "BSDF_PRINCIPLED")
strength = shader.inputs["Emission Strength"].default_value
print("meshes", len(bpy.data.meshes), "materials", len(own), "emission strength", strength)
diffuse_under_own_light(scene)
shoot(scene, "blender_lit")
scene.world = None
scene.cycles.samples = 16
albedo_only()
shoot(scene, "blender_albedo")
scene = fresh()
bpy.ops.wm.usd_import(filepath=str(folder / "scene.usda"))
scene.world = None  # the dome is no base colour
albedo_only()
shoot(scene, "blender_usd_albedo")
