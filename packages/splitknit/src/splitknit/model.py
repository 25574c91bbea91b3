"""What travels together: frozen dataclasses shared by all stages.

Axes, units and signs are in ``docs/explain/conventions.md``. The rig's frame has x right along the
columns, y up against the rows, z towards the camera, in millimetres; its origin is where the
camera's axis meets the finger plane.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from splitknit.errors import require

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
    return Camera(px_per_mm=min(image_size) / 25.0, image_size=image_size, scale_known=False)


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
        """Colours of the LEDs of every exposure; nothing where all LEDs are
        white."""
        colours = tuple(tuple(self.leds[index].colour for index in group) for group in groups)
        return colours if any(any(names) for names in colours) else ()

    def lights_of(self, groups: Sequence[Sequence[int]]) -> tuple[tuple[int, ...], ...]:
        """LEDs of every image of linear light: those of coloured exposures colour by colour, in the
        order red, green, blue."""
        lights: list[tuple[int, ...]] = []
        for group, names in zip(groups, self.colours_of(groups) or [()] * len(groups), strict=True):
            if not any(names):
                lights.append(tuple(group))
                continue
            for colour in COLOURS:
                part = tuple(led for led, name in zip(group, names, strict=True) if name == colour)
                lights += [part] if part else []
        return tuple(lights)

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
