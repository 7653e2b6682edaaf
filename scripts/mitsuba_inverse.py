#!/usr/bin/env python3
"""The same reconstruction by Mitsuba 3 (differentiable path tracing, `prb`) beside unbake's: quality against processor time.

    scripts/mitsuba_inverse.py UNBAKE SCENE OUT FOLDER [--minutes M] [--beside OUT2 …]
    scripts/mitsuba_inverse.py UNBAKE SCENE OUT FOLDER --self-test

SCENE has panoramas and ground truth (gt/), OUT is UNBAKE's result for it. FOLDER gets the exported scene, the textures and
curve.json: {"unbake": {…}, "mitsuba": [{"seconds", "albedo", "roughness", …}], "ratio_at_equal": {"albedo", "roughness"}}.

Both programs have the same mesh, atlas, training views and reflection model. Mitsuba starts from albedo 0.5 and roughness 0.5 and is
*given* the lamps and the environment that unbake found (--light truth: those of the scene, where gt/solution has them), on which the
published systems spend a stage of their own; --emission makes what the lamps emit a third unknown, which surfaces are lamps stays
given. Each step draws random pixels of all training views. Every few minutes the textures are laid into a copy of OUT and scored by
`unbake eval`, on held-out views, as OUT is. Only the optimisation's own processor time counts, of all threads, as `cpu_seconds` in
unbake's manifest.json; loading and scoring are free. Texels that no path has reached take the mean of those beside them.
A ratio is Mitsuba's time, between two scores by a straight line, over unbake's; null where Mitsuba has not got there.

The defaults are the best of what was tried for 2 minutes each on `synth --rooms 1 --views 8 --test-views 2 --width 256 --spp 16
--texture 512`, 448² texels (albedo / roughness in dB):
  finest textures from the start, 65536 pixels a step, 4 paths a pixel, rate 0.02            15.7 / 10.9
  three levels of textures, 1 path, rate 0.05; also with epsilon 0.03                        18.3 / 9.2, 18.7 / 9.1
  five levels, roughness 4 times coarser, rate 0.05 to 0.001, means of the last 20 steps     23.8 / 10.5
  the same, roughness 8 times coarser, rate to 0.0025                                        23.2 / 10.8
  the same, weights of the relative error (--power 1.6), rate to 0.001                       23.1 / 9.2
  the same, 16384 pixels a step, power 1.1, rate 0.03 to 0.0006, twice that for roughness    24.0 / 11.7

Needs mitsuba and numpy (python3 -m venv V && V/bin/pip install mitsuba numpy && V/bin/python scripts/mitsuba_inverse.py …) and LLVM,
17 or newer with AVX-512 (apt-get install libllvm19); the newest found is used unless DRJIT_LIBLLVM_PATH names one.
"""
import argparse, glob, json, os, re, shutil, struct, subprocess, sys, time
from pathlib import Path


def fail(message):
    print(f"mitsuba_inverse: {message}", file=sys.stderr)
    sys.exit(2)


def load_mitsuba():
    global np, mi, dr
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        found = [f for f in glob.glob("/usr/lib/*/libLLVM*.so*") if re.search(r"LLVM(-\d+\.so|\.so\.\d)", f)]
        version = lambda f: int(re.search(r"(?:LLVM-|so\.)(\d+)", f)[1])
        if found:
            os.environ["DRJIT_LIBLLVM_PATH"] = max(found, key=version)
    try:
        import numpy as np, mitsuba as mi, drjit as dr
    except ImportError as e:
        fail(f"{e}: python3 -m venv V && V/bin/pip install mitsuba numpy && V/bin/python {sys.argv[0]} …")
    if not dr.has_backend(dr.JitBackend.LLVM):
        fail("Mitsuba finds no LLVM: apt-get install libllvm19, or DRJIT_LIBLLVM_PATH=/path/to/libLLVM-19.so")
    mi.set_variant("llvm_ad_rgb")
    import mitsuba_plugins  # registers `unbake` and `pixels`


