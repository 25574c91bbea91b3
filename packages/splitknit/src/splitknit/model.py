"""What travels together: frozen dataclasses shared by all stages.

Axes, units and signs are in ``docs/explain/conventions.md``. The rig's frame has x right along the
columns, y up against the rows, z towards the camera, in millimetres; its origin is where the
camera's axis meets the finger plane.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.parameters import FLAT_SIDE, UNKNOWN_SIDE_MM
from splitknit.units import MILLIMETRES, LengthUnit, pixels

Array = NDArray[np.float64]
FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]
GreyArray = NDArray[np.uint8]
PixelArray = GreyArray | NDArray[np.uint16]
Progress = Callable[[str, float], None]
"""Called with the name of a step and the fraction done, 0 to 1."""
Coordinate = Annotated[float, Meta(ge=-1e7, le=1e7)]
Point = tuple[Coordinate, Coordinate, Coordinate]
"""Ranges hold for what is read from files."""
_Brightness = Annotated[
    tuple[Annotated[float, Meta(ge=0.01, le=100)], ...], Meta(min_length=3, max_length=3)
]
COLOURS = ("red", "green", "blue")
"""Colours of LEDs and of a camera's pixels, in the order of an image's channels."""


def no_progress(stage: str, fraction: float) -> None:
    """Report no progress."""


@dataclass(frozen=True, slots=True, eq=False)
class Shade:
    """How much of a light reaches the finger, place by place: what is turned away or hidden from it
    lies in shadow."""

    x_mm: tuple[float, float]
    """x of the first and last column."""
    y_mm: tuple[float, float]
    """y of the first and last row."""
    fraction: NDArray[np.float32]
    """(h, w) in [0, 1], at least 2 x 2; read bilinearly, and at its border beyond it."""
    apex_mm: float | None = None
    """Height of the perspective camera along whose rays places go to the finger plane, where x and
    y are read."""

    def __post_init__(self) -> None:
        require(
            self.fraction.ndim == 2 and min(self.fraction.shape) >= 2,
            "a light's shade must be at least 2 x 2.",
        )
        require(
            self.x_mm[0] != self.x_mm[1] and self.y_mm[0] != self.y_mm[1],
            "a light's shade must have a size.",
        )


@dataclass(frozen=True, slots=True)
class Led:
    """One light: near (`position_mm`) or distant (`direction`, towards the light), never both."""

    band: Annotated[str, Meta(min_length=1)]
    """``white`` or ``nir``."""
    position_mm: Point | None = None
    direction: Point | None = None
    intensity: Annotated[float, Meta(ge=1e-9, le=1e9)] = 1.0
    """Relative, one scale for the whole rig."""
    lobe_exponent: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    """Exponent of the cosine about the LED's axis; 0 is isotropic."""
    aim: Point | None = None
    """Direction of a near LED's axis, from the LED outwards; None = towards the origin."""
    also: tuple[Led, ...] = ()
    """Further LEDs lit in the same exposure."""
    reflected: bool = False
    """The image of an LED in a mirror: it may lie below the finger plane, aimed anywhere. Never in
    a rig file. Where an exposure is spoken of as one light
    (:meth:`splitknit.model.Rig.light_vectors`), the images among `also` are left out."""
    shade: Shade | None = None
    """Where its light does not reach the finger; None: it reaches everything. Never in a rig
    file."""
    colour: str = ""
    """``red``, ``green`` or ``blue``; empty: white, or of the whole band."""

    def __post_init__(self) -> None:
        require(
            self.colour == "" or self.colour in COLOURS,
            f"an LED's colour is red, green or blue (or none), not '{self.colour}'.",
        )
        require(
            self.colour == "" or self.band == "white",
            "only LEDs of the band 'white' may have a colour.",
        )
        near = self.position_mm is not None
        require(
            near == (self.direction is None),
            "an LED has either position_mm (near) or direction (distant), not both and not"
            " neither.",
        )
        wanted = "must be three finite numbers that are not all zero."
        require(_is_vector(self.towards), f"an LED's position_mm or direction {wanted}")
        require(
            np.isfinite(self.intensity) and self.intensity > 0,
            "an LED's intensity must be a positive number.",
        )
        sound = np.isfinite(self.lobe_exponent) and self.lobe_exponent >= 0
        require(sound, "an LED's lobe_exponent must be zero or a positive number.")
        above = not near or self.reflected or self.towards[2] > 0
        require(above, "an LED's position_mm must lie above the finger plane (z > 0).")
        if self.aim is not None:
            require(near, "an LED's aim needs its position_mm: distant light has no axis.")
            require(_is_vector(np.asarray(self.aim)), f"an LED's aim {wanted}")
            cosine = -float(self.axis @ self.towards) / float(np.linalg.norm(self.towards))
            require(
                self.reflected or cosine > 0.2,
                "an LED's aim must point towards the finger plane's middle, within 78 deg.",
            )

    @property
    def towards(self) -> NDArray[np.float64]:
        """(3,) from the origin: the place in mm of a near LED, or the direction of a distant
        one."""
        return np.asarray(
            self.position_mm if self.position_mm is not None else self.direction, dtype=np.float64
        )

    @property
    def axis(self) -> NDArray[np.float64]:
        """(3,) unit vector of the beam, from the LED outwards."""
        vector = -self.towards if self.aim is None else np.asarray(self.aim, dtype=np.float64)
        return vector / float(np.linalg.norm(vector))


