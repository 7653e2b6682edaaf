"""Opens scene.usda with Pixar's library and compares it with lights.json: every lamp once, with its power by the definitions of UsdLux;
as many triangles as scene.glb; its convex bodies, closed, convex, and as many as in scene_collision.glb; the dome where light comes from outside. Usage: usd.py OUT FOLDER"""
import json, struct, sys
from pathlib import Path
from pxr import Gf, Usd, UsdGeom, UsdLux, UsdPhysics
from usd_checks import area, complaints, power

out, folder = Path(sys.argv[1]), Path(sys.argv[2])
failed = []


def triangles_of_glb(path):
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    root = json.loads(data[20:20 + length])
    shown, queue = [], list(root["scenes"][0]["nodes"])  # not levels of detail
    while queue:
        shown.append(root["nodes"][queue.pop()])
        queue += shown[-1].get("children", [])
    uses = [p["indices"] for n in shown if "mesh" in n for p in root["meshes"][n["mesh"]]["primitives"]]
    return sum(root["accessors"][i]["count"] // 3 for i in uses)


failed += complaints(folder / "scene.usda")
stage = Usd.Stage.Open(str(folder / "scene.usda"))
meshes = [UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
bodies = [m for m in meshes if m.GetPrim().HasAPI(UsdPhysics.CollisionAPI)]
shown = [m for m in meshes if m not in bodies]
count = sum(len(m.GetFaceVertexCountsAttr().Get()) for m in shown)
if count != triangles_of_glb(folder / "scene.glb"):
    failed.append(f"{count} triangles in scene.usda, {triangles_of_glb(folder / 'scene.glb')} in scene.glb")
for m in meshes:
    low, high = m.GetExtentAttr().Get()
    points = m.GetPointsAttr().Get()
    box = Gf.Range3f()
    for p in points:
        box.UnionWith(p)
    if Gf.IsClose(box.GetMin(), low, 1e-5) is False or Gf.IsClose(box.GetMax(), high, 1e-5) is False:
        failed.append(f"{m.GetPath()}: its extent is not that of its points")
for m in bodies:
    indices, points = m.GetFaceVertexIndicesAttr().Get(), [Gf.Vec3d(p) for p in m.GetPointsAttr().Get()]
    triangles = [tuple(indices[i:i + 3]) for i in range(0, len(indices), 3)]
    edges = {(t[i], t[(i + 1) % 3]) for t in triangles for i in range(3)}
    if len(edges) != 3 * len(triangles) or any((b, a) not in edges for a, b in edges):
        failed.append(f"{m.GetPath()}: not closed")
    for a, b, c in triangles:
        normal = Gf.Cross(points[b] - points[a], points[c] - points[a]).GetNormalized()
        if max(Gf.Dot(p - points[a], normal) for p in points) > 1e-3:
            failed.append(f"{m.GetPath()}: not convex")
            break
    if UsdPhysics.MeshCollisionAPI(m.GetPrim()).GetApproximationAttr().Get() != "convexHull" or m.GetPurposeAttr().Get() != "guide":
        failed.append(f"{m.GetPath()}: no convex hull to simulators, or shown by renderers")
collision = folder / "scene_collision.glb"
if collision.exists():
    data = collision.read_bytes()
    nodes = json.loads(data[20:20 + struct.unpack_from("<I", data, 12)[0]])["nodes"]
    found = sum(n["name"].startswith("UCX_") for n in nodes)
    print(f"{len(bodies)} convex bodies of {len(shown)} objects")
    if found != len(bodies):
        failed.append(f"{len(bodies)} convex bodies in scene.usda, {found} in scene_collision.glb")

lamps = {l["id"]: l for l in json.loads((out / "lights.json").read_text())["lights"] if l["kind"] != "portal"}
seen = set()
for prim in stage.Traverse():
    if not prim.HasAPI(UsdLux.LightAPI) or prim.IsA(UsdLux.DomeLight):
        continue
    lamp = lamps[int(prim.GetName().split("_")[-1])]
    seen.add(lamp["id"])
    watts = power(prim)
    wrong = max(abs(a - b) / max(b, 1e-20) for a, b in zip(watts, lamp["power"]) if b > 0)
    to_world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    off = (to_world.ExtractTranslation() - Gf.Vec3d(*lamp["centre"])).GetLength()
    print(f"{prim.GetName():12} {prim.GetTypeName():12} area {area(prim):8.4f} m2, power off by {wrong:.1e}, {off:.3f} m from its lamp's centre")
    if wrong > 1e-4:
        failed.append(f"{prim.GetName()}: power {watts}, lights.json has {lamp['power']}")
dark = {i for i, l in lamps.items() if max(l["power"]) <= 0}
if seen | dark != set(lamps):
    failed.append(f"lamps without a light: {sorted(set(lamps) - seen - dark)}")
domes = [p for p in stage.Traverse() if p.IsA(UsdLux.DomeLight)]
if len(domes) != (folder / "usd_environment.exr").exists():
    failed.append("the dome is there without its panorama, or missing")
print(f"{len(meshes)} meshes, {count} triangles, {len(seen)} lights, {len(domes)} dome")
for f in failed:
    print("FAILED:", f)
sys.exit(bool(failed))
