"""What is said in dictionaries, as the files of a result have it (docs/outputs.md)."""

from typing import Literal, TypedDict


class Lens(TypedDict):
    """Pinhole intrinsics in pixels with OpenCV's distortion coefficients."""

    fl_x: float
    fl_y: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float


class Lamp(TypedDict):
    """A light, as `lights.json` has it."""

    id: int
    """The number by which it is named, 1 for the most powerful."""
    kind: Literal["lamp", "window", "portal"]
    centre: list[float]
    """Metres, coordinates of the scene's file."""
    size: list[float]
    """Extent of its bounding box, metres."""
    area: float
    """m²."""
    power: list[float]
    """Emitted power RGB: pi times the integral of radiance over the area, radiance units times m²."""
    radiance: list[float]
    """Mean emitted radiance RGB."""
    clipped: bool
    """Its radiance was clipped in the photographs and is estimated."""
    standard_error: float
    """Relative standard error of the power; 0 where nothing states one."""
    triangles: list[int]
    """Rows of `Solution.triangles`."""


class Reason(TypedDict):
    """One reason against a result."""

    what: str
    weight: float
    """Error in albedo that it must be expected to make."""
    place: str


class Verdict(TypedDict):
    """How far a result is to be trusted."""

    level: Literal["good", "limited", "untrusted"]
    expected_error: float
    """Expected error in albedo (root mean square over the seen surface, albedo in [0, 1])."""
    reasons: list[Reason]
    text: str
    """The same for people."""
