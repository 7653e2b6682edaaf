"""Writes tests/files/usd anew with usd-core: a room as RoomPlan exports it, as text, binary and archive, and a
stage composed in all ways that the reader knows, whose area and bounds it prints for `usd_tests.rs`.

usage: python scripts/make_usd_files.py [FOLDER]   (default: tests/files/usd; needs usd-core)
"""
import pathlib
import sys

from pxr import Gf, Sdf, Usd, UsdGeom, UsdUtils

QUADS = 5


def part(path):
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    sofa = UsdGeom.Xform.Define(stage, "/Sofa")
    stage.SetDefaultPrim(sofa.GetPrim())
    UsdGeom.Cube.Define(stage, "/Sofa/Sofa1").CreateSizeAttr(2.0)
    stage.GetRootLayer().Save()


def room(path, referenced):
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    top = UsdGeom.Xform.Define(stage, "/Room")
    stage.SetDefaultPrim(top.GetPrim())
    top.AddTranslateOp().Set(Gf.Vec3d(10, 0, 0.125))
    wall = UsdGeom.Cube.Define(stage, "/Room/Wall0")
    wall.CreateSizeAttr(1.0)
    wall.AddTransformOp().Set(Gf.Matrix4d(2, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0.5, 0, 0.3, 1.5, -2, 1))
    door = UsdGeom.Cube.Define(stage, "/Room/Door0")
    door.CreateSizeAttr(1.0)
    door.AddScaleOp().Set(Gf.Vec3f(1, 2, 0.25))
    door.AddRotateYOp().Set(30.0)
    floor = UsdGeom.Mesh.Define(stage, "/Room/Floor0")
    row = QUADS + 1
    grid = [(i, j) for j in range(row) for i in range(row)]
    corners = [j * row + i for i, j in grid if i < QUADS and j < QUADS]
    floor.CreatePointsAttr([(i * 0.37, 0.01 * i * j, j * 0.5) for i, j in grid])
    floor.CreateFaceVertexCountsAttr([4] * len(corners))
    floor.CreateFaceVertexIndicesAttr([k for a in corners for k in (a, a + row, a + row + 1, a + 1)])
    floor.GetPrim().SetCustomDataByKey("Category", "floor")
    floor.GetPrim().SetCustomDataByKey("deep:n", 3)
    stage.CreateClassPrim("/Nothing")
    sofa = UsdGeom.Xform.Define(stage, "/Room/Sofa0")
    sofa.GetPrim().GetReferences().AddReference("./" + referenced)
    sofa.AddTranslateOp().Set(Gf.Vec3d(0, 0, 7))
    stage.GetRootLayer().Save()


def square(stage, path, side=1.0):
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr([(0, 0, 0), (side, 0, 0), (side, side, 0), (0, side, 0)])
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    return mesh


def variants(stage):
    sofa = UsdGeom.Xform.Define(stage, "/Room/Sofa").GetPrim()
    sets = sofa.GetVariantSets().AddVariantSet("size")
    for name, side in (("small", 1.0), ("large", 2.0)):
        sets.AddVariant(name)
        sets.SetVariantSelection(name)
        with sets.GetVariantEditContext():
            square(stage, "/Room/Sofa/g", side)
            sofa.CreateAttribute("size", Sdf.ValueTypeNames.Double).Set(side)
    sets.SetVariantSelection("small")


def copies(stage):
    """Twenty of 22 copies: enough that arrays are packed."""
    instancer = UsdGeom.PointInstancer.Define(stage, "/Room/Chairs")
    square(stage, "/Room/Chairs/protos/Chair0", 0.5).AddRotateZXYOp().Set(Gf.Vec3f(10, 20, 30))
    instancer.CreatePrototypesRel().AddTarget("/Room/Chairs/protos/Chair0")
    count = 22
    instancer.CreatePositionsAttr([(i, 0.25 * i, 3) for i in range(count)])
    instancer.CreateScalesAttr([(1, 1 + 0.1 * i, 1) for i in range(count)])
    # of length 1 in half precision too: usd-core does not normalise
    instancer.CreateOrientationsAttr([Gf.Quath(0.5, 0.5, -0.5, 0.5)] * count)
    instancer.CreateProtoIndicesAttr([0] * count)
    instancer.CreateIdsAttr([100 * i * i for i in range(count)])
    instancer.CreateInvisibleIdsAttr([0, 100 * 21 * 21])


