"""Renders every sensor of the exported Mitsuba scene with several seeds; saves the images as .npy."""
import os, sys
from pathlib import Path
import numpy as np
import mitsuba as mi

folder, out, runs, spp = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
mi.set_variant("scalar_rgb")
scene = mi.load_file(str(folder / "mitsuba.xml"), spp=spp)
for sensor in scene.sensors():
    images = [np.array(mi.render(scene, sensor=sensor, seed=k + 1, spp=spp)) for k in range(runs)]
    np.save(out / f"mitsuba_{sensor.id()}.npy", np.stack(images))
