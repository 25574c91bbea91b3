"""What lights the finger: LEDs, what shades them, and mirrors; frames and units as in :mod:`splitknit.types`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.check import require

COLOURS = ("red", "green", "blue")
"""Of LEDs and of a camera's pixels, in the order of an image's channels."""


@dataclass(frozen=True, slots=True, eq=False)
class Shade:
    """How much of a light reaches the finger, place by place: what is turned away or hidden from it lies in shadow."""

    x_mm: tuple[float, float]
    """x of the first and last column."""
    y_mm: tuple[float, float]
    """y of the first and last row."""
    share: NDArray[np.float32]
    """(h, w) in [0, 1], at least 2 x 2; read bilinearly, and at its border beyond it."""

    def __post_init__(self) -> None:
        require(self.share.ndim == 2 and min(self.share.shape) >= 2, "a light's shade must be at least 2 x 2.")
        require(self.x_mm[0] != self.x_mm[1] and self.y_mm[0] != self.y_mm[1], "a light's shade must have a size.")


@dataclass(frozen=True, slots=True)
class Led:
    """One light: near (`position_mm`) or distant (`direction`, towards the light), never both."""

    band: str
    """``white`` or ``nir``."""
    position_mm: tuple[float, float, float] | None = None
    direction: tuple[float, float, float] | None = None
    intensity: float = 1.0
    """Relative, one scale for the whole rig."""
    lobe_exponent: float = 0.0
    """Exponent of the cosine about the LED's axis; 0 is isotropic."""
    aim: tuple[float, float, float] | None = None
    """Direction of a near LED's axis, from the LED outwards; None = towards the origin."""
    also: tuple[Led, ...] = ()
    """Further LEDs lit in the same exposure."""
    reflected: bool = False
    """The image of an LED in a mirror: it may lie below the finger plane, aimed anywhere. Never in a rig file. Where an
    exposure is spoken of as one light (:meth:`splitknit.types.Rig.light_vectors`), the images among `also` are left
    out."""
    shade: Shade | None = None
    """Where its light does not reach the finger; None: it reaches everything. Never in a rig file."""
    colour: str = ""
    """``red``, ``green`` or ``blue``; empty: white, or of the whole band."""

    def __post_init__(self) -> None:
        require(
            self.colour == "" or self.colour in COLOURS,
            f"an LED's colour is red, green or blue (or none), not '{self.colour}'.",
        )
        require(self.colour == "" or self.band == "white", "only LEDs of the band 'white' may have a colour.")
        require(
            (self.position_mm is None) != (self.direction is None),
            "an LED has either position_mm (near) or direction (distant), not both and not neither.",
        )
        vector = self.position_mm if self.position_mm is not None else self.direction
        require(
            vector is not None and bool(np.isfinite(vector).all()) and bool(np.linalg.norm(vector) > 0),
            "an LED's position_mm or direction must be three finite numbers that are not all zero.",
        )
        require(np.isfinite(self.intensity) and self.intensity > 0, "an LED's intensity must be a positive number.")
        require(
            np.isfinite(self.lobe_exponent) and self.lobe_exponent >= 0,
            "an LED's lobe_exponent must be zero or a positive number.",
        )
        if self.position_mm is not None and not self.reflected:
            require(self.position_mm[2] > 0, "an LED's position_mm must lie above the finger plane (z > 0).")
        if self.aim is not None and vector is not None:
            require(self.position_mm is not None, "an LED's aim needs its position_mm: distant light has no axis.")
            require(
                bool(np.isfinite(self.aim).all()) and float(np.linalg.norm(self.aim)) > 0,
                "an LED's aim must be three finite numbers that are not all zero.",
            )
            towards = -float(np.dot(self.aim, vector)) / float(np.linalg.norm(self.aim) * np.linalg.norm(vector))
            require(
                self.reflected or towards > 0.2,
                "an LED's aim must point towards the finger plane's middle, within 78 deg.",
            )

    @property
    def axis(self) -> NDArray[np.float64]:
        """(3,) unit vector of the beam, from the LED outwards."""
        if self.aim is not None:
            return np.asarray(self.aim, dtype=np.float64) / float(np.linalg.norm(self.aim))
        vector = np.asarray(self.position_mm if self.position_mm is not None else self.direction, dtype=np.float64)
        return np.asarray(-vector / np.linalg.norm(vector))


@dataclass(frozen=True, slots=True)
class Mirror:
    """A plane mirror beside the finger, in the rig's frame, as it was built: its true pose differs a little."""

    name: str
    """``left`` (x < 0), ``right`` (x > 0) or ``tip`` (beyond the fingertip)."""
    corners_mm: tuple[tuple[float, float, float], ...]
    """Outline of the reflecting face, at least three corners in order, all in one plane."""
    reflectance: float = 0.9
    """Share of the light that it reflects, the same in all bands."""

    def __post_init__(self) -> None:
        require(self.name in ("left", "right", "tip"), f"a mirror is left, right or tip, not '{self.name}'.")
        corners = np.asarray(self.corners_mm, dtype=np.float64)
        require(
            corners.ndim == 2 and corners.shape[0] >= 3 and corners.shape[1] == 3 and bool(np.isfinite(corners).all()),
            f"the {self.name} mirror's corners_mm must be at least three points of three finite numbers.",
        )
        centred = corners - corners.mean(axis=0)
        size = np.linalg.svd(centred, compute_uv=False)
        require(bool(size[1] > 1e-3), f"the {self.name} mirror's corners_mm lie on one line.")
        require(bool(size[2] <= 1e-3 * size[1]), f"the {self.name} mirror's corners_mm do not lie in one plane.")
        require(0.0 < self.reflectance <= 1.0, f"the {self.name} mirror's reflectance must lie in (0, 1].")
        require(
            abs(float(self.normal[2])) > 0.1,
            f"the {self.name} mirror stands upright: the camera cannot see anything in it; lean it by about 45 deg.",
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
    """(3,) direction from the origin to a light, its images in mirrors left out, times its irradiance there."""
    if led.position_mm is not None:
        position = np.asarray(led.position_mm, dtype=np.float64)
        distance = float(np.linalg.norm(position))
        lobe = float(np.dot(led.axis, -position) / distance) ** led.lobe_exponent if led.lobe_exponent > 0 else 1.0
        vector = led.intensity * lobe * position / distance**3 * 1e4
    else:
        direction = np.asarray(led.direction, dtype=np.float64)
        vector = led.intensity * direction / np.linalg.norm(direction)
    for other in led.also:
        if not other.reflected:
            vector = vector + vector_at_origin(other)
    return np.asarray(vector, dtype=np.float64)
