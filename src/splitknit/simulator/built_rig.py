"""The rig as it is drawn, and as a person builds it: printed parts, common LEDs, a small lens, nothing in place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Camera, Led, Rig
from splitknit.simulator.rig import default_rig

HALF_ANGLE_DEG = {"white": 30.0, "nir": 20.0}
"""Where a data sheet's LED of 60 (40) deg viewing angle has half its light."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """How far a built rig is from its drawing: standard deviations, cut at 2.5 of them, unless another word is said."""

    led_position_mm: float = 0.7
    """Per axis: a printed hole is 0.2 to 0.3 mm off, a 5 mm LED's collar rocks in its seat, and its die is up to 0.3 mm
    off its lens's axis and 1 mm along it from lot to lot."""
    led_beam_deg: float = 2.0
    """Per axis: data sheets of 5 mm LEDs allow the beam +-5 deg against the package (2 deg as a deviation); the seat
    adds half a degree."""
    led_half_angle: float = 0.08
    """Relative, of the angle at which an LED has half its light: lots of one type differ by 5 to 10 %."""
    led_intensity: float = 0.1
    """Relative: one brightness bin of LEDs spans about a factor of 1.4, and 5 % resistors add to it."""
    focal_length: float = 0.01
    """Relative: focal lengths of board lenses are stated to 1 or 2 %, and turning the lens for focus changes them."""
    camera_height_mm: float = 0.5
    """Of the lens's pupil: printed height 0.2 mm, and the pupil's place in the lens is not on its drawing."""
    camera_tilt_deg: float = 0.3
    """Per axis, of the camera against the base: 0.15 mm over a seat of 25 mm."""
    camera_shift_mm: float = 0.3
    """Per axis, of the camera against the LEDs' circle: the play of its screws."""
    principal_point: float = 0.005
    """Per axis, of the image's width: a lens holder is glued within 0.02 mm on a sensor 3.7 mm wide."""
    corner_distortion: float = 0.005
    """Largest shift of the image's corners by distortion, relative (evenly drawn, either sign): long lenses distort by
    well below 1 %."""
    corner_vignetting: tuple[float, float] = (0.10, 0.20)
    """Light lost at the corners beside the cosine law (evenly drawn): small lenses cut oblique beams."""

    def __post_init__(self) -> None:
        for name, high in (
            ("led_position_mm", 10.0),
            ("led_beam_deg", 15.0),
            ("led_half_angle", 0.3),
            ("led_intensity", 0.3),
            ("focal_length", 0.2),
            ("camera_height_mm", 20.0),
            ("camera_tilt_deg", 5.0),
            ("camera_shift_mm", 10.0),
            ("principal_point", 0.1),
            ("corner_distortion", 0.05),
        ):
            value = getattr(self, name)
            require(0.0 <= value <= high, f"tolerances.{name} must lie between 0 and {high}, but it is {value}.")
        low, high = self.corner_vignetting
        require(0.0 <= low <= high <= 0.8, "tolerances.corner_vignetting must be (low, high) within 0 to 0.8.")


def nominal_rig(scale: float = 1.0) -> Rig:
    """Return the rig as the drawings and data sheets have it, with a perspective camera.

    Parameters
    ----------
    scale : size of the image relative to the full frame of 2200 x 3200 pixels, in (0, 1]

    Returns
    -------
    Rig of 7 white and 7 NIR LEDs of intensity one, aimed at the origin, with their data sheets' lobes

    Raises
    ------
    BadInput
        If `scale` is out of range.
    """
    drawn = default_rig(scale)
    rows, columns = drawn.camera.image_size
    focal_px = drawn.camera.px_per_mm * drawn.camera.height_mm
    matrix = np.array([[focal_px, 0.0, (columns - 1) / 2], [0.0, focal_px, (rows - 1) / 2], [0.0, 0.0, 1.0]])
    camera = replace(drawn.camera, model="perspective", matrix=matrix)
    leds = tuple(replace(led, lobe_exponent=lobe_exponent(HALF_ANGLE_DEG[led.band])) for led in drawn.leds)
    return Rig(camera=camera, leds=leds, provenance={"source": "digital twin", "rig": "as drawn"})


