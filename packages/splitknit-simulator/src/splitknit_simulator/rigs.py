"""Rigs that the simulator photographs with: as a person builds them, with coloured LEDs, with
mirrors.

The rig as it is drawn is :func:`splitknit.nominal.default_rig`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import cv2
import numpy as np

from splitknit import Camera, Led, Mirror, Rig
from splitknit.errors import require
from splitknit.model import COLOURS, Array
from splitknit.nominal import (
    CROSSTALK,
    HALF_ANGLE_DEG,
    default_rig,
    lobe_exponent,
    nominal_rig,
    shared_exposures,
)
from splitknit.settings import Checked, Limits, check_fields


def triple(values: Array) -> tuple[float, float, float]:
    """Three numbers of an array (3,)."""
    return float(values[0]), float(values[1]), float(values[2])


_SIDE_ARC_DEG = (-25.0, 205.0)
"""Azimuths of the first and the last light to the side. Source: drawing, hardware/films.py."""
_SIDE_RADIUS_MM = 90.0
"""Distance of the side lights from the axis. Source: drawing, hardware/films.py."""
_SIDE_HEIGHT_MM = 30.0
"""Height of the side lights above the finger plane. Source: drawing, hardware/films.py."""


def with_side_lights(rig: Rig, count: int) -> Rig:
    """The rig with `count` further white LEDs to the side of the finger, as bright at the origin as
    a ring's."""
    if count == 0:
        return rig
    radius, height = _SIDE_RADIUS_MM, _SIDE_HEIGHT_MM
    intensity = round((radius**2 + height**2) / rig.camera.height_mm**2, 6)
    added = []
    for azimuth in np.deg2rad(np.linspace(*_SIDE_ARC_DEG, count) if count > 1 else [90.0] * count):
        place = float(radius * np.cos(azimuth)), float(radius * np.sin(azimuth)), height
        added.append(Led(band="white", position_mm=place, intensity=intensity))
    return replace(rig, leds=(*rig.leds, *added))


# As a person builds it: printed parts, common LEDs, a small lens, nothing in place. Numbers are
# standard deviations.


def built_rig(seed: int, *, scale: float = 1.0) -> Rig:
    """Return the rig as a person builds it: the truth that calibration has to find; one for each
    `seed`, the same at every `scale` in (0, 1] of the full frame of 2200 x 3200 pixels.

    The camera stands on z and looks straight down it, so that an oblique camera moves the LEDs.
    `provenance` has ``base_tilt_deg``: how the base lies in this frame (`tilt_deg` of the bench's
    scenes).
    """
    require(seed >= 0, f"seed must not be negative, but it is {seed}.")
    drawn = nominal_rig(scale)
    rng = np.random.default_rng([seed, 0xB1])
    camera = _built_camera(drawn.camera, rng)
    shift = np.array([*(0.3 * _normal(rng, 2)), 0.0])  # the play of the camera's screws
    tilt_deg = 0.3 * _normal(rng, 2)  # 0.15 mm over a seat of 25 mm
    # seen from the camera, which is oblique in its seat beside the LEDs, all the rest is turned
    # about the camera
    turn = np.asarray(cv2.Rodrigues(np.array([*np.deg2rad(tilt_deg), 0.0]))[0], dtype=np.float64)
    seat = np.array([0.0, 0.0, camera.height_mm])
    leds = tuple(_built_led(led, rng, (turn, seat, shift)) for led in drawn.leds)
    tilt = [round(float(t), 6) for t in tilt_deg]
    provenance = {"source": "digital twin", "rig": "as built", "seed": seed, "base_tilt_deg": tilt}
    return Rig(camera=camera, leds=leds, provenance=provenance)


