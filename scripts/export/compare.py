"""Compares what other programs made of an export with our own pictures; prints one line per check, exit code 1 if any fails.

compare.py albedo OUT NAME...   our albedo against three.js and Blender (PSNR of sRGB values, at least 30 dB away from edges)
compare.py light OUT NAME...    Mitsuba against our path tracer: Welch's t per block of pixels, and the mean over all;
                                Blender's Cycles against it: PSNR of blocks' means; a picture of all side by side
"""
import sys
from pathlib import Path
import numpy as np
import mitsuba as mi

mi.set_variant("scalar_rgb")
kind, out, names = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]
failed = False


def exr(path):
    return np.array(mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False))


def srgb(x):
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def png(path, image):
    mi.Bitmap((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)).write(str(path))


def check(text, fine):
    global failed
    failed |= not fine
    print("ok    " if fine else "FAILED", text)


FINER = 4  # ours has this many pixels for one of theirs, along each side (check_export)


def blocks_of(image):
    """height x width x FINER² x channels: the fine pixels of each of theirs."""
    h, w, c = image.shape
    fine = image.reshape(h // FINER, FINER, w // FINER, FINER, c)
    return fine.transpose(0, 2, 1, 3, 4).reshape(h // FINER, w // FINER, FINER**2, c)


def inner(fine):
    """Pixels of theirs whose neighbourhood is smooth: at edges the programs filter differently."""
    y = srgb(blocks_of(fine)).mean(axis=3)
    h, w, _ = y.shape
    low, high = (np.pad(extreme, 1, mode="edge") for extreme in (y.min(axis=2), y.max(axis=2)))
    around = [(slice(i, i + h), slice(j, j + w)) for i in range(3) for j in range(3)]
    return np.max([high[a] for a in around], axis=0) - np.min([low[a] for a in around], axis=0) < 0.1


if kind == "albedo":
    for name in names:
        fine = exr(out / f"ours_albedo/{name}.exr")
        ours = srgb(blocks_of(fine).mean(axis=2))
        keep = inner(fine)
        for program in ["three_albedo", "blender_albedo", "blender_usd_albedo"]:
            if (out / f"{program}_{name}.exr").exists():
                theirs = srgb(exr(out / f"{program}_{name}.exr"))
            elif (out / f"{program}_{name}.png").exists():
                b = mi.Bitmap(str(out / f"{program}_{name}.png")).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
                theirs = np.array(b).astype(np.float64) / 255
            else:
                continue
            error = ((ours - theirs) ** 2).mean(axis=2)
            psnr = -10 * np.log10(max(error[keep].mean(), 1e-12))
            png(out / f"compare_{program}_{name}.png", np.concatenate([ours, theirs, 4 * np.abs(ours - theirs)], axis=1))
            check(f"{program} {name}: {psnr:.1f} dB over {100 * keep.mean():.0f} % of the pixels (at least 30)", psnr >= 30)
else:
    for name in names:
        if not (out / f"mitsuba_{name}.npy").exists():
            continue
        theirs = np.load(out / f"mitsuba_{name}.npy").astype(np.float64)
        ours = np.stack([exr(p / f"{name}.exr") for p in sorted(out.glob("ours_light_*"))]).astype(np.float64)
        block = 8
        h, w = (theirs.shape[1] // block) * block, (theirs.shape[2] // block) * block

        def blocks(x):
            # lamps seen directly are the same numbers in both; what is compared is the light they send
            y = np.minimum(x[:, :h, :w].mean(axis=3), cap)
            return y.reshape(len(x), h // block, block, w // block, block).mean(axis=(2, 4))

        cap = np.inf
        a, b = blocks(ours), blocks(theirs)
        va, vb = a.var(axis=0, ddof=1) / len(a), b.var(axis=0, ddof=1) / len(b)
        # single blocks have few runs to tell their variance from: the neighbourhood's helps
        pooled = lambda v: np.maximum(v, 0.5 * np.median(v))
        t = (a.mean(0) - b.mean(0)) / np.sqrt(pooled(va) + pooled(vb) + 1e-30)
        outside = float((np.abs(t) > 3).mean())
        bulk = np.median(np.abs(t)) / 0.6745
        total = a.mean(axis=(1, 2)), b.mean(axis=(1, 2))
        z = (total[0].mean() - total[1].mean()) / np.sqrt(total[0].var(ddof=1) / len(a) + total[1].var(ddof=1) / len(b))
        relative = total[0].mean() / total[1].mean() - 1
        scale = 0.8 / np.quantile(b.mean(0), 0.9)
        both = np.concatenate([ours.mean(0), theirs.mean(0), 8 * np.abs(ours.mean(0) - theirs.mean(0))], axis=1)
        png(out / f"compare_mitsuba_{name}.png", srgb(both * scale))
        print(f"       mitsuba {name}: spread of t {bulk:.2f}, {100 * outside:.2f} % of {t.size} blocks beyond 3, mean {100 * relative:+.3f} % (z {z:+.2f})")
        check(f"mitsuba {name}: within noise", outside < 0.03 and bulk < 1.4 and (abs(z) < 3.5 or abs(relative) < 0.002))
if kind == "light":
    for name in names:
        file = out / f"blender_lit_{name}.exr"
        if not file.exists():
            continue
        ours = np.stack([exr(p / f"{name}.exr") for p in sorted(out.glob("ours_light_*"))]).mean(0).astype(np.float64)
        theirs = exr(file).astype(np.float64)
        block = 8
        h, w = (ours.shape[0] // block) * block, (ours.shape[1] // block) * block
        # lamps and windows seen directly are clipped in both, as in a photograph; blocks, for noise clipped is light lost
        peak = np.quantile(ours.mean(2), 0.9) / 0.8
        means = [np.minimum(i[:h, :w].reshape(h // block, block, w // block, block, 3).mean((1, 3)), peak) for i in (ours, theirs)]
        psnr = -10 * np.log10(max(((srgb(means[0] / peak) - srgb(means[1] / peak)) ** 2).mean(), 1e-12))
        relative = means[1].mean() / means[0].mean() - 1
        png(out / f"compare_blender_lit_{name}.png", srgb(np.concatenate([ours, theirs, 4 * np.abs(ours - theirs)], axis=1) / peak))
        check(f"blender_lit {name}: {psnr:.1f} dB over blocks (at least 28), mean {100 * relative:+.2f} % (within 5)", psnr >= 28 and abs(relative) < 0.05)
    rows = []
    for name in names:
        ours = np.stack([exr(p / f"{name}.exr") for p in sorted(out.glob("ours_light_*"))]).mean(0)
        peak = np.quantile(ours.mean(2), 0.9) / 0.8
        shown = [srgb(ours / peak)]
        if (out / f"mitsuba_{name}.npy").exists():
            shown.append(srgb(np.load(out / f"mitsuba_{name}.npy").mean(0) / peak))
        if (out / f"blender_lit_{name}.exr").exists():
            shown.append(srgb(exr(out / f"blender_lit_{name}.exr") / peak))
        if (out / f"three_lit_{name}.png").exists():
            bitmap = mi.Bitmap(str(out / f"three_lit_{name}.png"))
            shown.append(np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)) / 255.0)
        rows.append(np.concatenate(shown, axis=1))
    png(out / "side_by_side.png", np.concatenate(rows, axis=0))
    print("side by side (ours, Mitsuba, Blender, three.js):", out / "side_by_side.png")
sys.exit(failed)
