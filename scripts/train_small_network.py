"""Small convolutional networks by numpy: depth and classes of panoramas. Called by scripts/train_small_network.

    train_small_network.py WORK ROOMS STEPS     trains on WORK/room1 … roomROOMS, writes WORK/depth.onnx and semantic.onnx
    train_small_network.py --bare FROM TO       a capture of photographs and poses alone
    train_small_network.py --scores WORK        what the networks got right, and what the results score

The network is U-shaped: 3x3 convolutions with ReLU at full, half and quarter size, sizes doubled by nearest
neighbour, finer features joined. The row of a pixel is a fourth channel (a constant of the graph). Adam (Kingma and Ba 2015).
"""

import json
import os
import sys

import numpy as np

WIDTH, HEIGHT = 128, 64
FEATURES = 16
MEAN, STD = np.float32([0.485, 0.456, 0.406]), np.float32([0.229, 0.224, 0.225])


def exr(path):
    import OpenEXR
    channels = OpenEXR.File(path, separate_channels=True).channels()
    if "R" in channels:
        return np.stack([channels[c].pixels.astype(np.float32) for c in "RGB"], -1)
    return next(iter(channels.values())).pixels.astype(np.float32)


def shown(linear):
    """As `unbake prepare` shows linear photographs to a network: mean logarithm to 0.18, then the sRGB curve."""
    level = linear @ np.float32([0.2126, 0.7152, 0.0722])
    v = np.clip(linear * (0.18 / np.exp(np.mean(np.log(level[level > 0])))), 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.maximum(v, 1e-9) ** (1 / 2.4) - 0.055)


def shrunk(image):
    """Means over blocks, down to the network's size."""
    k = image.shape[0] // HEIGHT
    return image.reshape(HEIGHT, k, WIDTH, k, -1).mean((1, 3))


