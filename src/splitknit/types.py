"""What travels together: frozen dataclasses shared by all stages.

Axes, units and signs are in ``docs/conventions.md``. The rig's frame has x right along the columns, y up against the
rows, z towards the camera, in millimetres; its origin is where the camera's axis meets the finger plane.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.lights import COLOURS, Led, Mirror, Shade, vector_at_origin

__all__ = [
    "COLOURS",
    "Band",
    "BoolArray",
    "Camera",
    "Capture",
    "FloatArray",
    "Led",
    "Mirror",
    "PixelArray",
    "Reconstruction",
    "Rig",
    "Shade",
]

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
PixelArray = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera that looks down on the finger plane."""

    px_per_mm: float
    """Pixels per millimetre on the finger plane."""
    image_size: tuple[int, int]
    """Rows, columns."""
    height_mm: float = 140.0
    """Distance of the camera from the finger plane."""
    model: str = "orthographic"
    """``orthographic`` or ``perspective``."""
    matrix: NDArray[np.float64] | None = None
    """3 x 3 camera matrix in pixels (perspective only)."""
    distortion: tuple[float, ...] | None = None
    """Distortion coefficients in OpenCV's order (perspective only)."""
    shading: tuple[float, ...] = ()
    """Fall-off of the lens towards the corners: brightness is 1 + a r^2 + b r^4 + ..., r the distance from the image's
    centre over half its diagonal. Images are divided by it."""
    crosstalk: NDArray[np.float64] | None = None
    """3 x 3: signal of the red, green and blue pixels (rows) under a red, a green and a blue LED (columns), each row
    relative to its own colour. None: every LED is seen by the pixels of its own colour alone."""

    def __post_init__(self) -> None:
        if self.crosstalk is not None:
            mixing = np.asarray(self.crosstalk, dtype=np.float64)
            require(
                mixing.shape == (3, 3) and bool(np.isfinite(mixing).all()) and bool(np.linalg.cond(mixing) < 50.0),
                "camera.crosstalk must be 3 x 3 finite numbers by which the three colours can be told apart.",
            )
        require(np.isfinite(self.px_per_mm) and self.px_per_mm > 0, "camera.px_per_mm must be a positive number.")
        require(np.isfinite(self.height_mm) and self.height_mm > 0, "camera.height_mm must be a positive number.")
        require(min(self.image_size) > 0, f"camera.image_size must be positive, but it is {list(self.image_size)}.")
        require(self.model in ("orthographic", "perspective"), f"camera.model '{self.model}' is not known.")
        if self.model == "perspective":
            require(self.matrix is not None, "a perspective camera needs its matrix.")
        r2 = np.linspace(0.0, 1.0, 101)
        brightness = 1.0 + sum(a * r2 ** (k + 1) for k, a in enumerate(self.shading))
        require(
            bool(np.all(np.isfinite(brightness)) and np.all(brightness > 0.02)),
            "camera.shading leaves no light somewhere in the picture; it must stay above 0.02 of the middle's.",
        )

    @property
    def pitch_mm(self) -> float:
        """Size of one pixel on the finger plane."""
        return 1.0 / self.px_per_mm


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Camera, lights and mirrors."""

    camera: Camera
    leds: tuple[Led, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    mirrors: tuple[Mirror, ...] = ()
    """Beside the finger; none in the thesis's main rig."""

    def __post_init__(self) -> None:
        names = [mirror.name for mirror in self.mirrors]
        require(len(set(names)) == len(names), "the rig's mirrors must have different names: left, right, tip.")

    def colours_of(self, groups: Sequence[Sequence[int]]) -> tuple[tuple[str, ...], ...]:
        """Colours of the LEDs of every exposure, for :class:`Band`; nothing where all LEDs are white."""
        colours = tuple(tuple(self.leds[index].colour for index in group) for group in groups)
        return colours if any(any(names) for names in colours) else ()

    def lights_of(self, groups: Sequence[Sequence[int]]) -> tuple[tuple[int, ...], ...]:
        """LEDs of every image of :func:`splitknit.radiance.linear_stack`: colours that share an exposure apart."""
        return _lights(groups, self.colours_of(groups))

    def select(self, groups: Sequence[Sequence[int]]) -> Rig:
        """Return the rig whose `leds[k]` is what lights image k: the LEDs `groups[k]` together."""
        chosen = []
        for group in groups:
            require(len(group) > 0, "every image needs at least one LED.")
            for index in group:
                require(
                    0 <= index < len(self.leds),
                    f"LED {index} is not in the rig, which has {len(self.leds)} LEDs (0 to {len(self.leds) - 1}).",
                )
            first = self.leds[group[0]]
            chosen.append(replace(first, also=tuple(self.leds[index] for index in group[1:])))
        return replace(self, leds=tuple(chosen))

    def light_vectors(self) -> NDArray[np.float64]:
        """Distant-light vectors (L, 3): direction from the origin to each LED times its relative irradiance there.

        Near LEDs follow the inverse square of the distance. The mean length is one. LEDs that share an exposure add.
        """
        vectors = np.array([vector_at_origin(led) for led in self.leds]).reshape(-1, 3)
        lengths = np.linalg.norm(vectors, axis=1)
        require(bool((lengths > 0).all()), "LEDs that share one exposure cancel each other; correct the rig.")
        return vectors / float(lengths.mean())