def read(path):
    return np.array(mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False))


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        fail(f"{' '.join(map(str, command))}\n{done.stderr.strip()}")


def display(x):
    """Values as the scores of pictures take them."""
    return np.clip(x, 0, 1) ** (1 / 2.2)


def enlarge(texture, height, width):
    """Bilinear, texel centres at halves."""
    for axis, n in ((0, height), (1, width)):
        at = np.clip((np.arange(n) + 0.5) * texture.shape[axis] / n - 0.5, 0, texture.shape[axis] - 1)
        low = at.astype(int)
        high, t = np.minimum(low + 1, texture.shape[axis] - 1), (at - low).reshape([-1 if k == axis else 1 for k in range(3)])
        texture = texture.take(low, axis) * (1 - t) + texture.take(high, axis) * t
    return texture.astype(np.float32)


def fill(texture, seen):
    """Texels that no step has moved take the mean of those beside them, ring by ring."""
    texture, seen = texture.copy(), seen.copy()
    while seen.any() and not seen.all():
        padded, weight = np.pad(texture * seen[..., None], ((1, 1), (1, 1), (0, 0))), np.pad(seen, 1).astype(np.float32)
        h, w = seen.shape
        total, count = 0, 0
        for dy in range(3):
            for dx in range(3):
                total, count = total + padded[dy:dy + h, dx:dx + w], count + weight[dy:dy + h, dx:dx + w]
        new = ~seen & (count > 0)
        texture[new] = total[new] / count[new][:, None]
        seen |= new
    return texture


def model_of(solution):
    """The reflection model that a result states in its scene.glb."""
    with open(solution / "scene.glb", "rb") as f:
        f.seek(12)
        length = struct.unpack("<I4x", f.read(8))[0]
        return json.loads(f.read(length))["nodes"][0].get("extras", {}).get("reflectance", "paper")