def _is_vector(vector: NDArray[np.float64]) -> bool:
    return vector.shape == (3,) and bool(np.isfinite(vector).all() and vector.any())


@dataclass(frozen=True, slots=True)
class Mirror:
    """A plane mirror beside the finger, in the rig's frame, as it was built: its true pose differs
    a little."""

    name: str
    """``left`` (x < 0), ``right`` (x > 0) or ``tip`` (beyond the fingertip)."""
    corners_mm: tuple[tuple[float, float, float], ...]
    """Outline of the reflecting face, at least three corners in order, all in one plane."""
    reflectance: float = 0.9
    """Fraction of the light that it reflects, the same in all bands."""

    def __post_init__(self) -> None:
        require(
            self.name in ("left", "right", "tip"),
            f"a mirror is left, right or tip, not '{self.name}'.",
        )
        corners = np.asarray(self.corners_mm, dtype=np.float64)
        require(
            len(corners) >= 3 and corners.shape[1:] == (3,) and bool(np.isfinite(corners).all()),
            f"the {self.name} mirror's corners_mm must be at least three points of three finite"
            " numbers.",
        )
        size = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
        require(bool(size[1] > 1e-3), f"the {self.name} mirror's corners_mm lie on one line.")
        require(
            bool(size[2] <= 1e-3 * size[1]),
            f"the {self.name} mirror's corners_mm do not lie in one plane.",
        )
        require(
            0.0 < self.reflectance <= 1.0,
            f"the {self.name} mirror's reflectance must lie in (0, 1].",
        )
        require(
            abs(float(self.normal[2])) > 0.1,
            f"the {self.name} mirror stands upright: the camera cannot see anything in it; lean it"
            " by about 45 deg.",
        )

    @property
    def point_mm(self) -> NDArray[np.float64]:
        """(3,) middle of the outline."""
        return np.asarray(np.mean(np.asarray(self.corners_mm, dtype=np.float64), axis=0))

    @property
    def normal(self) -> NDArray[np.float64]:
        """(3,) unit normal of the face that reflects, towards the camera (z > 0)."""
        corners = np.asarray(self.corners_mm, dtype=np.float64)
        _, _, axes = np.linalg.svd(corners - corners.mean(axis=0))
        return np.asarray(axes[2] if axes[2, 2] > 0 else -axes[2])