def composed(path):
    form = path.suffix[1:]
    below = Usd.Stage.CreateNew(str(path.with_name(f"below.{form}")))
    UsdGeom.Xform.Define(below, "/Room").AddTranslateOp().Set(Gf.Vec3d(0, 0, 5))
    square(below, "/Room/Wall0", 4.0)
    below.CreateClassPrim("/_chair")
    square(below, "/_chair/Chair0")
    below.GetRootLayer().Save()
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().subLayerPaths.append(f"./below.{form}")
    inherits = UsdGeom.Xform.Define(stage, "/Room/inherits")
    inherits.GetPrim().GetInherits().AddInherit("/_chair")
    inherits.AddOrientOp().Set(Gf.Quatf(Gf.Rotation(Gf.Vec3d(1, 2, 3), 70).GetQuat()))
    for i in range(2):
        again = UsdGeom.Xform.Define(stage, f"/Room/again{i}")
        again.AddTranslateOp().Set(Gf.Vec3d(-2 * i, 0, 1))
        again.GetPrim().GetReferences().AddInternalReference("/Room/inherits")
    stage.DefinePrim("/Room/payload").GetPayloads().AddPayload(f"./below.{form}", "/Room/Wall0")
    reset = square(stage, "/Room/reset")
    reset.SetResetXformStack(True)
    pivot = square(stage, "/Room/pivot")
    pivot.AddTranslateOp(opSuffix="pivot").Set(Gf.Vec3d(1, 0, 0))
    pivot.AddRotateYOp().Set(90)
    pivot.AddTranslateOp(opSuffix="pivot", isInverseOp=True)
    moving = square(stage, "/Room/moving").AddTranslateOp()
    for time in (1, 2):
        moving.Set(Gf.Vec3d(10 * time, 0, 0), time)
    square(stage, "/Room/unseen", 50.0).MakeInvisible()
    square(stage, "/Room/off", 50.0).GetPrim().SetActive(False)
    variants(stage)
    copies(stage)
    stage.GetRootLayer().Save()


def corners(mesh, matrix):
    points = [matrix.Transform(Gf.Vec3d(p)) for p in mesh.GetPointsAttr().Get(Usd.TimeCode.EarliestTime())]
    assert len(points) == 4
    return points


def measure(path):
    """Area and bounds by usd-core; every face is a flat quad."""
    stage, faces = Usd.Stage.Open(str(path)), []
    time = Usd.TimeCode.EarliestTime()
    for prim in stage.Traverse():
        inside = any(UsdGeom.PointInstancer(stage.GetPrimAtPath(a)) for a in prim.GetPath().GetAncestorsRange())
        if prim.IsA(UsdGeom.Mesh) and not inside and UsdGeom.Imageable(prim).ComputeVisibility() != "invisible":
            faces.append(corners(UsdGeom.Mesh(prim), UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)))
    instancer = UsdGeom.PointInstancer.Get(stage, "/Room/Chairs")
    world = instancer.ComputeLocalToWorldTransform(time)
    chair = UsdGeom.Mesh.Get(stage, "/Room/Chairs/protos/Chair0")
    faces += [corners(chair, m * world) for m in instancer.ComputeInstanceTransformsAtTime(time, time)]
    area = sum(Gf.Cross(f[1] - f[0], f[3] - f[0]).GetLength() for f in faces)
    least, greatest = ([pick(p[i] for f in faces for p in f) for i in range(3)] for pick in (min, max))
    print(f"{path}: area {area:.9f} from {least} to {greatest}")


folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "tests/files/usd")
folder.mkdir(parents=True, exist_ok=True)
for form in ("usda", "usdc"):
    for name in ("part", "room", "below", "composed"):
        (folder / f"{name}.{form}").unlink(missing_ok=True)
    part(folder / f"part.{form}")
    room(folder / f"room.{form}", f"part.{form}")
    composed(folder / f"composed.{form}")
    measure(folder / f"composed.{form}")
UsdUtils.CreateNewUsdzPackage(str(folder / "room.usdc"), str(folder / "room.usdz"))
