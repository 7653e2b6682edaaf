"""Blender add-on: results of unbake as scenes, and lightmaps by `unbake bake`.

Install it by Preferences > Add-ons > Install from Disk. File > Import > unbake result takes the output folder of `unbake solve`:
the mesh with its materials, the panorama around it, and its lamps, as luminous surfaces or as lights that can be switched and moved.
The panel "unbake" of the 3D view's sidebar bakes the scene: it needs the program (PATH or the add-on's preferences).

Axes: glTF's (x, y, z), y up, is Blender's (x, -z, y). Power: Blender's watts of a light are its flux (pi * radiance * area), which is
what lights.json calls power; radiance keeps the unit of the photographs.
"""

import contextlib
import json
import math
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path

import bpy
import mathutils
import numpy as np
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

bl_info = {
    "name": "unbake",
    "description": "Import results of unbake; bake lightmaps with it",
    "version": (0, 1, 0),
    "blender": (4, 2, 0),
    "location": "File > Import; 3D view > sidebar > unbake",
    "category": "Import-Export",
}

# Vector area over area from which a lamp is flat: halfway between a hemisphere, 1/2, and a plane, 1; as src/programs/export/area_light.rs.
FLAT = 0.75
# How far before its surface a flat lamp's light stands, metres: a light within the surface is hidden by it.
GAP = 0.002
# Name of the node that lets a lamp shine to the front.
FRONT = "unbake front"


def z_up(points):
    """glTF's coordinates as Blender's; (..., 3)."""
    points = np.asarray(points)
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def triangles_of(path):
    """Corners (triangles, 3, 3) of the one mesh in a scene.glb of `unbake solve`, relative to its node, Blender's axes."""
    data = path.read_bytes()
    magic, version, _ = struct.unpack_from("<4sII", data)
    if magic != b"glTF" or version != 2:
        raise ValueError(f"{path}: is no glTF 2 file; run `unbake solve` again")
    (length,) = struct.unpack_from("<I", data, 12)
    gltf, binary = json.loads(data[20 : 20 + length]), 28 + length
    (primitive,) = gltf["meshes"][0]["primitives"]

    def accessor(index, dtype, width):
        a = gltf["accessors"][index]
        view = gltf["bufferViews"][a["bufferView"]]
        start = binary + view.get("byteOffset", 0) + a.get("byteOffset", 0)
        return np.frombuffer(data, dtype, a["count"] * width, start).reshape(-1, width)

    positions = accessor(primitive["attributes"]["POSITION"], "<f4", 3)
    return z_up(positions)[accessor(primitive["indices"], "<u4", 1).reshape(-1, 3)]


def rectangle(points, normal):
    """Axes (columns x, y, z with -z along the normal) and size of a rectangle around points seen along `normal`: sides along their
    principal directions."""
    flat = points - points.mean(0)
    flat = flat - np.outer(flat @ normal, normal)
    x = np.linalg.svd(flat, full_matrices=False)[2][0]
    x = x - normal * (x @ normal)
    x /= np.linalg.norm(x)
    y = np.cross(x, normal)
    size = [np.ptp(points @ x), np.ptp(points @ y)]
    return np.stack([x, y, -normal], axis=1), size


def light_of(lamp, corners, world):
    """A light object with the flux, area and place of a lamp whose triangles have these corners, in the mesh's space."""
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    areas, vector_area = np.linalg.norm(edges, axis=1), edges.sum(0)
    area = areas.sum()
    centre = (corners.mean(1) * areas[:, None]).sum(0) / area
    flat = np.linalg.norm(vector_area) > FLAT * area
    data = bpy.data.lights.new(f"{lamp['kind']} {lamp['id']}", "AREA" if flat else "POINT")
    place = mathutils.Matrix.Identity(4)
    if flat:
        normal = vector_area / np.linalg.norm(vector_area)
        axes, size = rectangle(corners.reshape(-1, 3), normal)
        # what does not fill its rectangle becomes a smaller one of the same sides
        share = math.sqrt(area / max(size[0] * size[1], 1e-12))
        data.shape, data.size, data.size_y = "RECTANGLE", size[0] * share, size[1] * share
        place = mathutils.Matrix(axes.tolist()).to_4x4()
        centre = centre + GAP * normal
    else:
        data.shadow_soft_size = math.sqrt(area / (4 * math.pi))
        data.use_soft_falloff = False
    brightest = max(lamp["power"])
    data.energy = brightest
    data.color = [p / brightest for p in lamp["power"]] if brightest > 0 else (1, 1, 1)
    light = bpy.data.objects.new(data.name, data)
    place.translation = centre.tolist()
    light.matrix_world = world @ place
    # the lamp's own surface is what is looked at
    light.visible_camera = False
    return light