def vector_at_origin(led: Led) -> NDArray[np.float64]:
    """(3,) direction from the origin to a light, its images in mirrors left out, times its
    irradiance there."""
    vector = led.towards
    distance = float(np.linalg.norm(vector))
    if led.position_mm is not None:
        lobe = (
            float(np.dot(led.axis, -vector) / distance) ** led.lobe_exponent
            if led.lobe_exponent > 0
            else 1.0
        )
        vector = led.intensity * lobe * vector / distance**3 * 1e4
    else:
        vector = led.intensity * vector / distance
    for second in led.also:
        if not second.reflected:
            vector = vector + vector_at_origin(second)
    return vector


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera that looks down on the finger plane."""

    px_per_mm: float
    """Pixels per millimetre on the finger plane; assumed where `scale_known` is false."""
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
    """Fall-off of the lens towards the corners: brightness is 1 + a r^2 + b r^4 + ..., r the
    distance from the image's centre over half its diagonal. Images are divided by it."""
    crosstalk: NDArray[np.float64] | None = None
    """3 x 3: signal of the red, green and blue pixels (rows) under a red, a green and a blue LED
    (columns), each row relative to its own colour. None: every LED is seen by the pixels of its own
    colour alone."""
    scale_known: bool = True
    """False: nobody has measured `px_per_mm`; it is assumed, so that the methods have mm to work
    with (:func:`camera_without_scale`)."""

    def __post_init__(self) -> None:
        require(
            self.scale_known or self.model == "orthographic",
            "a perspective camera needs its scale: camera.px_per_mm is missing.",
        )
        if self.crosstalk is not None:
            mixing = np.asarray(self.crosstalk, dtype=np.float64)
            apart = (
                mixing.shape == (3, 3)
                and bool(np.isfinite(mixing).all())
                and np.linalg.cond(mixing) < 50.0
            )
            require(
                apart,
                "camera.crosstalk must be 3 x 3 finite numbers that separate the three colours.",
            )
        require(
            np.isfinite(self.px_per_mm) and self.px_per_mm > 0,
            "camera.px_per_mm must be a positive number.",
        )
        require(
            np.isfinite(self.height_mm) and self.height_mm > 0,
            "camera.height_mm must be a positive number.",
        )
        require(
            min(self.image_size) > 0,
            f"camera.image_size must be positive, but it is {list(self.image_size)}.",
        )
        require(
            self.model in ("orthographic", "perspective"),
            f"camera.model '{self.model}' is not known.",
        )
        needless = self.model != "perspective" or self.matrix is not None
        require(needless, "a perspective camera needs its matrix.")
        r2 = np.linspace(0.0, 1.0, 101)
        brightness = 1.0 + sum(a * r2 ** (k + 1) for k, a in enumerate(self.shading))
        require(
            bool(np.all(np.isfinite(brightness)) and np.all(brightness > 0.02)),
            "camera.shading leaves no light somewhere in the picture; it must stay above 0.02 of"
            " the middle's.",
        )

    @property
    def pitch_mm(self) -> float:
        """Size of one pixel on the finger plane."""
        return 1.0 / self.px_per_mm

    @property
    def measured_px_per_mm(self) -> float | None:
        """`px_per_mm`, or None where it is assumed."""
        return self.px_per_mm if self.scale_known else None

    @property
    def scale(self) -> str:
        """The scale for people.

        >>> Camera(75.7, (10, 10)).scale, Camera(75.7, (10, 10), scale_known=False).scale
        ('75.7 px/mm', 'scale unknown')
        """
        return f"{self.px_per_mm:.4g} px/mm" if self.scale_known else "scale unknown"


def camera_without_scale(image_size: tuple[int, int]) -> Camera:
    """A camera with parallel rays whose scale nobody measured: its picture of `image_size` (rows,
    columns) is taken to be 25 mm along the shorter side. Sizes that a method has in mm follow that
    guess; slopes do not.
    """
    return Camera(
        px_per_mm=min(image_size) / UNKNOWN_SIDE_MM, image_size=image_size, scale_known=False
    )