def _built_camera(drawn: Camera, rng: np.random.Generator) -> Camera:
    assert drawn.matrix is not None
    rows, columns = drawn.image_size
    focal, height, *offset = _normal(rng, 4)
    distortion, vignetting = rng.random(2)
    # board lenses are stated to 1 or 2 %, and turning them for focus changes it
    focal_px = float(drawn.matrix[0, 0]) * (1.0 + 0.01 * focal)
    # 0.2 mm of the print, and the pupil's place in the lens, which its drawing lacks
    height_mm = drawn.height_mm + 0.5 * height
    # a lens holder is glued within 0.02 mm on a sensor 3.7 mm wide
    middle = np.array([columns - 1, rows - 1]) / 2 + 0.005 * columns * np.array(offset)
    matrix = np.array([[focal_px, 0.0, middle[0]], [0.0, focal_px, middle[1]], [0.0, 0.0, 1.0]])
    # squared tangent of the field angle at the corners
    corner2 = (rows**2 + columns**2) / (4.0 * focal_px**2)
    # light lost at the corners beside the cosine law: small lenses cut oblique beams
    low, high = 0.10, 0.20
    lost = low + (high - low) * vignetting
    return replace(
        drawn,
        px_per_mm=float(focal_px / height_mm),
        height_mm=float(height_mm),
        matrix=matrix,
        # long lenses shift the corners by less than 1 %
        distortion=(
            float(0.005 * (2.0 * distortion - 1.0) / corner2),
            0.0,
            0.0,
            0.0,
            0.0,
        ),
        # cos^4 = (1 + tan^2)^-2 = 1 - 2 tan^2 + 3 tan^4 - ..., and vignetting, which sets in late
        shading=(float(-2.0 * corner2), float(3.0 * corner2**2 - lost)),
    )


_LED_POSITION_SD_MM = 0.7
"""Standard deviation of a built LED's position, per axis: a printed hole is 0.2 to 0.3 mm off, a 5
mm LED's collar rocks in its seat, and its die is up to 0.3 mm off its lens's axis and 1 mm along it
from lot to lot."""