def built_rig(seed: int, *, scale: float = 1.0, tolerances: Tolerances | None = None) -> Rig:
    """Return the rig as a person builds it: the truth that calibration has to find.

    Parameters
    ----------
    seed : one rig each, the same at every `scale`
    scale : size of the image relative to the full frame of 2200 x 3200 pixels, in (0, 1]
    tolerances : of parts and hands

    Returns
    -------
    Rig in its own camera's frame: the camera stands on z and looks straight down it, so that an oblique camera moves
    the LEDs. `provenance` has ``base_tilt_deg``: how the base lies in this frame (`tilt_deg` of the bench's scenes).

    Raises
    ------
    BadInput
        If `scale` or `seed` is out of range.
    """
    require(seed >= 0, f"seed must not be negative, but it is {seed}.")
    tolerances = tolerances or Tolerances()
    drawn = nominal_rig(scale)
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0xB1]))
    camera = _built_camera(drawn.camera, tolerances, rng)
    shift = np.array([*(tolerances.camera_shift_mm * _normal(rng, 2)), 0.0])
    tilt_deg = tolerances.camera_tilt_deg * _normal(rng, 2)
    # seen from the camera, which is oblique in its seat beside the LEDs, all the rest is turned about the camera
    turn = np.asarray(cv2.Rodrigues(np.array([*np.deg2rad(tilt_deg), 0.0]))[0], dtype=np.float64)
    seat = np.array([0.0, 0.0, camera.height_mm])
    leds = tuple(_built_led(led, tolerances, rng, (turn, seat, shift)) for led in drawn.leds)
    provenance = {
        "source": "digital twin",
        "rig": "as built",
        "seed": seed,
        "base_tilt_deg": [round(float(t), 6) for t in tilt_deg],
    }
    return Rig(camera=camera, leds=leds, provenance=provenance)


def lobe_exponent(half_angle_deg: float) -> float:
    """Exponent m of cos^m that is one half at `half_angle_deg`."""
    require(1.0 <= half_angle_deg <= 80.0, f"half_angle_deg must lie between 1 and 80, but it is {half_angle_deg}.")
    return float(np.log(0.5) / np.log(np.cos(np.deg2rad(half_angle_deg))))


def _built_camera(drawn: Camera, tolerances: Tolerances, rng: np.random.Generator) -> Camera:
    assert drawn.matrix is not None
    rows, columns = drawn.image_size
    focal, height, *offset = _normal(rng, 4)
    distortion, vignetting = rng.random(2)
    focal_px = float(drawn.matrix[0, 0]) * (1.0 + tolerances.focal_length * focal)
    height_mm = drawn.height_mm + tolerances.camera_height_mm * height
    middle = np.array([columns - 1, rows - 1]) / 2 + tolerances.principal_point * columns * np.array(offset)
    matrix = np.array([[focal_px, 0.0, middle[0]], [0.0, focal_px, middle[1]], [0.0, 0.0, 1.0]])
    corner2 = (rows**2 + columns**2) / (4.0 * focal_px**2)  # squared tangent of the field angle at the corners
    low, high = tolerances.corner_vignetting
    lost = low + (high - low) * vignetting
    return replace(
        drawn,
        px_per_mm=float(focal_px / height_mm),
        height_mm=float(height_mm),
        matrix=matrix,
        distortion=(float(tolerances.corner_distortion * (2.0 * distortion - 1.0) / corner2), 0.0, 0.0, 0.0, 0.0),
        # cos^4 = (1 + tan^2)^-2 = 1 - 2 tan^2 + 3 tan^4 - ..., and vignetting, which sets in late
        shading=(float(-2.0 * corner2), float(3.0 * corner2**2 - lost)),
    )


def _built_led(
    drawn: Led,
    tolerances: Tolerances,
    rng: np.random.Generator,
    seen_from_camera: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
) -> Led:
    turn, seat, shift = seen_from_camera
    position = np.asarray(drawn.position_mm) + tolerances.led_position_mm * _normal(rng, 3) + shift
    position = turn @ (position - seat) + seat
    first, second = np.tan(np.deg2rad(tolerances.led_beam_deg * _normal(rng, 2)))
    aim = turn @ drawn.axis
    across = np.cross(aim, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    aim = aim + first * across + second * np.cross(aim, across)
    aim /= np.linalg.norm(aim)
    half_angle, intensity = _normal(rng, 2)
    angle = HALF_ANGLE_DEG[drawn.band] * (1.0 + tolerances.led_half_angle * half_angle)
    return replace(
        drawn,
        position_mm=(float(position[0]), float(position[1]), float(position[2])),
        aim=(float(aim[0]), float(aim[1]), float(aim[2])),
        lobe_exponent=round(lobe_exponent(angle), 6),
        intensity=round(float(1.0 + tolerances.led_intensity * intensity), 6),
    )


def _normal(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Normal deviates, cut at 2.5: parts that are further off are thrown away."""
    return np.clip(rng.standard_normal(count), -2.5, 2.5)
