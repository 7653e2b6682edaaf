"""The compiled part of unbake; its names are those of the package."""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, final, overload

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from .records import Lamp, Lens, Verdict

__all__ = ["Camera", "Scene", "Solution", "__version__", "check", "solve"]

__version__: str

_Path = str | PathLike[str]
_Progress = Callable[[str, int, int], object]
_Note = Callable[[str], object]
_Vector = Sequence[float]

@final
class Camera:
    """A posed camera: a panorama, or a pinhole camera. Values do not change."""

    def __new__(
        cls,
        position: _Vector,
        world_from_camera: Sequence[Sequence[float]],
        width: int,
        height: int,
        *,
        fov: float | None = None,
        name: str = "camera",
    ) -> Self:
        """A camera at `position` (3) whose rotation has the rows `world_from_camera` (3 x 3), for images of `width` x `height` pixels
        (1 to 16384). `fov` is the horizontal angle of view in degrees (1 to 170); None makes a panorama of all directions.

        Raises UsageError if a value is out of range or the matrix is no rotation.
        """

    @staticmethod
    def look_at(
        position: _Vector, target: _Vector, width: int, height: int, *, fov: float | None = None, name: str = "camera"
    ) -> Camera:
        """A camera at `position` that looks at `target`, +y up in its image. Raises UsageError as the constructor does."""

    @property
    def name(self) -> str:
        """The name of what is made of it: of a scene's camera, its image without the ending."""

    @property
    def width(self) -> int:
        """Pixels."""

    @property
    def height(self) -> int:
        """Pixels."""

    @property
    def panorama(self) -> bool:
        """Whether it sees all directions."""

    @property
    def position(self) -> tuple[float, float, float]:
        """Metres, coordinates of the scene's file."""

    @property
    def world_from_camera(self) -> list[list[float]]:
        """Rows of the rotation."""

    @property
    def lens(self) -> Lens | None:
        """None of a panorama."""

@final
class Scene:
    """A validated scene: mesh, cameras, classes. Photographs are read on demand."""

    def __new__(cls, path: _Path, **options: Any) -> Self:
        """Reads a scene folder (or its transforms.json). Options are the flags of `unbake check` under "Scene" with underscores.

        Raises InputError that names every unusable file and key; UsageError for an option.
        """

    @property
    def path(self) -> Path:
        """Where it was read from."""

    @property
    def warnings(self) -> list[str]:
        """What should be known although the scene is usable."""

    @property
    def classes(self) -> dict[int, str]:
        """Names of the classes by the ids of label images."""

    @property
    def origin(self) -> tuple[float, float, float]:
        """What `positions` are relative to: a point in the coordinates of the scene's file."""

    @property
    def positions(self) -> NDArray[np.float32]:
        """(vertices, 3), metres relative to `origin`."""

    @property
    def normals(self) -> NDArray[np.float32]:
        """(vertices, 3), unit vectors."""

    @property
    def uvs(self) -> NDArray[np.float32]:
        """(vertices, 2), places in the atlas in [0, 1], v down the rows."""

    @property
    def triangles(self) -> NDArray[np.uint32]:
        """(triangles, 3), rows of `positions`."""

    def cameras(self, views: Literal["all", "train", "test"] = "all") -> list[Camera]:
        """The cameras of the views, named after their images, in the order of the file."""

    def photograph(self, name: str) -> NDArray[np.float32]:
        """(height, width, 3): the radiance that a view's photograph shows. Raises UsageError for a name that no view has, InputError
        for an image that cannot be read."""