def _built_led(
    drawn: Led, rng: np.random.Generator, seen_from_camera: tuple[Array, Array, Array]
) -> Led:
    turn, seat, shift = seen_from_camera
    position = np.asarray(drawn.position_mm) + _LED_POSITION_SD_MM * _normal(rng, 3) + shift
    position = turn @ (position - seat) + seat
    # data sheets allow +-5 deg between beam and package (2 as a deviation); the seat adds 0.5
    first, second = np.tan(np.deg2rad(2.0 * _normal(rng, 2)))
    aim = turn @ drawn.axis
    across = np.cross(aim, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    aim = aim + first * across + second * np.cross(aim, across)
    aim /= np.linalg.norm(aim)
    half_angle, intensity = _normal(rng, 2)
    # lots of one type differ by 5 to 10 %
    angle = HALF_ANGLE_DEG[drawn.band] * (1.0 + 0.08 * half_angle)
    return replace(
        drawn,
        position_mm=triple(position),
        aim=triple(aim),
        lobe_exponent=round(lobe_exponent(angle), 6),
        # one brightness bin spans a factor of 1.4; 5 % resistors add to it
        intensity=round(float(1.0 + 0.1 * intensity), 6),
    )


def _normal(rng: np.random.Generator, count: int) -> Array:
    """Normal deviates, cut at 2.5: parts that are further off are thrown away."""
    return np.clip(rng.standard_normal(count), -2.5, 2.5)


CURRENTS = {"red": 1.0, "green": 1.6, "blue": 1.9}
"""Intensities by which light skin fills the three channels about equally."""


# With coloured LEDs.


def coloured_rig(scale: float = 1.0, seed: int | None = None, exposures: int = 2) -> Rig:
    """Return the thesis's rig with 3 x `exposures` (1 to 3) coloured LEDs on the circle of its
    seven white ones."""
    plain = default_rig(scale, seed)
    count = 3 * exposures
    colours = {
        place: c
        for triple in shared_exposures(exposures)
        for place, c in zip(triple, COLOURS, strict=True)
    }
    deviations = (
        np.zeros(count) if seed is None else _normal(np.random.default_rng([seed, 0xC0]), count)
    )
    leds = []
    for k, deviation in enumerate(deviations):
        azimuth = 2.0 * np.pi * k / count
        position = (float(52.5 * np.cos(azimuth)), float(52.5 * np.sin(azimuth)), 140.0)
        intensity = round(
            float(CURRENTS[colours[k]] * (1.0 + 0.1 * deviation)),  # 10 %, as of the white LEDs
            6,
        )
        leds.append(Led(band="white", position_mm=position, intensity=intensity, colour=colours[k]))
    camera = replace(plain.camera, crosstalk=np.array(CROSSTALK))
    invisible = tuple(led for led in plain.leds if led.band == "nir")
    return replace(plain, camera=camera, leds=(*leds, *invisible))


SIDES = ("left", "right", "tip")

# The printed parts that carry the mirrors: those of a rig whose mirrors show the whole side of most
# fingers, larger than the reference ones.

_CLEARANCE_MM = 0.2
"""Clearance of all joints. Source: drawing, hardware/sizes.py."""
_FINGER_CLEARANCE_MM = 2.0
"""Between the widest finger and the walls of the groove, both sides together. Source: drawing,
hardware/sizes.py."""
_PHALANX_MM = 30.0
"""Length of the last phalanx, tip to crease: in a large picture its centre is the picture's.
Source: drawing, hardware/sizes.py."""
_MIRROR_LONG_MM = 30.0
"""Length of a mirror along its lower edge. Source: drawing, hardware/sizes.py."""
_MIRROR_WIDE_MM = 30.0
"""Length of a mirror up its slope. Source: drawing, docs/guide/rig-build.md, mirrors."""
_MIRROR_THICK_MM = 2.0
"""Thickness of a mirror's glass. Source: drawing, hardware/sizes.py."""
_HOLDER_GAP_MM = 1.0
"""Between the groove's block and a holder. Source: drawing, hardware/sizes.py."""
_LIP_MM = 0.8
"""How much of the mirror's lower edge the holder's lip covers. Source: drawing,
hardware/sizes.py."""
_WALL_MM = 2.4
"""Thickness of the printed walls: the groove's, the stop's, and the holder's top behind the mirror.
Source: drawing, hardware/dimensions.toml."""
_PAD_HEIGHT_MM = 21.2
"""Height of the finger plane over the groove's bottom. Source: drawing, docs/guide/rig-build.md,
mirrors."""
_WIDEST_FINGER_MM = 22.0
"""Width of the widest finger. Source: drawing, docs/guide/rig-build.md, mirrors."""
_TIP_MARGIN_MM = 27.0
"""From the fingertip's stop to the picture's upper border. Source: drawing,
docs/guide/rig-build.md, mirrors."""


@dataclass(frozen=True, slots=True)
class MirrorSettings(Checked):
    """What the twin's mirrors are; without names there are none."""

    _group = "mirrors"

    names: tuple[str, ...] = ()
    """Any of ``left``, ``right`` and ``tip``. A given rig with mirrors keeps its own."""
    reflectance: Annotated[float, Limits(1e-6, 1.0)] = 0.9
    """Fraction of the light that a mirror reflects: aluminium on the face, protected, 0.85 to
    0.92."""
    turn_sd_deg: Annotated[float, Limits(0.0, 10.0)] = 1.0
    """Standard deviation, about each axis, of the true mirrors against the drawing: a glued holder,
    a mirror that rocks in its seat. Poses are the same in all impressions of a finger."""
    shift_sd_mm: Annotated[float, Limits(0.0, 10.0)] = 0.7
    """Standard deviation of the true mirrors' places against the drawing, along each axis; 0 to
    10."""
    px_per_mm: Annotated[float, Limits(1.0, 200.0)] = 43.0
    """Scale of the full frame: all views must fit."""
    image_size: Annotated[tuple[int, int], Limits(64)] = (2464, 3280)
    """Rows and columns of the full frame: all of the IMX219."""
    model: Literal["orthographic", "perspective"] = "orthographic"
    """Model of the camera: ``orthographic``, or ``perspective`` from 140 mm with a lens without
    distortion. A given `rig` has its own camera."""
    nir: bool = True
    """Whether the rig has its NIR LEDs: mirrors can do without."""
    ridges_to_deg: Annotated[float, Limits(60.0, 180.0)] = 112.0
    """Around the finger, from the pad's top: there the ridged skin ends; 180: it goes all
    around."""
    truth_pitch_mm: Annotated[float, Limits(0.02, 2.0)] = 0.08
    """Spacing of the grid around the finger in the truth."""

    def __post_init__(self) -> None:
        check_fields(self)
        known = all(name in SIDES for name in self.names) and len(set(self.names)) == len(
            self.names
        )
        require(
            known,
            "mirrors.names are some of left, right and tip, each once, but they are"
            f" {list(self.names)}.",
        )

    def leds_of(self, rig: Rig) -> tuple[Led, ...]:
        """The rig's LEDs, without NIR ones where `nir` is false."""
        return tuple(led for led in rig.leds if self.nir or led.band != "nir")


# With mirrors, as it is drawn.

_COS_45 = math.sqrt(0.5)
"""Cosine and sine of the mirrors' slope, 45 deg. Source: definition."""
_LIP_WALL_MM = 1.2
"""Thickness of the holder's lip. Source: drawing, hardware/geometry.py."""
_GROOVE_IN_FLOOR_MM = 0.4
"""How far the groove's bottom lies below the base's upper face. Source: drawing,
hardware/geometry.py."""
_POCKET_MM = 1.0
"""Depth of the pockets of the base in which the holders stand. Source: drawing,
hardware/geometry.py."""


def mirror_rig(views: MirrorSettings, scale: float, seed: int | None = None) -> Rig:
    """Return the thesis's rig with a camera that sees the mirrors too, and the mirrors where the
    drawing has them."""
    rig = default_rig(scale, seed)
    rows, columns = (round(side * scale) for side in views.image_size)
    camera = replace(rig.camera, px_per_mm=views.px_per_mm * scale, image_size=(rows, columns))
    if views.model == "perspective":
        focal_px = camera.px_per_mm * camera.height_mm
        matrix = np.array(
            [[focal_px, 0.0, (columns - 1) / 2], [0.0, focal_px, (rows - 1) / 2], [0.0, 0.0, 1.0]]
        )
        camera = replace(camera, model="perspective", matrix=matrix)
    mirrors = _nominal_mirrors(views, camera)
    return replace(rig, camera=camera, leds=views.leds_of(rig), mirrors=mirrors)


def _nominal_mirrors(views: MirrorSettings, camera: Camera) -> tuple[Mirror, ...]:
    """Return the mirrors as drawn: the part of each face that the holder's lip leaves free."""
    face = holder_profile()["face"]
    quads = (holder_quad(name, camera, *face).tolist() for name in views.names)
    return tuple(
        Mirror(name, tuple((x, y, z) for x, y, z in quad), views.reflectance)
        for name, quad in zip(views.names, quads, strict=True)
    )


def stop_y_mm(camera: Camera) -> float:
    """Return where the fingertip stops, in the rig's frame."""
    return min(camera.image_size[0] / camera.px_per_mm / 2 - _TIP_MARGIN_MM, _PHALANX_MM / 2)


def holder_profile() -> dict[str, tuple[Array, Array]]:
    """Return lines in the section of a holder with its mirror, each between two points (distance
    from the holder's front, height over its foot), mm.

    ``face``: the mirror's free face, from its lower to its upper end; ``glass``: its ground upper
    edge, from front to back; ``lip``: the lip's end, from its inner to its outer edge;
    ``lip_front``: from there to where the lip's outer face meets the holder's front; ``shade``:
    what stands before the mirror below that edge, seen from the mirror, dark; ``back``: the
    holder's top behind the mirror.
    """
    along, behind = np.array([_COS_45, _COS_45]), np.array([_COS_45, -_COS_45])
    front = np.array(
        [
            (_CLEARANCE_MM + _LIP_WALL_MM) * _COS_45 + 0.2,
            (_MIRROR_THICK_MM + _CLEARANCE_MM) * _COS_45 + _LIP_WALL_MM,
        ]
    )
    low, high = front + _LIP_MM * along, front + _MIRROR_WIDE_MM * along
    inside = front - _CLEARANCE_MM * behind
    outside = inside - _LIP_WALL_MM * behind
    start = np.array([0.0, outside[1] - outside[0]])
    inside, outside = inside + _LIP_MM * along, outside + _LIP_MM * along
    edge = high + (_MIRROR_THICK_MM + _CLEARANCE_MM) * behind
    return {
        "face": (low, high),
        "glass": (high, high + _MIRROR_THICK_MM * behind),
        "lip": (inside, outside),
        "lip_front": (outside, start),
        "shade": (outside - np.array([0.0, 8.0]), outside),
        "back": (edge, edge + np.array([_WALL_MM, 0.0])),
    }


def holder_quad(name: str, camera: Camera, low: Array, high: Array) -> Array:
    """(4, 3) rectangle between two points of the section, along the whole holder `name`, in the
    rig's frame."""
    stop = stop_y_mm(camera)
    foot = -_PAD_HEIGHT_MM + _GROOVE_IN_FLOOR_MM - _POCKET_MM
    half = _MIRROR_LONG_MM / 2
    side = (_WIDEST_FINGER_MM + _FINGER_CLEARANCE_MM) / 2 + _WALL_MM + _HOLDER_GAP_MM
    middle, tip = stop + 1.0 - half, stop + _WALL_MM + _HOLDER_GAP_MM
    corners = [(low, -half), (low, half), (high, half), (high, -half)]
    if name == "tip":
        return np.array([(along, tip + u, foot + v) for (u, v), along in corners])
    sign = 1.0 if name == "right" else -1.0
    return np.array([(sign * (side + u), middle + along, foot + v) for (u, v), along in corners])
