"""Open3D's RaycastingScene against unbake over the same rays on the same mesh; run by scripts/compare.

Arguments: the folder and the JSON file that `unbake bench irt --rates-only --export-rays` wrote. Prints medians of five runs.
"""

import json
import statistics
import sys
import time

import numpy as np
import open3d as o3d


def rate(function, count, repetitions=5):
    seconds = []
    for _ in range(repetitions):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return count / statistics.median(seconds)


def main():
    folder, report = sys.argv[1:3]
    ours = json.load(open(report))
    positions = np.fromfile(f"{folder}/positions.f32", np.float32).reshape(-1, 3)
    triangles = np.fromfile(f"{folder}/triangles.u32", np.uint32).reshape(-1, 3)
    rays = o3d.core.Tensor(np.fromfile(f"{folder}/rays.f32", np.float32).reshape(-1, 6))
    threads = ours["threads"]
    scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
    scene.add_triangles(o3d.core.Tensor(positions), o3d.core.Tensor(triangles))
    n = len(rays)
    scene.cast_rays(rays)  # builds the acceleration structure
    theirs = {
        "closest hit": rate(lambda: scene.cast_rays(rays, nthreads=threads), n),
        "any hit, same rays": rate(lambda: scene.test_occlusions(rays, nthreads=threads), n),
    }
    print(f"{ours['scene']['name']}: {len(triangles)} triangles, {n} rays, {threads} threads of {ours['machine']['cpu']}")
    print(f"  unbake with Embree {ours['embree']}; Open3D {o3d.__version__}; Mray/s")
    for batch in ours["rates"]["batches"]:
        if batch["name"] in theirs:
            a, b = batch["rays_per_second"], theirs[batch["name"]]
            print(f"  {batch['name']:20} unbake {a * 1e-6:7.2f}   Open3D {b * 1e-6:7.2f}   ratio {a / b:5.2f}")
    cosine = ours["rates"]["estimators"][1]["rays_per_second"]
    b = theirs["closest hit"]
    print(f"  {'whole bake':20} unbake {cosine * 1e-6:7.2f}   Open3D, rays only {b * 1e-6:.2f}   ratio {cosine / b:5.2f}")


main()
