"""unbake takes the light out of photographs of rooms: albedo, roughness and light textures of indoor scenes on ordinary CPUs.

    import unbake
    result = unbake.solve("scene", "result", quality="draft")
    picture = result.render(unbake.Camera.look_at((0, 1.6, 0), (2, 1, 0), 640, 360, fov=80))

Everything is described in `unbake/__init__.pyi` and in docs/python.md of the repository.
"""

from .errors import Error, FileError, InputError, UsageError
from .unbake_native import Camera, Scene, Solution, __version__, check, solve

__all__ = ["Camera", "Error", "FileError", "InputError", "Scene", "Solution", "UsageError", "__version__", "check", "solve"]