@dataclass(frozen=True, slots=True)
class Films:
    """Polarising films by ``splitknit calibrate polarisers``, one entry for each white light of a
    polarised capture."""

    leds: tuple[int, ...]
    """LEDs that light the parallel images."""
    leak: tuple[Annotated[float, Meta(ge=0, le=0.499)], ...]
    """Specular light in the crossed image, of both: about 1 / extinction ratio + sin^2(angle
    error)."""
    brightness: tuple[_Brightness, ...]
    """Red, green, blue: depolarised light of the crossed image over that of the parallel one."""
    shift_px: tuple[Coordinate, Coordinate] = (0.0, 0.0)
    """Columns and rows by which the middle of the crossed image lies right of and below that of the
    parallel one."""
    scale: Annotated[float, Meta(ge=0.9, le=1.1)] = 1.0
    """Size of the crossed image over that of the parallel one."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Rig:
    """Camera, lights, mirrors and films."""

    camera: Camera
    leds: tuple[Led, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    mirrors: tuple[Mirror, ...] = ()
    """Beside the finger; none in the thesis's main rig."""
    films: Films | None = None
    """Polarising films, where they have been measured."""

    def __post_init__(self) -> None:
        names = [mirror.name for mirror in self.mirrors]
        require(
            len(set(names)) == len(names),
            "the rig's mirrors must have different names: left, right, tip.",
        )
        known = self.camera.scale_known or not (
            self.mirrors or any(led.position_mm is not None for led in self.leds)
        )
        require(
            known,
            "LEDs at positions in mm and mirrors need the camera's scale: camera.px_per_mm is"
            " missing.",
        )

    def __repr__(self) -> str:
        leds = ", ".join(
            f"{count} {name}" for name, count in Counter(led.band for led in self.leds).items()
        )
        mirrors = (
            f", mirrors {', '.join(mirror.name for mirror in self.mirrors)}" if self.mirrors else ""
        )
        rows, columns = self.camera.image_size
        return (
            f"Rig({self.camera.model} camera of {rows} x {columns} px, {self.camera.scale}, LEDs:"
            f" {leds}{mirrors})"
        )

    def colours_of(self, groups: Sequence[Sequence[int]]) -> tuple[tuple[str, ...], ...]:
        """Colours of the LEDs of every exposure, for :class:`Band`; nothing where all LEDs are
        white."""
        colours = tuple(tuple(self.leds[index].colour for index in group) for group in groups)
        return colours if any(any(names) for names in colours) else ()

    def lights_of(self, groups: Sequence[Sequence[int]]) -> tuple[tuple[int, ...], ...]:
        """LEDs of every image of :func:`splitknit.imaging.band.linear_stack`: colours that share an
        exposure apart."""
        return _lights(groups, self.colours_of(groups))

    def select(self, groups: Sequence[Sequence[int]]) -> Rig:
        """Return the rig whose `leds[k]` is what lights image k: the LEDs `groups[k]` together."""
        chosen = []
        count = len(self.leds)
        for group in groups:
            require(len(group) > 0, "every image needs at least one LED.")
            wrong = [index for index in group if not 0 <= index < count]
            require(
                not wrong,
                f"LED {wrong[0] if wrong else 0} is not in the rig, which has {count} LEDs (0 to"
                f" {count - 1}).",
            )
            first, *others = (self.leds[index] for index in group)
            chosen.append(replace(first, also=tuple(others)))
        return replace(self, leds=tuple(chosen), films=None)  # which number the rig's LEDs

    @property
    def intensities_assumed(self) -> bool:
        """Whether nobody stated how bright the lights are: those of photographs with a list of
        directions alone."""
        return self.provenance.get("intensities") in {"assumed equal", "estimate"}

    def light_vectors(self) -> NDArray[np.float64]:
        """Distant-light vectors (L, 3): direction from the origin to each LED times its relative
        irradiance there (inverse square of the distance), the mean length one. LEDs that share an
        exposure add.
        """
        vectors = np.array([vector_at_origin(led) for led in self.leds]).reshape(-1, 3)
        lengths = np.linalg.norm(vectors, axis=1)
        require(
            bool((lengths > 0).all()),
            "LEDs that share one exposure cancel each other; correct the rig.",
        )
        return vectors / float(lengths.mean())