class Views:
    """The panoramas of a scene as arrays, reduced to at most `width` pixels."""

    def __init__(self, scene, names, width):
        given = json.loads((scene / "transforms.json").read_text())
        if given.get("camera_model") != "EQUIRECTANGULAR":
            fail(f"{scene}/transforms.json: camera_model {given.get('camera_model')}: only panoramas (EQUIRECTANGULAR) are compared")
        paths = {Path(f["file_path"]).stem: scene / f["file_path"] for f in given["frames"]}
        self.names, images = names, []
        for name in names:
            image = read(paths[name])
            k = max(1, image.shape[1] // width)
            h, w = image.shape[0] // k * k, image.shape[1] // k * k
            images.append(image[:h, :w].reshape(h // k, k, w // k, k, 3).mean((1, 3)))
        self.images = np.stack(images)
        self.height, self.width = self.images.shape[1:3]
        self.stored = mi.Float(self.images.ravel())

    def draw(self, random, count):
        """Pixels evenly over all directions of all views."""
        view = random.integers(len(self.names), size=count)
        row = np.minimum(np.arccos(random.uniform(-1, 1, count)) / np.pi * self.height, self.height - 1)
        return view, random.integers(self.width, size=count), row.astype(int)

    def light(self, sensor, shape):
        i = (sensor.view * self.height + sensor.row) * self.width + sensor.column
        return mi.TensorXf(dr.ravel(dr.gather(mi.Color3f, self.stored, i)), shape)


class Room:
    """A result of unbake in Mitsuba."""

    def __init__(self, a, solution, views, flat=False):
        self.folder, self.solution = a.folder / "mitsuba", solution
        run(a.unbake, "export", solution, "--format", "mitsuba", "--scene", a.scene, "--views", views, "--fov", 90,
            "--width", 16, "--height", 16, "-o", self.folder, "--quiet")
        xml = (self.folder / "mitsuba.xml").read_text()
        self.model = model_of(solution)
        if a.bsdf == "unbake":
            wrapper = r'<bsdf type="twosided" id="material">\s*<bsdf type="principled">(.*?)<float name="specular" value="0.5"/>\s*</bsdf>'
            xml, found = re.subn(wrapper, rf'<bsdf type="unbake" id="material"><string name="model" value="{self.model}"/>\1', xml, flags=re.S)
            if not found or "mitsuba_metallic" in xml:
                fail(f"{solution}: has metal or panes, which the comparison's material has not; --bsdf principled takes what is exported")
        if flat:
            xml = xml.replace('<ref id="material" name="bsdf"/>', '<boolean name="face_normals" value="true"/>\n<ref id="material" name="bsdf"/>')
            xml = xml.replace('<boolean name="face_normals" value="true"/>\n    <boolean', "<boolean")
        (self.folder / "scene.xml").write_text(xml)
        self.world = mi.load_file(str(self.folder / "scene.xml"))
        self.params = mi.traverse(self.world)
        key = lambda end: next((k for k in self.params.keys() if k.endswith(end)), None)
        self.albedo, self.roughness, self.emission = key("base_color.data"), key("roughness.data"), key("radiance.data")
        self.poses = {s.id(): self.pose(s) for s in self.world.sensors()}

    @staticmethod
    def pose(sensor):
        """world_from_camera with x to the right, y up, looking along −z."""
        m = np.array(mi.traverse(sensor)["to_world"].matrix).reshape(4, 4)[:3]
        return m * [-1, 1, -1, 1]

    def sensor(self, views, shape):
        height, width = shape[:2]
        sensor = mi.load_dict({"type": "pixels", "sampler": {"type": "independent"},
                               "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"},
                                        "pixel_format": "rgb", "component_format": "float32"}})
        sensor.place(np.stack([self.poses[n] for n in views.names]), views.width, views.height)
        return sensor


class Descent:
    """Adam on albedo and roughness (and, if asked, log emission) from grey, coarse textures first."""

    def __init__(self, a, room, views):
        self.a, self.room, self.views = a, room, views
        self.integrator = mi.load_dict({"type": "prb", "max_depth": a.depth})
        self.shape = (max(1, a.pixels // 256), 256, 3)
        self.sensor = room.sensor(views, self.shape)
        self.random, self.steps, self.side = np.random.default_rng(0), 0, 0
        self.last = {room.albedo: np.full((1, 1, 3), 0.5, np.float32), room.roughness: np.full((1, 1, 1), 0.5, np.float32)}
        self.factors = {"log": a.emission_rate, room.roughness: a.roughness_rate}
        if a.emission:
            self.last["log"] = np.zeros((1, 1, 3), np.float32)

    def begin(self, side):
        """Goes on with textures of side x side texels."""
        if self.side:
            self.last = self.textures()
        self.side = side
        sides = {k: max(2, side >> (self.a.roughness_levels if k == self.room.roughness else 0)) for k in self.last}
        self.start = {k: enlarge(t, sides[k], sides[k]) for k, t in self.last.items()}
        # steps of Adam do not depend on the gradient's size but for epsilon, of a sum over pixels here
        self.adam = mi.ad.Adam(lr=self.a.rate, mask_updates=True, epsilon=self.a.epsilon)
        for key, t in self.start.items():
            self.adam[key] = mi.TensorXf(t)
        self.mean = {k: mi.TensorXf(t) for k, t in self.start.items()}
        self.apply()

    def apply(self):
        for key in (self.room.albedo, self.room.roughness):
            self.adam[key] = dr.clip(self.adam[key], 0 if key == self.room.albedo else 0.05, 1)
            self.room.params[key] = self.adam[key]
        if self.a.emission:
            self.room.params[self.room.emission] = dr.exp(self.adam["log"])
        self.room.params.update()

    def step(self, rate):
        self.sensor.aim(*self.views.draw(self.random, self.shape[0] * self.shape[1]))
        self.adam.set_learning_rate({k: rate * self.factors.get(k, 1) for k in self.start})
        image = mi.render(self.room.world, self.room.params, sensor=self.sensor, integrator=self.integrator,
                          spp=self.a.spp, spp_grad=self.a.spp_grad, seed=2 * self.steps, seed_grad=2 * self.steps + 1)
        target = self.views.light(self.sensor, self.shape)
        # weights of the target alone keep the gradient unbiased: the image is noisy, its square is not met by its own adjoint
        weight = dr.power(dr.maximum(target, 1e-2), -self.a.power)
        dr.backward(dr.sum(weight * dr.square(image - target), axis=None))
        self.adam.step()
        self.apply()
        for k in self.mean:
            self.mean[k] = self.mean[k] + (dr.detach(self.adam[k]) - self.mean[k]) / min(self.a.average, self.steps + 1)
        dr.eval(self.mean, {k: self.adam[k] for k in self.start})
        dr.sync_thread()
        self.steps += 1

    def textures(self):
        """Means of the last steps' textures, unmoved texels from those beside them."""
        found = {}
        for key, first in self.start.items():
            now = np.array(self.adam[key])
            found[key] = fill(np.array(self.mean[key]), (now != first).any(-1))
        return found


def scores(unbake, scene, result):
    run(unbake, "eval", result, "--scene", scene, "--quiet")
    test = json.loads((result / "eval/metrics.json").read_text())["test"]
    if not test or not test.get("materials"):
        fail(f"{scene}: no ground truth (gt/albedo, gt/roughness) of held-out views; materials cannot be scored")
    kinds = {"albedo": "linear", "roughness": "fipt"}
    return {k: round(test["materials"][k][protocol]["psnr_of_mean_mse"], 2) for k, protocol in kinds.items()}


def reached(curve, key, level):
    """Seconds at which a curve first has a score, straight between its points; None if it never has."""
    before = None
    for point in curve:
        if point[key] >= level:
            if before is None:
                return point["seconds"]
            t = (level - before[key]) / (point[key] - before[key])
            return before["seconds"] + t * (point["seconds"] - before["seconds"])
        before = point
    return None


def unbakes(a, out):
    """Processor time and scores of a result of unbake."""
    seconds = round(json.loads((out / "manifest.json").read_text())["cpu_seconds"], 1)
    return {"result": out.name, "seconds": seconds} | scores(a.unbake, a.scene, out)


def line(name, p):
    print(f"{name:20} {p['seconds']:9.1f} {p.get('steps', ''):>6} {p['albedo']:7.2f} dB {p['roughness']:7.2f} dB", flush=True)


def ratios(ours, curve, minutes):
    """Mitsuba's time over unbake's at unbake's scores, None where it has not got there; prints them."""
    found = {}
    for key in ("albedo", "roughness"):
        seconds, best = reached(curve, key, ours[key]), max(p[key] for p in curve)
        found[key] = None if seconds is None else round(seconds / ours["seconds"], 2)
        says = f"{seconds:.0f} s, {found[key]:.1f} times unbake's" if seconds is not None else \
            f"not reached within {minutes:g} min, best {best:.2f} dB (more than {curve[-1]['seconds'] / ours['seconds']:.0f} times unbake's)"
        print(f"{ours['result']}: {key} of {ours[key]:.2f} dB: {says}")
    return found


def descend(a, room, views):
    """The curve, scored by `unbake eval` on a copy of the result with the textures found."""
    copy = a.folder / "textures"
    copy.mkdir(exist_ok=True)
    for f in a.out.iterdir():
        if f.is_file():
            shutil.copy(f, copy)
    sides = {n: mi.Bitmap(str(a.out / f"{n}.exr")).size() for n in ("albedo", "roughness")}
    final = a.texture or int(sides["albedo"][0])
    levels = [(k / a.levels, max(2, final >> (a.levels - 1 - k))) for k in range(a.levels)]
    settings = {k: str(v) if isinstance(v, Path) else v for k, v in vars(a).items() if k not in ("unbake", "folder", "beside", "self_test")}
    all_ours = [unbakes(a, out) for out in [a.out, *a.beside]]
    result = {"unbake": all_ours[0], "beside": all_ours[1:], "mitsuba": [], "ratio_at_equal": {},
              "settings": settings | {"version": mi.__version__}}
    print(f"{'':20} {'processor':>9}  steps     albedo  roughness", flush=True)
    for ours in all_ours:
        line("unbake " + ours["result"], ours)
    descent = Descent(a, room, views)

    def score(spent, clock):
        found = descent.textures()
        for key, name in ((room.albedo, "albedo"), (room.roughness, "roughness")):
            width, height = sides[name]
            mi.Bitmap(np.ascontiguousarray(enlarge(found[key], height, width))).write(str(copy / f"{name}.exr"))
        point = {"seconds": round(spent, 1), "wall_seconds": round(clock, 1), "steps": descent.steps, "texture": descent.side}
        result["mitsuba"].append(point | scores(a.unbake, a.scene, copy))
        line("mitsuba", result["mitsuba"][-1])
        (a.folder / "curve.json").write_text(json.dumps(result, indent=1) + "\n")

    # scores at ever longer times up to --every: much happens in the first seconds
    total, spent, clock, due = 60 * a.minutes, 0.0, 0.0, 60 * a.every / 8
    descent.begin(levels.pop(0)[1])
    score(0, 0)
    while spent < total:
        start, wall = time.process_time(), time.perf_counter()
        if levels and spent >= levels[0][0] * total:
            descent.begin(levels.pop(0)[1])
        descent.step(a.rate * a.decay ** (spent / total))
        spent, clock = spent + time.process_time() - start, clock + time.perf_counter() - wall
        if spent >= due or spent >= total:
            due = min(2 * due, due + 60 * a.every)
            score(spent, clock)
    result["ratio_at_equal"] = ratios(all_ours[0], result["mitsuba"], a.minutes)
    for ours in all_ours[1:]:
        ours["ratio_at_equal"] = ratios(ours, result["mitsuba"], a.minutes)
    (a.folder / "curve.json").write_text(json.dumps(result, indent=1) + "\n")


def check_alike(room, views):
    """Refuses a scene whose rendering does not resemble the photographs."""
    shape = (16, 128, 3)
    sensor = room.sensor(views, shape)
    sensor.aim(*views.draw(np.random.default_rng(1), shape[0] * shape[1]))
    shown = mi.render(room.world, sensor=sensor, integrator=mi.load_dict({"type": "prb", "max_depth": 8}), spp=256)
    pair = [display(np.array(x)).ravel() for x in (shown, views.light(sensor, shape))]
    alike = np.corrcoef(*pair)[0, 1]
    print(f"{room.solution} in Mitsuba against the photographs: correlation {alike:.3f}", flush=True)
    if not alike > 0.8:
        fail("the correlation must exceed 0.8: axes, poses or lamps are not the same in both")


class Checks:
    """Prints checks and remembers whether one failed."""

    def __init__(self):
        self.failed = False

    def say(self, fine, text):
        self.failed |= not fine
        print("ok    " if fine else "FAILED", text, flush=True)


def check_gradient(checks, room, views, name, key):
    """The derivative of the mean image in one texel of an 8 x 8 texture: `prb` against central differences of renderings."""
    shape, step, runs = (32, 64, 3), 0.1, 16
    sensor = room.sensor(views, shape)
    sensor.aim(*views.draw(np.random.default_rng(2), shape[0] * shape[1]))
    integrator = mi.load_dict({"type": "prb", "max_depth": 8})
    texture = np.full((8, 8, room.params[key].shape[2]), 0.5, np.float32)

    def mean(values, seed):
        room.params[key] = mi.TensorXf(values)
        room.params.update()
        return float(np.array(mi.render(room.world, sensor=sensor, integrator=integrator, spp=32, seed=seed)).mean())

    def gradient(seed):
        room.params[key] = mi.TensorXf(texture)
        dr.enable_grad(room.params[key])
        room.params.update()
        image = mi.render(room.world, room.params, sensor=sensor, integrator=integrator, spp=32, seed=seed, seed_grad=1000 + seed)
        dr.backward(dr.mean(image, axis=None))
        return np.array(dr.grad(room.params[key]))

    by_prb = np.stack([gradient(k) for k in range(runs)])
    at = np.unravel_index(np.abs(by_prb.mean(0)).argmax(), texture.shape)
    change = np.zeros_like(texture)
    change[at] = step
    differences = np.array([(mean(texture + change, k) - mean(texture - change, k)) / (2 * step) for k in range(runs)])
    dr.disable_grad(room.params[key])
    values = [by_prb[(slice(None), *at)], differences]
    (a, b), (ea, eb) = [v.mean() for v in values], [v.std(ddof=1) / runs ** 0.5 for v in values]
    error = (ea * ea + eb * eb) ** 0.5
    # the curvature in a texel: a per cent or two of the slope at this step
    fine = abs(a - b) < 4 * error + 0.03 * abs(b) and error < 0.15 * abs(b)
    checks.say(fine, f"gradient of one texel of {name}: prb {a:.3e} ± {ea:.1e}, central differences {b:.3e} ± {eb:.1e}")


def check_rendering(checks, a, solution):
    """Mitsuba's rendering of a result against `unbake render` of the same cameras: Welch's t per block of 8 x 8 pixels, and the mean."""
    runs, spp, width, block = 6, 64, 128, 8
    room = Room(a, solution, "test", flat=True)
    names = sorted(room.poses)[:2]
    views = Views(a.scene, names, width)
    height, width = views.height, views.width
    shape = (len(names) * height, width, 3)
    sensor = room.sensor(views, shape)
    view, row, column = np.meshgrid(range(len(names)), range(height), range(width), indexing="ij")
    sensor.aim(view.ravel(), column.ravel(), row.ravel())
    integrator = mi.load_dict({"type": "path", "max_depth": 65})
    both = [[], []]
    for k in range(runs):
        both[0].append(np.array(mi.render(room.world, sensor=sensor, integrator=integrator, spp=spp, seed=k)))
        frames = a.folder / "rendered"
        run(a.unbake, "render", solution, "--scene", a.scene, "--renderer", "path", "--flat", "--no-denoise", "--samples", spp,
            "--width", width, "--seed", k + 1, "-o", frames, "--quiet")
        both[1].append(np.concatenate([read(frames / f"{n}.exr") for n in names]))
    theirs, ours = (np.stack(x) for x in both)
    blocks = lambda x: x.reshape(runs, shape[0] // block, block, width // block, block, 3).mean((2, 4, 5))
    t = [x.mean(0) for x in (blocks(theirs), blocks(ours))]
    error = np.sqrt(sum(blocks(x).var(0, ddof=1) / runs for x in (theirs, ours)))
    t = (t[0] - t[1]) / np.maximum(error, 1e-9)
    spread, outside = np.subtract(*np.percentile(t, [75, 25])) / 1.349, (np.abs(t) > 4).mean()
    relative = theirs.mean() / ours.mean() - 1
    # of t with some 10 degrees of freedom the spread is 1.04, beyond 4 lie 0.3 %
    fine = spread < 1.4 and outside < 0.02 and abs(relative) < 0.01
    checks.say(fine, f"Mitsuba's rendering against unbake's: spread of t {spread:.2f}, {100 * outside:.1f} % of {t.size} blocks beyond 4, "
               f"mean {100 * relative:+.2f} %")


def self_test(a, solution):
    checks = Checks()
    room = Room(a, solution, "train")
    views = Views(a.scene, sorted(room.poses), a.width)
    check_alike(room, views)
    for name, key in (("albedo", room.albedo), ("roughness", room.roughness)):
        check_gradient(checks, room, views, name, key)
    check_rendering(checks, a, solution)
    sys.exit(1 if checks.failed else 0)


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("unbake", help="the program")
    p.add_argument("scene", type=Path, help="with ground truth (gt/)")
    p.add_argument("out", type=Path, help="UNBAKE's result for it")
    p.add_argument("folder", type=Path, help="gets the exported scene, the textures and curve.json")
    p.add_argument("--self-test", action="store_true", help="instead: gradients against central differences, and the rendering of OUT "
                   "against `unbake render`, within noise; some two minutes; exit code 1 if they do not agree")
    p.add_argument("--minutes", type=float, default=20, help="processor time of the optimisation [%(default)s]")
    p.add_argument("--every", type=float, default=2, help="minutes between scores [%(default)s]")
    p.add_argument("--beside", type=Path, nargs="+", default=[], help="further results of UNBAKE for SCENE, whose ratios are wanted too")
    p.add_argument("--bsdf", choices=("unbake", "principled"), default="unbake",
                   help="the reflection model that OUT found, or Mitsuba's own for every export [%(default)s]")
    p.add_argument("--light", choices=("unbake", "truth"), default="unbake", help="whose lamps and environment are given [%(default)s]")
    p.add_argument("--emission", action="store_true", help="optimise what the lamps emit, from radiance 1")
    p.add_argument("--emission-rate", type=float, default=3, help="rate of the emission's logarithm over albedo's [%(default)s]")
    p.add_argument("--texture", type=int, default=0, help="side of the finest albedo texture [as OUT's]")
    p.add_argument("--levels", type=int, default=5, help="sides of textures, each twice the one before, for equal times [%(default)s]")
    p.add_argument("--roughness-levels", type=int, default=2, help="how many times roughness is halved below albedo [%(default)s]")
    p.add_argument("--width", type=int, default=512, help="panoramas are reduced to this width at most, as the paper's [%(default)s]")
    p.add_argument("--pixels", type=int, default=16384, help="pixels a step [%(default)s]")
    p.add_argument("--spp", type=int, default=1, help="paths a pixel of the rendering [%(default)s]")
    p.add_argument("--spp-grad", type=int, default=1, help="paths a pixel of the gradient [%(default)s]")
    p.add_argument("--depth", type=int, default=8, help="longest path, in segments [%(default)s]")
    p.add_argument("--rate", type=float, default=3e-2, help="of Adam, at first [%(default)s]")
    p.add_argument("--decay", type=float, default=0.02, help="the last rate over the first [%(default)s]")
    p.add_argument("--roughness-rate", type=float, default=2, help="rate of roughness over albedo's [%(default)s]")
    p.add_argument("--epsilon", type=float, default=0.1, help="of Adam, for a sum over pixels [%(default)s]")
    p.add_argument("--power", type=float, default=1.1, help="squared differences are divided by the photograph's value to this power; "
                   "1.1 is that of differences in the display's values [%(default)s]")
    p.add_argument("--average", type=int, default=50, help="steps whose textures' mean is scored [%(default)s]")
    return p.parse_args()


def main():
    a = arguments()
    for given in (a.scene / "transforms.json", *(out / "manifest.json" for out in [a.out, *a.beside])):
        if not given.is_file():
            fail(f"{given}: missing; expected a scene folder and results of `unbake solve`")
    solution = a.out
    if a.light == "truth":
        solution = a.scene / "gt/solution"
        if not (solution / "scene.glb").is_file():
            fail(f"{solution}: missing; --light truth needs a scene of `unbake synth --truth`")
    if not a.self_test and not all(any((a.scene / f"gt/{n}").glob("*.exr")) for n in ("albedo", "roughness")):
        fail(f"{a.scene}: no ground truth (gt/albedo, gt/roughness), by which materials are scored")
    if not shutil.which(a.unbake):
        fail(f"{a.unbake}: no program; expected unbake's, of the build that made {a.out}")
    load_mitsuba()
    a.folder.mkdir(parents=True, exist_ok=True)
    if a.self_test:
        self_test(a, solution)
    room = Room(a, solution, "train")
    if a.emission and not room.emission:
        fail(f"{solution}: no lamps, so that --emission has nothing to find")
    views = Views(a.scene, sorted(room.poses), a.width)
    check_alike(room, views)
    given = "lamps as surfaces, environment" if a.emission else "lamps, environment"
    print(f"given to Mitsuba: mesh, atlas, poses, {given} (of {solution}), reflection model "
          f"({'principled' if a.bsdf == 'principled' else room.model}); "
          f"found: albedo, roughness{', emission' if a.emission else '; emission is not optimised'}", flush=True)
    descend(a, room, views)


if __name__ == "__main__":
    main()
