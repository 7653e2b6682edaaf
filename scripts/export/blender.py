"""Opens scene.glb (and scene.usda) in Blender and saves, for each camera, the diffuse colour that Cycles sees."""
import json, sys
from pathlib import Path
import bpy, mathutils

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
shoot(scene, "blender_lit")
albedo_only()
shoot(scene, "blender_albedo")
scene = fresh()
bpy.ops.wm.usd_import(filepath=str(folder / "scene.usda"))
albedo_only()
shoot(scene, "blender_usd_albedo")
