"""Writes tests/files/usd anew with usd-core: a room as RoomPlan exports it, as text, binary and archive.

usage: python scripts/make_usd_files.py [FOLDER]   (default: tests/files/usd; needs usd-core)
"""
import pathlib
import sys

from pxr import Gf, Usd, UsdGeom, UsdUtils

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


folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "tests/files/usd")
folder.mkdir(parents=True, exist_ok=True)
for form in ("usda", "usdc"):
    for name in ("part", "room"):
        (folder / f"{name}.{form}").unlink(missing_ok=True)
    part(folder / f"part.{form}")
    room(folder / f"room.{form}", f"part.{form}")
UsdUtils.CreateNewUsdzPackage(str(folder / "room.usdc"), str(folder / "room.usdz"))