def _lights(groups: Sequence[Sequence[int]], colours: Sequence[Sequence[str]]) -> tuple[tuple[int, ...], ...]:
    """The groups of LEDs, those of coloured exposures divided by colour, in the order red, green, blue."""
    result: list[tuple[int, ...]] = []
    for k, group in enumerate(groups):
        if not colours or not any(colours[k]):
            result.append(tuple(group))
            continue
        named = list(zip(group, colours[k], strict=True))
        parts = [tuple(i for i, name in named if name == colour) for colour in COLOURS]
        result.extend(part for part in parts if part)
    return tuple(result)


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """The images of one spectral band, as stored: integers, not yet linear.

    :func:`splitknit.radiance.linear_stack` turns them into linear light.
    """

    name: str
    pixels: PixelArray
    """(L, H, W, C), C = 1 (grey) or 3 (red, green, blue)."""
    leds: tuple[tuple[int, ...], ...]
    """`leds[k]` are the indices of the rig's LEDs that light image k."""
    exposure: NDArray[np.float64]
    """(L,) exposure time times gain, relative; images are divided by it."""
    black_level: NDArray[np.float64]
    """(L,) stored value of no light."""
    ambient: PixelArray | None = None
    """(H, W, C) with all LEDs off, or None."""
    ambient_exposure: float = 1.0
    ambient_black_level: float = 0.0
    shading: tuple[float, ...] = ()
    """Of the camera that took the images, see :class:`Camera`."""
    files: tuple[str, ...] = ()
    colours: tuple[tuple[str, ...], ...] = ()
    """`colours[k]` are the colours of the LEDs `leds[k]`, see :class:`Led`; nothing where all are white."""
    crosstalk: NDArray[np.float64] | None = None
    """Of the camera that took the images, see :class:`Camera`; used where LEDs are coloured."""

    @property
    def lights(self) -> tuple[tuple[int, ...], ...]:
        """LEDs of every image of :func:`splitknit.radiance.linear_stack`: `leds` but for coloured ones, each of whose
        colours has an image of its own."""
        return _lights(self.leds, self.colours)


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """One finger, photographed once under every LED."""

    rig: Rig
    bands: Mapping[str, Band]
    """``white`` always; ``nir`` where it was captured."""
    encoding: str = "linear"
    """``linear`` or ``srgb``."""
    material: str = "skin"
    """``skin`` or ``opaque`` (no subsurface scattering to undo)."""
    tip_direction_deg: float | None = None
    """Where the tip points: 0 = row 0, counter-clockwise; None = up within 60 deg."""
    mask: BoolArray | None = None
    """(H, W) given by the user: used as it is."""
    subject: Mapping[str, Any] = field(default_factory=dict)
    captured_at: str | None = None
    truth: Path | None = None
    """A simulator's ``truth.npz``."""
    hashes: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of every file that was read, by its name in the folder."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns of every image."""
        return self.rig.camera.image_size


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """A metric fingerprint on the input's pixel grid."""

    height_mm: FloatArray
    """(H, W) knitted surface, NaN outside the mask."""
    ridge_mm: FloatArray
    """(H, W) ridge-valley relief alone, NaN outside the mask."""
    shape_mm: FloatArray
    """(H, W) finger shape alone, NaN outside the mask."""
    mask: BoolArray
    """(H, W)."""
    normals: FloatArray
    """(H, W, 3) of the knitted surface, unit length, zero outside the mask."""
    albedo: FloatArray
    """(H, W) relative, NaN outside the mask."""
    pitch_mm: float
    input_from_upright: NDArray[np.float64]
    """(3, 3) on (column, row, 1): where an upright pixel (tip up) lies in the input."""
    upright_size: tuple[int, int]
    """Rows, columns of the upright frame."""
    preset: str
    x_mm: FloatArray | None = None
    """(H, W) x of the surface point that each pixel sees, NaN outside the mask; None where the camera's rays are
    parallel and the pixels lie at their pitch."""
    y_mm: FloatArray | None = None
    """(H, W) y, likewise."""
    uncertainty_um: FloatArray | None = None
    """(H, W) standard deviation of the relief where the skin's blur was inverted, NaN outside the mask."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    quality: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    """What the pipeline found or assumed (yaw, crease row, scattering, ...)."""
    warnings: tuple[str, ...] = ()
    timings_s: Mapping[str, float] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)