def lamps_of(folder, mesh_object):
    """The lamps that have power and triangles, the corners of all triangles, and which of these are luminous; no lamp, no triangles."""
    lamps = json.loads((folder / "lights.json").read_text())["lights"]
    lamps = [lamp for lamp in lamps if lamp["triangles"] and max(lamp["power"]) > 0]
    if not lamps:
        return [], None, None
    corners = triangles_of(folder / "scene.glb")
    mesh = mesh_object.data
    centres = np.empty(len(mesh.polygons) * 3, np.float32)
    mesh.polygons.foreach_get("center", centres)
    centres = centres.reshape(-1, 3)
    if len(centres) != len(corners) or np.abs(centres - corners.mean(1)).max() > 1e-3 * np.ptp(corners):
        raise ValueError(
            f"{folder / 'scene.glb'}: Blender read other triangles than the file has, so that its lamps are not found; File > Import > "
            "glTF takes it with lamps that shine to both sides"
        )
    luminous = np.zeros(len(corners), bool)
    for lamp in lamps:
        luminous[lamp["triangles"]] = True
    return lamps, corners, luminous


def shine_forward(mesh_object, luminous):
    """Gives the luminous faces a material that shines to the front only, as lamps of unbake do: Cycles lets double-sided ones shine into
    the ceiling that they hang below."""
    mesh = mesh_object.data
    own = mesh.materials[0].copy()
    own.name = "lamps"
    # exported as single-sided, which `unbake bake` takes for the same
    own.use_backface_culling = True
    mesh.materials.append(own)
    mesh.polygons.foreach_set("material_index", np.where(luminous, len(mesh.materials) - 1, 0).astype(np.int32))
    nodes, links = own.node_tree.nodes, own.node_tree.links
    shader = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")
    strength = shader.inputs["Emission Strength"]
    front = nodes.new("ShaderNodeMath")
    front.name, front.operation = FRONT, "MULTIPLY_ADD"
    front.inputs[1].default_value, front.inputs[2].default_value = -strength.default_value, strength.default_value
    links.new(nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"], front.inputs[0])
    links.new(front.outputs[0], strength)


@contextlib.contextmanager
def plain_strength():
    """Strengths of emission as numbers, which is all that Blender's exporter reads."""
    trees = [m.node_tree for m in bpy.data.materials if m.node_tree and FRONT in m.node_tree.nodes]
    ends = [(tree, tree.nodes[FRONT].outputs[0], tree.nodes[FRONT].outputs[0].links[0].to_socket) for tree in trees]
    for tree, out, _ in ends:
        tree.links.remove(out.links[0])
    try:
        yield
    finally:
        for tree, out, strength in ends:
            tree.links.new(out, strength)


def lamps_as_lights(lamps, corners, luminous, mesh_object, collection):
    """Puts a light in the place of each lamp. The lamps' faces become an object of their own, which the camera sees and which neither
    lights anything nor hides a light."""
    mesh = mesh_object.data
    for lamp in lamps:
        collection.objects.link(light_of(lamp, corners[lamp["triangles"]], mesh_object.matrix_world))
    shown = mesh_object.copy()
    shown.data = mesh.copy()
    shown.name = shown.data.name = "lamps"
    collection.objects.link(shown)
    keep_faces(mesh, ~luminous)
    keep_faces(shown.data, luminous)
    shown.visible_diffuse = shown.visible_glossy = shown.visible_transmission = shown.visible_shadow = False


def keep_faces(mesh, keep):
    """Removes the faces that are not kept, and points without a face."""
    import bmesh

    edit = bmesh.new()
    edit.from_mesh(mesh)
    edit.faces.ensure_lookup_table()
    bmesh.ops.delete(edit, geom=[edit.faces[i] for i in np.flatnonzero(~keep)], context="FACES")
    edit.to_mesh(mesh)
    edit.free()


def surround(folder):
    """The panorama around the scene as the scene's world. Its middle is -z of glTF, Blender's +y; Blender has +x there."""
    world = bpy.data.worlds.new("unbake")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(str(folder / "environment.exr"))
    texture.image.colorspace_settings.name = "Linear Rec.709"
    mapping, place = nodes.new("ShaderNodeMapping"), nodes.new("ShaderNodeTexCoord")
    mapping.inputs["Rotation"].default_value = (0, 0, -math.pi / 2)
    background = next(n for n in nodes if n.type == "BACKGROUND")
    links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], background.inputs["Color"])