def picked(image):
    k = image.shape[0] // HEIGHT
    return image[k // 2::k, k // 2::k]


def frames(scene):
    with open(f"{scene}/transforms.json") as f:
        root = json.load(f)
    for frame in root["frames"]:
        yield {k: f"{scene}/{frame[k]}" for k in ("file_path", "label_path", "depth_file_path") if k in frame}


def labels(path):
    from PIL import Image
    return np.array(Image.open(path)).astype(np.int64)


def views(folder):
    """Input, depth in metres along the ray and class ids of every frame with depth."""
    for frame in frames(folder):
        if "depth_file_path" not in frame or "label_path" not in frame:
            continue
        image = (shrunk(shown(exr(frame["file_path"]))) - MEAN) / STD
        yield image.astype(np.float32), picked(exr(frame["depth_file_path"])), picked(labels(frame["label_path"]))


# --- layers: forward gives (output, what backward needs) ---

def columns(x):
    n, h, w, c = x.shape
    p = np.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
    return np.concatenate([p[:, dy:dy + h, dx:dx + w] for dy in range(3) for dx in range(3)], -1)


def conv(x, p):
    cols = columns(x)
    return cols @ p["w"] + p["b"], cols


def conv_back(g, cols, p):
    n, h, w, _ = g.shape
    flat = g.reshape(-1, g.shape[-1])
    grads = {"w": cols.reshape(-1, cols.shape[-1]).T @ flat, "b": flat.sum(0)}
    c = p["w"].shape[0] // 9
    back, padded = g @ p["w"].T, np.zeros((n, h + 2, w + 2, c), np.float32)
    for k in range(9):
        padded[:, k // 3:k // 3 + h, k % 3:k % 3 + w] += back[..., k * c:(k + 1) * c]
    return padded[:, 1:-1, 1:-1], grads


def pool(x):
    n, h, w, c = x.shape
    return x.reshape(n, h // 2, 2, w // 2, 2, c).mean((2, 4))


def doubled(x):
    return x.repeat(2, 1).repeat(2, 2)


def pooled_back(g):
    return doubled(g) / 4


def doubled_back(g):
    return pool(g) * 4


# name, channels in, channels out; the order is that of the way through the network
def layers(classes):
    f = FEATURES
    return [("full", 4, f), ("half", f, 2 * f), ("quarter", 2 * f, 4 * f), ("eighth", 4 * f, 4 * f),
            ("up4", 8 * f, 2 * f), ("up2", 4 * f, f), ("up1", 2 * f, f), ("out", f, classes)]


def begun(classes, rng):
    return {name: {"w": (rng.standard_normal((9 * i, o)) * np.sqrt(2 / (9 * i))).astype(np.float32),
                   "b": np.zeros(o, np.float32)} for name, i, o in layers(classes)}


def rows(n):
    row = np.linspace(-1, 1, HEIGHT, dtype=np.float32)[None, :, None, None]
    return np.broadcast_to(row, (n, HEIGHT, WIDTH, 1))


def forward(p, x):
    kept = {}

    def step(name, x, relu=True):
        y, cols = conv(x, p[name])
        kept[name] = (cols, y > 0)
        return np.maximum(y, 0) if relu else y

    a = step("full", np.concatenate([x, rows(len(x))], -1))
    b = step("half", pool(a))
    c = step("quarter", pool(b))
    d = step("eighth", pool(c))
    u = step("up4", np.concatenate([doubled(d), c], -1))
    u = step("up2", np.concatenate([doubled(u), b], -1))
    u = step("up1", np.concatenate([doubled(u), a], -1))
    return step("out", u, relu=False), kept


def backward(p, kept, g):
    grads = {}

    def step(name, g, relu=True):
        cols, on = kept[name]
        g, grads[name] = conv_back(g * on if relu else g, cols, p[name])
        return g

    f = FEATURES
    g = step("up1", step("out", g, relu=False))
    u, a = g[..., :f], g[..., f:]
    g = step("up2", doubled_back(u))
    u, b = g[..., :2 * f], g[..., 2 * f:]
    g = step("up4", doubled_back(u))
    d, c = g[..., :4 * f], g[..., 4 * f:]
    c = c + pooled_back(step("eighth", doubled_back(d)))
    b = b + pooled_back(step("quarter", c))
    a = a + pooled_back(step("half", b))
    step("full", a)
    return grads


def depth_loss(y, target):
    """Mean |ln d − ln truth|; the network gives ln d."""
    seen = (target > 0)[..., None]
    e = np.where(seen, y - np.log(np.maximum(target, 1e-3))[..., None], 0)
    return np.abs(e).sum() / seen.sum(), np.sign(e) / seen.sum()


def class_loss(y, target):
    z = np.exp(y - y.max(-1, keepdims=True))
    z /= z.sum(-1, keepdims=True)
    seen = target > 0
    hot = np.eye(y.shape[-1], dtype=np.float32)[np.maximum(target - 1, 0)]
    loss = -np.log((z * hot).sum(-1) + 1e-9)[seen].mean()
    return loss, np.where(seen[..., None], z - hot, 0) / seen.sum()


def train(data, targets, classes, loss, steps):
    rng = np.random.default_rng(1)
    p = begun(classes, rng)
    m = {n: {k: np.zeros_like(v) for k, v in q.items()} for n, q in p.items()}
    v = {n: {k: np.zeros_like(w) for k, w in q.items()} for n, q in p.items()}
    mean = 0.0
    for t in range(1, steps + 1):
        some = rng.integers(0, len(data), 4)
        x, y = data[some], targets[some]
        # a room turned about the vertical, or in a mirror, is a room
        shift = int(rng.integers(WIDTH))
        x, y = np.roll(x, shift, 2), np.roll(y, shift, 2)
        if rng.integers(2):
            x, y = x[:, :, ::-1], y[:, :, ::-1]
        x = x * rng.uniform(0.9, 1.1, (4, 1, 1, 3)).astype(np.float32)
        out, kept = forward(p, x)
        value, g = loss(out, y)
        mean += (value - mean) * max(0.02, 1 / t)
        rate = 3e-3 * 0.5 * (1 + np.cos(np.pi * t / steps))
        for n, q in backward(p, kept, g.astype(np.float32)).items():
            for k, d in q.items():
                m[n][k] += 0.1 * (d - m[n][k])
                v[n][k] += 0.001 * (d * d - v[n][k])
                p[n][k] -= rate * (m[n][k] / (1 - 0.9**t)) / (np.sqrt(v[n][k] / (1 - 0.999**t)) + 1e-8)
        if t % 250 == 0:
            print(f"  step {t}: loss {mean:.3f}", flush=True)
    return p


def write(path, p, classes, exponential, properties):
    """The network as ONNX; `exponential` turns ln d into d."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper
    nodes, weights = [], [numpy_helper.from_array(np.ascontiguousarray(rows(1).transpose(0, 3, 1, 2)), "rows")]

    def add(kind, inputs, name, **attributes):
        nodes.append(helper.make_node(kind, inputs, [name], name=name, **attributes))
        return name

    def step(name, x, relu=True):
        w, b = p[name]["w"], p[name]["b"]
        w = w.reshape(3, 3, -1, w.shape[-1]).transpose(3, 2, 0, 1)
        weights.extend([numpy_helper.from_array(np.ascontiguousarray(w), f"{name}.w"), numpy_helper.from_array(b, f"{name}.b")])
        y = add("Conv", [x, f"{name}.w", f"{name}.b"], f"{name}.y", pads=[1, 1, 1, 1])
        return add("Relu", [y], name) if relu else y

    def smaller(x):
        return add("AveragePool", [x], f"{x}.smaller", kernel_shape=[2, 2], strides=[2, 2])

    def joined(x, other):
        x = add("Resize", [x, "", "doubled"], f"{x}.larger", mode="nearest",
                coordinate_transformation_mode="asymmetric", nearest_mode="floor")
        return add("Concat", [x, other], f"{x}.joined", axis=1)

    weights.append(numpy_helper.from_array(np.float32([1, 1, 2, 2]), "doubled"))
    a = step("full", add("Concat", ["image", "rows"], "placed", axis=1))
    b = step("half", smaller(a))
    c = step("quarter", smaller(b))
    u = step("up4", joined(step("eighth", smaller(c)), c))
    u = step("up1", joined(step("up2", joined(u, b)), a))
    y = step("out", u, relu=False)
    if exponential:
        y = add("Exp", [y], "metres")
    value = lambda name, c: helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, c, HEIGHT, WIDTH])
    graph = helper.make_graph(nodes, "small", [value("image", 3)], [value(y, classes)], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    helper.set_model_props(model, properties)
    onnx.checker.check_model(model)
    onnx.save(model, path)


def training(work, rooms, steps):
    names = {}
    for seed in range(1, rooms + 1):
        with open(f"{work}/room{seed}/transforms.json") as f:
            names |= {c["id"]: c["name"] for c in json.load(f)["classes"]}
    classes = max(names)
    data = [v for seed in range(1, rooms + 1) for v in views(f"{work}/room{seed}.depth")]
    x, d, c = (np.stack(part) for part in zip(*data))
    print(f"{len(x)} panoramas of {rooms} rooms, {classes} classes")
    list_of = json.dumps([names.get(i, "void") for i in range(1, classes + 1)])
    p = train(x, d, 1, depth_loss, steps)
    write(f"{work}/depth.onnx", p, 1, True, {"depth_values": "ray", "depth_fit": "scale"})
    p = train(x, c, classes, class_loss, steps)
    write(f"{work}/semantic.onnx", p, classes, False, {"names": list_of})


def bare(source, target):
    os.makedirs(target, exist_ok=True)
    with open(f"{source}/transforms.json") as f:
        root = json.load(f)
    root.pop("classes", None)
    for key in ("train_filenames", "test_filenames"):
        if key in root:
            root[key] = [os.path.abspath(f"{source}/{name}") for name in root[key]]
    for frame in root["frames"]:
        for key in ("label_path", "depth_file_path", "mask_path"):
            frame.pop(key, None)
        frame["file_path"] = os.path.abspath(f"{source}/{frame['file_path']}")
    with open(f"{target}/transforms.json", "w") as f:
        json.dump(root, f)


def scores(work):
    def key(frame):
        return os.path.splitext(os.path.basename(frame["file_path"]))[0]

    def names(scene):
        with open(f"{scene}/transforms.json") as f:
            return {c["id"]: c["name"] for c in json.load(f)["classes"]}

    true_names, seen_names = names(f"{work}/room0"), names(f"{work}/seen")
    true = {key(f): f for f in frames(f"{work}/room0.depth") if "depth_file_path" in f}
    off, right, all_ = [], 0, 0
    for frame in frames(f"{work}/seen"):
        t = true.get(key(frame))
        if not t:
            continue
        d, g = exr(frame["depth_file_path"]), exr(t["depth_file_path"])
        off.append(np.abs(d / np.where(g > 0, g, np.nan) - 1).ravel())
        of = lambda ids, names: np.array([names.get(i, "") for i in range(ids.max() + 1)])[ids]
        a, b = of(labels(frame["label_path"]), seen_names), of(labels(t["label_path"]), true_names)
        right, all_ = right + (a == b).sum(), all_ + a.size
    off = np.concatenate(off)
    print(f"depth: median error {100 * np.nanmedian(off):.1f} %; labels: {100 * right / all_:.1f} % of the pixels")
    for of, what in (("room0", "own mesh and labels"), ("seen", "networks")):
        try:
            with open(f"{work}/{of}.result/eval/metrics.json") as f:
                m = json.load(f)
        except FileNotFoundError:
            print(f"{what}: no result")
            continue
        materials = m["test"]["materials"]
        psnr = lambda k: materials[k]["linear"]["psnr_of_mean_mse"]
        print(f"{what}: albedo {psnr('albedo'):.2f} dB, roughness {psnr('roughness'):.2f} dB, views {m['novel_views']['psnr']:.2f} dB")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["--bare", source, target]:
            bare(source, target)
        case ["--scores", work]:
            scores(work)
        case [work, rooms, steps]:
            training(work, int(rooms), int(steps))
        case _:
            sys.exit(__doc__)