@final
class Solution:
    """A result of `solve`: textures, lamps, stated errors, verdict."""

    def __new__(cls, path: _Path, *, progress: _Progress | None = None, note: _Note | None = None) -> Self:
        """Reads an output folder, with what `unbake edit` changed in it. Raises InputError for a folder that is no whole result."""

    @property
    def path(self) -> Path:
        """Its folder."""

    @property
    def albedo(self) -> NDArray[np.float32]:
        """(rows, columns, 3), linear RGB in [0, 1]; where there is metal, what it reflects at normal incidence."""

    @property
    def roughness(self) -> NDArray[np.float32]:
        """(rows, columns), R in [0, 1]; alpha = R²."""

    @property
    def irradiance(self) -> NDArray[np.float32]:
        """(rows, columns, 3), radiance unit times steradian."""

    @property
    def radiance(self) -> NDArray[np.float32]:
        """(rows, columns, 3): what leaves the surface, as observed."""

    @property
    def emission(self) -> NDArray[np.float32]:
        """(rows, columns, 3): emitted radiance, 0 where none."""

    @property
    def confidence(self) -> NDArray[np.float32]:
        """(rows, columns, 2): standard errors of albedo and of roughness; 10000 = unobserved."""

    @property
    def irradiance_error(self) -> NDArray[np.float32] | None:
        """(rows, columns): relative standard error of the irradiance's luminance; None where nothing states it."""

    @property
    def metallic(self) -> NDArray[np.float32] | None:
        """(rows, columns): share of metal in [0, 1], of the albedo's shape; None where the scene has none."""

    @property
    def transmission(self) -> NDArray[np.float32] | None:
        """(rows, columns): share of light that goes straight through, in [0, 1], of the albedo's shape; None where the scene has no panes."""

    @property
    def labels(self) -> NDArray[np.uint16]:
        """(rows, columns): class ids, 0 = unlabelled."""

    @property
    def rooms(self) -> NDArray[np.uint16]:
        """(rows, columns): room ids, 0 = outside."""

    @property
    def environment(self) -> NDArray[np.float32]:
        """(rows, columns, 3): radiance from directions without geometry, an equirectangular map in world axes."""

    @property
    def origin(self) -> tuple[float, float, float]:
        """What `positions` are relative to: a point in the coordinates of the scene's file."""

    @property
    def positions(self) -> NDArray[np.float32]:
        """(vertices, 3), metres relative to `origin`."""

    @property
    def normals(self) -> NDArray[np.float32]:
        """(vertices, 3), unit vectors."""

    @property
    def uvs(self) -> NDArray[np.float32]:
        """(vertices, 2), places in the atlas in [0, 1], v down the rows."""

    @property
    def triangles(self) -> NDArray[np.uint32]:
        """(triangles, 3), rows of `positions`."""

    @property
    def lamps(self) -> list[Lamp]:
        """Luminous surfaces, most powerful first."""

    @property
    def portals(self) -> list[Lamp]:
        """Openings to the environment, numbered on from the lamps."""

    @property
    def reflectance(self) -> str:
        """The reflection model that albedo and roughness belong to."""

    @property
    def verdict(self) -> Verdict | None:
        """How far the result is to be trusted; None of a folder without a manifest. Raises InputError for a manifest of another run."""

    @property
    def manifest(self) -> dict[str, Any] | None:
        """What `manifest.json` says of the run (docs/outputs.md)."""

    def read_cameras(self, path: _Path) -> list[Camera]:
        """The cameras of a file in the form of transforms.json. Raises InputError for all that is wrong with it."""

    @overload
    def render(
        self,
        cameras: Camera,
        *,
        progress: _Progress | None = None,
        note: _Note | None = None,
        seed: int = 0,
        threads: int | None = None,
        **options: Any,
    ) -> NDArray[np.float32]: ...
    @overload
    def render(
        self,
        cameras: Sequence[Camera],
        *,
        progress: _Progress | None = None,
        note: _Note | None = None,
        seed: int = 0,
        threads: int | None = None,
        **options: Any,
    ) -> list[NDArray[np.float32]]:
        """Pictures in the photographed light, (height, width, 3) radiance each: an array for one camera, a list for several.

        Options are flags of `unbake render`: renderer ("hybrid", "path"), show ("light", "albedo", "roughness"), supersampling (1 to
        16), samples, no_denoise, diffuse_only, flat, and width, height, fov, path, which change the cameras; with `path` the result is
        a list. Raises UsageError for an option or camera out of range.
        """

    @overload
    def relight(
        self,
        cameras: Camera,
        *,
        lamps: Sequence[Mapping[str, Any]] | None = None,
        add: Sequence[Mapping[str, Any]] | None = None,
        environment: Mapping[str, Any] | None = None,
        progress: _Progress | None = None,
        note: _Note | None = None,
        seed: int = 0,
        threads: int | None = None,
        **options: Any,
    ) -> NDArray[np.float32]: ...
    @overload
    def relight(
        self,
        cameras: Sequence[Camera],
        *,
        lamps: Sequence[Mapping[str, Any]] | None = None,
        add: Sequence[Mapping[str, Any]] | None = None,
        environment: Mapping[str, Any] | None = None,
        progress: _Progress | None = None,
        note: _Note | None = None,
        seed: int = 0,
        threads: int | None = None,
        **options: Any,
    ) -> list[NDArray[np.float32]]:
        """Pictures in changed light, as `render` gives them, by the path tracer.

        `lamps`, `add` and `environment` are the tables of a lighting file of `unbake relight` (docs/outputs.md): changes of lamps
        (group or near; off, scale, colour, move), new lamps (kind = quad, sphere, point, spot, ies), the light from outside (off,
        file, constant, scale, colour). Files are relative to the current folder. Options: samples, max_samples, error (relative
        standard error at which a part of the picture is done), no_denoise, width, height, fov, path. Raises UsageError for what does
        not exist or is no light, InputError for a file that cannot be read.
        """

def solve(
    scene: _Path | Scene,
    out: _Path,
    *,
    progress: _Progress | None = None,
    note: _Note | None = None,
    seed: int = 0,
    threads: int | None = None,
    **options: Any,
) -> Solution:
    """Reconstructs a scene, writes what `unbake solve` writes into the folder `out`, the same bits, and reads it back.

    Options are the flags of `unbake solve` with underscores: quality ("preview", "draft", "standard", "high"; default "standard"), albedo_size,
    roughness_size, irradiance_size (texels), budget (seconds), edges ("auto", "on", "off", or True and False), fix_alignment, force, …
    A `Scene` keeps the options that it was read with; of a path, they may be given here.

    Raises InputError for a scene that cannot be used or whose photographs do not fit its mesh, UsageError for an option, FileError if
    `out` cannot be written to.
    """

def check(
    scene: _Path, *, progress: _Progress | None = None, note: _Note | None = None, threads: int | None = None, **options: Any
) -> dict[str, Any]:
    """What is understood of a scene and everything that is wrong with it, as `unbake check --json` says it: "problems" and "warnings"
    (lists of sentences), "alignment", …; "text" is the same for people. A bad scene is a result and no exception.

    Options are the flags of `unbake check`. Raises UsageError for an option.
    """