def import_result(folder, lamps="SURFACES", environment=True):
    """Imports an output folder; returns the mesh object and the number of lights."""
    folder = Path(folder)
    missing = [name for name in ("scene.glb", "lights.json", "environment.exr") if not (folder / name).is_file()]
    if missing:
        raise ValueError(f"{folder}: has no {', '.join(missing)}; choose the output folder of `unbake solve SCENE -o OUT`")
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(folder / "scene.glb"), merge_vertices=False)
    mesh_object = next(o for o in bpy.data.objects if o not in before and o.type == "MESH")
    bpy.context.view_layer.update()
    if environment:
        surround(folder)
    found, corners, luminous = lamps_of(folder, mesh_object)
    if found and lamps == "LIGHTS":
        lamps_as_lights(found, corners, luminous, mesh_object, bpy.context.collection)
        return mesh_object, len(found)
    if found:
        shine_forward(mesh_object, luminous)
    return mesh_object, 0


def lightmapped(image, material):
    """Makes a material show base colour times irradiance over pi, and nothing else."""
    if not material.node_tree:
        return
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next((n for n in nodes if n.type == "BSDF_PRINCIPLED"), None)
    if shader is None:
        return
    uv, texture = nodes.new("ShaderNodeUVMap"), nodes.new("ShaderNodeTexImage")
    uv.uv_map = "UVMap.001"
    texture.image = image
    colour, scale = nodes.new("ShaderNodeVectorMath"), nodes.new("ShaderNodeVectorMath")
    colour.operation, scale.operation = "MULTIPLY", "SCALE"
    scale.inputs["Scale"].default_value = 1 / math.pi
    base = shader.inputs["Base Color"]
    if base.links:
        links.new(base.links[0].from_socket, colour.inputs[0])
        links.remove(base.links[0])
    else:
        colour.inputs[0].default_value = base.default_value[:3]
    base.default_value = (0, 0, 0, 1)
    shader.inputs["Specular IOR Level"].default_value = 0
    links.new(uv.outputs["UV"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], colour.inputs[1])
    links.new(colour.outputs["Vector"], scale.inputs[0])
    glow = nodes.new("ShaderNodeVectorMath")
    emission, strength = shader.inputs["Emission Color"], shader.inputs["Emission Strength"]
    if emission.links and strength.default_value > 0:
        lamp = nodes.new("ShaderNodeVectorMath")
        lamp.operation = "SCALE"
        lamp.inputs["Scale"].default_value = strength.default_value
        links.new(emission.links[0].from_socket, lamp.inputs[0])
        links.new(lamp.outputs["Vector"], glow.inputs[1])
    else:
        glow.inputs[1].default_value = [c * strength.default_value for c in emission.default_value[:3]]
    links.new(scale.outputs["Vector"], glow.inputs[0])
    links.new(glow.outputs["Vector"], emission)
    strength.default_value = 1


