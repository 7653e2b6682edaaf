"""Opens the scene.usda of `export --lightings` with Pixar's library: every lighting of manifest.json is a variant, `traced` and `baked`; all
files that they refer to are there; the material has a surface; lamps have the power that the manifest states and are in `traced` alone.
Usage: usd_lightings.py FOLDER"""
import json, sys
from pathlib import Path
from pxr import Usd, UsdLux, UsdShade
from usd_checks import complaints, power

folder = Path(sys.argv[1])
manifest = json.loads((folder / "manifest.json").read_text())
stage = Usd.Stage.Open(str(folder / manifest["usd"]))
scene = stage.GetDefaultPrim()
lightings = scene.GetVariantSets().GetVariantSet("lighting")
failed = []


found = {}
for variant in lightings.GetVariantNames():
    lightings.SetVariantSelection(variant)
    name = scene.GetCustomDataByKey("lighting") or "unlit"
    found[name] = variant
    for shown in (["traced", "baked"] if name != "unlit" else [None]):
        if shown:
            scene.GetVariantSets().GetVariantSet("shown").SetVariantSelection(shown)
        surface, _, _ = UsdShade.Material(stage.GetPrimAtPath("/scene/material")).ComputeSurfaceSource()
        if not surface:
            failed.append(f"{name}, {shown}: the material has no surface")
        lost = [a.Get().path for p in stage.Traverse() for a in p.GetAttributes() if a.GetTypeName() == "asset" and a.Get() and not a.Get().resolvedPath]
        failed += [f"{name}, {shown}: {path} is not there" for path in lost]
        lamps = {p.GetName().split("_")[-1]: p for p in stage.Traverse() if p.HasAPI(UsdLux.LightAPI) and not p.IsA(UsdLux.DomeLight) and not p.GetName().startswith("added")}
        if shown != "traced":
            failed += [f"{name}, {shown}: {p.GetName()} shines" for p in lamps.values()]
            continue
        stated = next(v for v in manifest["variants"] if v["name"] == name)["lamps"]
        for lamp in stated:
            expected, prim = lamp["power"], lamps.get(str(lamp["id"]))
            got = power(prim) if prim else [0.0] * 3
            if lamps and any(abs(a - b) > 1e-4 * max(max(expected), 1e-20) for a, b in zip(got, expected)):
                failed.append(f"{name}: lamp {lamp['id']} has the power {got}, manifest.json states {expected}")
missing = {v["name"] for v in manifest["variants"]} | {"unlit"}
failed += [f"{name} is no variant" for name in missing - set(found)]
for file in [manifest["usd"], "unlit.usda"] + [v["usd"] for v in manifest["variants"]]:
    failed += complaints(folder / file)
print(f"{len(found)} variants: {', '.join(sorted(found))}")
for f in failed:
    print("FAILED:", f)
sys.exit(bool(failed))
