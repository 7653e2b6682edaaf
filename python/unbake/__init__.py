"""unbake takes the light out of photographs of rooms: albedo, roughness and light textures of indoor scenes on ordinary CPUs.

    import unbake
    result = unbake.solve("scene", "result", quality="draft")
    picture = result.render(unbake.Camera.look_at((0, 1.6, 0), (2, 1, 0), 640, 360, fov=80))

Spaces: positions are metres in the coordinates of the scene's file (y up; a file that is z up is turned on reading), rotations are
`world_from_camera` with OpenGL's axes (x right, y up, looking along -z). Colours are linear RGB with Rec. 709 primaries; radiance is in
the unit of the photographs, irradiance in that unit times steradian. Textures are arrays of rows, columns and components: row 0 is v = 0,
texel centres lie at +0.5, all of a result's textures share one atlas. Arrays are read-only views of memory that they keep alive.

`progress(stage, done, steps)` and `note(sentence)` are called in the calling thread, at most ten times a second between a stage's
beginning and end. An exception that they raise, and Ctrl-C, stop the work, leave no partial result and are passed on; the same call then
goes on where it was stopped. Python's other threads run meanwhile. `threads` limits the worker threads and never changes the result.
"""

from .errors import Error, FileError, InputError, UsageError
from .records import Lamp, Lens, Reason, Verdict
from .unbake_native import Camera, Scene, Solution, __version__, check, solve

__all__ = [
    "Camera",
    "Error",
    "FileError",
    "InputError",
    "Lamp",
    "Lens",
    "Reason",
    "Scene",
    "Solution",
    "UsageError",
    "Verdict",
    "__version__",
    "check",
    "solve",
]