def bake(program, folder, samples=256, size=0):
    """Bakes the scene by `unbake bake` into `folder`, and adds it, lit by the lightmap, as the collection "unbake bake"; what was there
    is hidden. Returns the objects."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as aside:
        source = Path(aside) / "scene.glb"
        # lights in the unit of emission: no lumens
        with plain_strength():
            bpy.ops.export_scene.gltf(
                filepath=str(source), export_lights=True, export_import_convert_lighting_mode="COMPAT", use_visible=True, export_apply=True
            )
        command = [program, "bake", str(source), "-o", str(folder), "--quiet", "--samples", str(samples)]
        command += ["--size", str(size)] if size else []
        done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise ValueError(done.stderr.strip() or f"{program} ended with exit code {done.returncode}")
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(folder / "scene.glb"))
    image = bpy.data.images.load(str(folder / "lightmap.exr"))
    image.colorspace_settings.name = "Non-Color"
    baked = bpy.data.collections.new("unbake bake")
    bpy.context.scene.collection.children.link(baked)
    new = [o for o in bpy.data.objects if o not in before]
    for old in before:
        old.hide_render = True
        old.hide_set(True)
    for o in new:
        for collection in list(o.users_collection):
            collection.objects.unlink(o)
        baked.objects.link(o)
        if o.type == "LIGHT":
            o.hide_render = True
    for material in {s.material for o in new for s in o.material_slots if s.material}:
        lightmapped(image, material)
    return new


class UNBAKE_OT_import(bpy.types.Operator, ImportHelper):
    """Import the output folder of unbake solve: mesh, materials, lamps, environment"""

    bl_idname = "import_scene.unbake"
    bl_label = "unbake result"
    bl_options = {"REGISTER", "UNDO"}
    filename_ext = ".glb"
    filter_glob: StringProperty(default="*.glb", options={"HIDDEN"})
    lamps: EnumProperty(
        name="Lamps",
        items=[
            ("SURFACES", "Luminous surfaces", "Exact in Cycles"),
            ("LIGHTS", "Lights", "Area and point lights of the same power, to switch and to move"),
        ],
        default="SURFACES",
    )
    environment: BoolProperty(name="Environment", default=True, description="The panorama around the scene becomes the world")

    def execute(self, context):
        folder = Path(self.filepath)
        folder = folder if folder.is_dir() else folder.parent
        try:
            _, count = import_result(folder, self.lamps, self.environment)
        except (ValueError, KeyError, OSError) as e:
            self.report({"ERROR"}, str(e))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{folder.name}: {count} lights")
        return {"FINISHED"}


class UNBAKE_OT_bake(bpy.types.Operator):
    """Bake the light of the visible scene with unbake bake and show it as a lightmap"""

    bl_idname = "scene.unbake_bake"
    bl_label = "Bake with unbake"
    bl_options = {"REGISTER", "UNDO"}
    directory: StringProperty(name="Folder", subtype="DIR_PATH", description="Where lightmap.exr and scene.glb go")
    samples: IntProperty(name="Samples", default=256, min=8, max=1 << 20)
    size: IntProperty(name="Side, texels", default=0, min=0, max=16384, description="0: as 40 texels per metre ask")

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        try:
            bake(program(context), bpy.path.abspath(self.directory), self.samples, self.size)
        except (ValueError, OSError) as e:
            self.report({"ERROR"}, str(e))
            return {"CANCELLED"}
        return {"FINISHED"}


class UNBAKE_PT_panel(bpy.types.Panel):
    bl_label = "unbake"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "unbake"

    def draw(self, context):
        self.layout.operator(UNBAKE_OT_import.bl_idname, text="Import a result", icon="IMPORT")
        self.layout.operator(UNBAKE_OT_bake.bl_idname, icon="LIGHT_AREA")


class UNBAKE_preferences(bpy.types.AddonPreferences):
    bl_idname = __name__
    program: StringProperty(name="Program", subtype="FILE_PATH", description="The program unbake; empty: as found in PATH")

    def draw(self, context):
        self.layout.prop(self, "program")


def program(context):
    """The program as the preferences or PATH have it."""
    addon = context.preferences.addons.get(__name__)
    found = (addon and bpy.path.abspath(addon.preferences.program)) or shutil.which("unbake")
    if not found:
        raise ValueError("the program unbake is not in PATH: name it in the preferences of the add-on unbake")
    return found


def menu(self, context):
    self.layout.operator(UNBAKE_OT_import.bl_idname, text="unbake result (scene.glb)")


CLASSES = (UNBAKE_OT_import, UNBAKE_OT_bake, UNBAKE_PT_panel, UNBAKE_preferences)


def register():
    for c in CLASSES:
        bpy.utils.register_class(c)
    bpy.types.TOPBAR_MT_file_import.append(menu)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(menu)
    for c in reversed(CLASSES):
        bpy.utils.unregister_class(c)