def _lights(
    groups: Sequence[Sequence[int]], colours: Sequence[Sequence[str]]
) -> tuple[tuple[int, ...], ...]:
    """The groups of LEDs, those of coloured exposures divided by colour, in the order red, green,
    blue."""
    result: list[tuple[int, ...]] = []
    for group, names in zip(groups, colours or [()] * len(groups), strict=True):
        if not any(names):
            result.append(tuple(group))
            continue
        for colour in COLOURS:
            part = tuple(led for led, name in zip(group, names, strict=True) if name == colour)
            result += [part] if part else []
    return tuple(result)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Band:
    """The images of one spectral band, as stored, not linear: see
    :func:`splitknit.imaging.band.linear_stack`."""

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
    """Fall-off of the lens, see :class:`Camera`."""
    files: tuple[str, ...] = ()
    colours: tuple[tuple[str, ...], ...] = ()
    """`colours[k]` are the colours of the LEDs `leds[k]`, see :class:`Led`; nothing where all are
    white."""
    crosstalk: NDArray[np.float64] | None = None
    """Crosstalk of the camera's pixels, see :class:`Camera`; used where LEDs are coloured."""
    polarisation: str = ""
    """``parallel`` or ``crossed``: the film before the camera beside those before the LEDs; empty
    without films."""
    crossed: Band | None = None
    """The crossed series, image by image. The band's light is then the mean of both, as without
    films."""
    flat: PixelArray | None = None
    """(L, h, w) a flat matt surface, as stored, on a coarse grid, by which images are divided (mean
    one)."""
    promised: FloatArray | None = None
    """(L, h, w) a flat surface's light by the rig: images over `flat` are multiplied by it. Not in
    a file."""
    side: Band | None = None
    """Images lit from the side of the finger, beside those lit from the front. Not in a file."""
    transmission: NDArray[np.float64] | None = None
    """(L, C) by which the light of each image's channels is divided, where films before lights and
    camera differ."""

    def __repr__(self) -> str:
        count, rows, columns, channels = self.pixels.shape
        kind = "colour" if channels == 3 else "grey"
        return (
            f"Band('{self.name}', {count} images of {rows} x {columns} px, {kind},"
            f" {self.pixels.dtype})"
        )

    @property
    def lights(self) -> tuple[tuple[int, ...], ...]:
        """LEDs of every linear image: `leds`, but coloured ones colour by colour; with those of a
        `crossed` series."""
        own = _lights(self.leds, self.colours)
        if self.crossed is None:
            return own
        return tuple(
            tuple(dict.fromkeys(a + b)) for a, b in zip(own, self.crossed.lights, strict=True)
        )

    @property
    def spectral(self) -> str:
        """``white`` or ``nir``: the band of its LEDs."""
        return spectral_band(self.name)

    @property
    def image_names(self) -> tuple[str, ...]:
        """Names of the linear images' files, those of coloured exposures with the colour; numbers
        without files."""
        files = [Path(file).name for file in self.files] or [
            f"image {k}" for k in range(len(self.leds))
        ]
        if not self.colours:
            return tuple(files)
        pairs = zip(files, self.colours, strict=True)
        named = (
            (file, colour) for file, own in pairs for colour in (*COLOURS, "") if colour in own
        )
        return tuple(f"{file}, {colour}" if colour else file for file, colour in named)

    def of_images(self, kept: Sequence[int]) -> Band:
        """The band of some of its images."""
        rows = list(kept)
        parts: dict[str, Any] = {}
        for name in ("pixels", "exposure", "black_level", "flat", "promised", "transmission"):
            array = getattr(self, name)
            parts[name] = None if array is None else array[rows]
        for name in ("leds", "files", "colours"):
            parts[name] = tuple(getattr(self, name)[k] for k in rows) if getattr(self, name) else ()
        return replace(self, **parts)

    def sampled(self, every: int) -> Band:
        """The band in every so many pixels of its rows and columns."""
        step = np.s_[:, ::every, ::every]
        ambient = None if self.ambient is None else self.ambient[step[1:]]
        crossed = None if self.crossed is None else self.crossed.sampled(every)
        return replace(self, pixels=self.pixels[step], ambient=ambient, crossed=crossed)


