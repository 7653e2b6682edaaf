"""A small synthetic room and its reconstruction, made once: by the program given in UNBAKE (scene) and by the module (result)."""

import os
import subprocess

import pytest

import unbake

SMALL = dict(quality="draft", albedo_size=128, roughness_size=128, irradiance_size=128, evidence_points=100)


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    program = os.environ.get("UNBAKE")
    if not program:
        pytest.skip("UNBAKE does not name the program that makes the test's scene; scripts/check_python sets it")
    folder = tmp_path_factory.mktemp("room") / "scene"
    size = "--rooms 1 --views 6 --test-views 1 --width 128 --spp 4 --texture 256".split()
    subprocess.run([program, "synth", "-o", folder, *size, "--quiet"], check=True)
    return folder


@pytest.fixture(scope="session")
def solved(scene):
    """The result, and what the callbacks heard."""
    steps, notes = [], []
    out = scene.parent / "result"
    result = unbake.solve(scene, out, progress=lambda *a: steps.append(a), note=notes.append, seed=3, threads=2, **SMALL)
    return result, steps, notes
