"""Open3D's RaycastingScene against unbake over the same rays on the same mesh; run by scripts/compare.

Arguments: the folder and the JSON file that `unbake bench irt --rates-only --export-rays` wrote. Prints medians of five runs, of Open3D
with the rays in our order (along a curve through each texel's hemisphere) and in the random order in which sample points are drawn.
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


def compared(name, ours, theirs):
    each = "   ".join(f"Open3D {order} {b * 1e-6:6.2f}, ratio {ours / b:4.2f}" for order, b in theirs.items())
    print(f"  {name:20} unbake {ours * 1e-6:6.2f}   {each}")


def as_drawn(rays):
    """The same rays, each texel's in random order: texels are runs of one origin."""
    new = np.any(rays[1:, :3] != rays[:-1, :3], axis=1)
    texel = np.concatenate([[0], np.cumsum(new)])
    return rays[np.lexsort((np.random.default_rng(1).random(len(rays)), texel))]


def main():
    folder, report = sys.argv[1:3]
    ours = json.load(open(report))
    positions = np.fromfile(f"{folder}/positions.f32", np.float32).reshape(-1, 3)
    triangles = np.fromfile(f"{folder}/triangles.u32", np.uint32).reshape(-1, 3)
    rays = np.fromfile(f"{folder}/rays.f32", np.float32).reshape(-1, 6)
    orders = {"our order": o3d.core.Tensor(rays), "as drawn": o3d.core.Tensor(as_drawn(rays))}
    threads = ours["threads"]
    scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
    scene.add_triangles(o3d.core.Tensor(positions), o3d.core.Tensor(triangles))
    n = len(rays)
    scene.cast_rays(orders["our order"])  # builds the acceleration structure
    theirs = {
        "closest hit": lambda r: scene.cast_rays(r, nthreads=threads),
        "any hit, same rays": lambda r: scene.test_occlusions(r, nthreads=threads),
    }
    theirs = {query: {order: rate(lambda: cast(r), n) for order, r in orders.items()} for query, cast in theirs.items()}
    print(f"{ours['scene']['name']}: {len(triangles)} triangles, {n} rays, {threads} threads of {ours['machine']['cpu']}")
    print(f"  unbake with Embree {ours['embree']}; Open3D {o3d.__version__}; Mray/s")
    for batch in ours["rates"]["batches"]:
        if batch["name"] in theirs:
            compared(batch["name"], batch["rays_per_second"], theirs[batch["name"]])
    compared("whole bake, to rays", ours["rates"]["estimators"][1]["rays_per_second"], theirs["closest hit"])


main()