def coarse_grid(image: FloatArray) -> FloatArray:
    """A flat surface's image (H, W) on the coarse grid, smoothed over its pixels."""
    import cv2  # large

    scale = min(1.0, FLAT_SIDE / max(image.shape))
    size = (max(2, round(image.shape[1] * scale)), max(2, round(image.shape[0] * scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(small if scale == 1.0 else cv2.GaussianBlur(small, (0, 0), 1.0))


def spectral_band(name: str) -> str:
    """Band of the LEDs that light the images of the band `name` of a capture: ``white`` of
    ``white_crossed``."""
    return name.partition("_")[0]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Capture:
    """One finger, photographed once under every LED."""

    rig: Rig
    bands: Mapping[str, Band]
    """``white`` always; ``nir`` where it was captured; ``white_crossed`` where `white` is a
    parallel series."""
    encoding: str = "linear"
    """``linear`` or ``srgb``."""
    material: str = "skin"
    """``skin`` or ``opaque`` (no subsurface scattering to undo)."""
    tip_direction_deg: float | None = None
    """Where the tip points: 0 = row 0, counter-clockwise; None = found (beside mirrors and of
    opaque things: up)."""
    mask: BoolArray | None = None
    """(H, W) given by the user: used as it is."""
    subject: Mapping[str, Any] = field(default_factory=dict)
    captured_at: str | None = None
    truth: Path | None = None
    """A simulator's ``truth.npz``."""
    hashes: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of every file that was read, by its name in the folder."""

    def __repr__(self) -> str:
        bands = ", ".join(repr(band) for band in self.bands.values())
        return f"Capture({bands}, {self.rig.camera.scale}, {self.material}, {self.encoding})"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns of every image."""
        return self.rig.camera.image_size


_PREVIEW, _SAVE = "splitknit.report.result:preview_html", "splitknit.report.result:write_results"
"""What a result does by modules above this one, each imported when it is first used."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Reconstruction:
    """A metric fingerprint on the input's pixel grid."""

    height_mm: FloatArray
    """(H, W) knitted surface, NaN outside the mask."""
    ridge_mm: FloatArray
    """(H, W) relief alone, NaN outside the mask; of an unsplit surface (`whole`) height less its
    slow part."""
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
    """(H, W) x of each pixel's point, NaN outside the mask; None: parallel rays, pixels at their
    pitch."""
    y_mm: FloatArray | None = None
    """(H, W) y, likewise."""
    whole: bool = False
    """Whether the surface was not split (the thesis's EA and PR): its matcher takes the height
    itself as the relief."""
    uncertainty_um: FloatArray | None = None
    """(H, W) standard deviation of the relief where the skin's blur was inverted, NaN outside the
    mask."""
    normals_measured: FloatArray | None = None
    """(H, W, 3) of photometric stereo before integration, zero outside the mask; None without
    (skin)."""
    specular: FloatArray | None = None
    """(H, W) of a polarised capture: what the surface reflects under all lights, of even brightness
    and contrast, in standard deviations from the local mean, NaN outside the mask; see
    :func:`splitknit.imaging.polarised.specular_picture`."""
    colour: FloatArray | None = None
    """(H, W, 3) albedo in red, green and blue, relative, zero outside the mask; None of skin and of
    photographs without colour."""
    scale_known: bool = True
    """False: the scale is unknown, arrays are in mm of an assumed one; files and pages in pixels
    (`unit`)."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    quality: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    """What the pipeline found or assumed (yaw, crease row, scattering, ...)."""
    findings: tuple[Finding, ...] = ()
    """What is wrong with the photographs, or was assumed of them, worst first."""
    timings_s: Mapping[str, float] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        facts = ", ".join(f"{name} {value}" for name, value in self._summary().items())
        return f"Reconstruction({facts})"

    def _repr_html_(self) -> str:
        """Preview and table of a notebook."""
        from html import escape

        rows = "".join(
            f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in self._summary().items()
        )
        warnings = "".join(f"<li>{escape(warning)}</li>" for warning in self.warnings)
        picture = "" if not bool(self.mask.any()) else resolve_name(_PREVIEW)(self)
        return f"{picture}<table>{rows}</table><ul>{warnings}</ul>"

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(map(str, self.findings))

    @property
    def unit(self) -> LengthUnit:
        """What its lengths are written and shown in."""
        return MILLIMETRES if self.scale_known else pixels(self.pitch_mm)

    def _summary(self) -> dict[str, str]:
        known = self.mask & np.isfinite(self.height_mm)
        unit = self.unit
        pitch = f" at {1000 * self.pitch_mm:.1f} um" if unit.known else ", scale unknown"
        summary = {
            "preset": f"'{self.preset}'",
            "size": f"{self.mask.shape[0]} x {self.mask.shape[1]} px{pitch}",
            "area": f"{float(known.sum()) * (self.pitch_mm * unit.per_mm) ** 2:.0f} {unit.name}2",
        }
        if bool(known.any()):
            low, high = np.percentile(self.height_mm[known], (1, 99))
            summary["height range"] = f"{(high - low) * unit.per_mm:.2f} {unit.name}"
            relief = float(np.std(self.ridge_mm[known])) * unit.small_per_mm
            summary["relief"] = f"{relief:.1f} um rms" if unit.known else f"{relief:.2f} px rms"
        return summary | {"warnings": str(len(self.findings))}

    def save(self, folder: str | os.PathLike[str], capture: Capture | None = None) -> None:
        """Write all files of a result: surface, mesh, print, pictures and report.

        Parameters
        ----------
        folder : path
            Appears complete or not at all; an earlier result in it is replaced.
        capture : Capture, optional
            What the result was made from: the report shows its photographs.

        Raises
        ------
        BadInput
            If the folder holds something else, or cannot be written.

        Examples
        --------
        >>> import splitknit
        >>> import splitknit_simulator
        >>> capture, truth = splitknit_simulator.simulate_capture(1, settings={"scale": 0.08})
        >>> splitknit.reconstruct(capture, "ea").save("result", capture)
        """
        resolve_name(_SAVE)(self, capture, folder)


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The part of a reconstruction that prints and matching need."""

    ridge_mm: FloatArray
    shape_mm: FloatArray
    normals: FloatArray
    mask: BoolArray
    pitch_mm: float
    input_from_upright: NDArray[np.float64]
    upright_size: tuple[int, int]
    whole: bool = False
    """See :class:`Reconstruction`."""


UNKNOWN_SCALE = (
    "scale unknown, heights in pixels: give `px_per_mm`, or `ridge_period_mm` 0.45 where it is a"
    " finger."
)
NO_SCALE = (
    "its scale is unknown, and this needs millimetres: give `px_per_mm` (here, or where it is"
    " reconstructed), or `ridge_period_mm` 0.45 to take the scale from the ridges."
)


def require_scale(measured: Camera | Reconstruction) -> None:
    """Raise BadInput where nobody has measured the scale."""
    require(measured.scale_known, NO_SCALE)


def surface_of(result: Reconstruction) -> Surface:
    """Part of a reconstruction that matching needs. Raises BadInput where its scale is unknown."""
    require_scale(result)
    return Surface(**{item.name: getattr(result, item.name) for item in fields(Surface)})


# The thesis's rig as it is drawn.

_LEDS_PER_BAND = 7
"""LEDs of white light, and of near infrared. Source: thesis."""
HALF_ANGLE_DEG = {"white": 30.0, "nir": 20.0}
"""Where a data sheet's LED of 60 (40) deg viewing angle has half its light."""
CROSSTALK: tuple[tuple[float, float, float], ...] = (
    (1.000, 0.136, 0.045),
    (0.218, 1.000, 0.229),
    (0.071, 0.295, 1.000),
)
"""Signal of the red, green and blue pixels (rows) under a red, a green and a blue LED (columns),
each row relative to its own: the IMX219's quantum efficiency under Gaussian lines at 625, 525 and
465 nm, 20, 33 and 24 nm wide. Source: the sensor's quantum efficiency."""


def default_rig(scale: float = 1.0, seed: int | None = None, intensity_spread: float = 0.1) -> Rig:
    """Return the thesis's rig: seven white and seven NIR LEDs on a circle of 52.5 mm at the
    camera's height.

    Raises BadInput if `scale` is out of range. Returns a rig whose LEDs 0 to 6 are white, at
    azimuths 2 pi k / 7, and 7 to 13 NIR, half a step further. `scale`: size of the image relative
    to the full frame of 2200 x 3200 pixels at 75.7 px/mm, in (0, 1]; `seed`: seed of the LEDs'
    individual intensities; None makes all of them one; `intensity_spread`: standard deviation of
    the intensities about one; they stay within 2.5 deviations.
    """
    require(0.0 < scale <= 1.0, f"scale must lie in (0, 1], but it is {scale}.")
    camera = Camera(
        px_per_mm=75.7 * scale,
        image_size=(round(2200 * scale), round(3200 * scale)),
        height_mm=140.0,
    )
    intensities = np.ones(2 * _LEDS_PER_BAND)
    if seed is not None:
        deviations = np.random.default_rng(seed).standard_normal(2 * _LEDS_PER_BAND)
        intensities = 1.0 + intensity_spread * np.clip(deviations, -2.5, 2.5)
    leds = []
    for index in range(2 * _LEDS_PER_BAND):
        nir, k = divmod(index, _LEDS_PER_BAND)
        azimuth = 2.0 * np.pi * (k + 0.5 * nir) / _LEDS_PER_BAND
        position = (float(52.5 * np.cos(azimuth)), float(52.5 * np.sin(azimuth)), 140.0)
        intensity = round(float(intensities[index]), 6)
        leds.append(Led(band="nir" if nir else "white", position_mm=position, intensity=intensity))
    return Rig(
        camera=camera,
        leds=tuple(leds),
        provenance={"source": "digital twin", "intensities": "exact"},
    )


def nominal_rig(scale: float = 1.0) -> Rig:
    """The rig as drawings and data sheets have it: a perspective camera, 7 white and 7 NIR LEDs of
    intensity one with their sheets' lobes, aimed at the origin. `scale`: of the full frame of 2200
    x 3200 pixels, in (0, 1], or BadInput.
    """
    drawn = default_rig(scale)
    rows, columns = drawn.camera.image_size
    focal_px = drawn.camera.px_per_mm * drawn.camera.height_mm
    matrix = np.array(
        [[focal_px, 0.0, (columns - 1) / 2], [0.0, focal_px, (rows - 1) / 2], [0.0, 0.0, 1.0]]
    )
    camera = replace(drawn.camera, model="perspective", matrix=matrix)
    leds = tuple(
        replace(led, lobe_exponent=lobe_exponent(HALF_ANGLE_DEG[led.band])) for led in drawn.leds
    )
    return Rig(camera=camera, leds=leds, provenance={"source": "digital twin", "rig": "as drawn"})


def side_lights(leds: Sequence[Led]) -> tuple[int, ...]:
    """Numbers of the near LEDs that stand more than 60 deg off the camera's axis."""
    places = [(k, led.position_mm) for k, led in enumerate(leds) if led.position_mm is not None]
    return tuple(k for k, (x, y, z) in places if np.hypot(x, y) > z * np.tan(np.deg2rad(60.0)))


def lobe_exponent(half_angle_deg: float) -> float:
    """Exponent m of cos^m that is one half at `half_angle_deg`."""
    require(
        1.0 <= half_angle_deg <= 80.0,
        f"half_angle_deg must lie between 1 and 80, but it is {half_angle_deg}.",
    )
    return float(np.log(0.5) / np.log(np.cos(np.deg2rad(half_angle_deg))))


def shared_exposures(exposures: int) -> tuple[tuple[int, int, int], ...]:
    """Places on the circle, of 3 x `exposures` even ones, of the red, green and blue LED of each
    exposure: those of one lie around the finger, and so do those of a colour. BadInput if it is not
    one to three exposures.
    """
    require(
        1 <= exposures <= 3, f"coloured LEDs take one to three exposures here, not {exposures}."
    )
    count = 3 * exposures
    step = 4 if exposures == 3 else exposures
    return tuple(
        (3 * k, (3 * k + step) % count, (3 * k + 2 * step) % count) for k in range(exposures)
    )
