"""A capture as files hold it: stored values, not light (:mod:`splitknit.observation` makes it)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.model import BoolArray, PixelArray, Rig


@dataclass(frozen=True, slots=True, eq=False)
class Ambient:
    """A photograph with all LEDs off, as stored."""

    pixels: PixelArray
    """(H, W, C)."""
    exposure: float = 1.0
    """As of :class:`Band`."""
    black_level: float = 0.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Band:
    """The photographs of one spectral band, as stored; :mod:`splitknit.observation` makes linear
    light of them."""

    name: str
    pixels: PixelArray
    """(L, H, W, C), C = 1 (grey) or 3 (red, green, blue)."""
    leds: tuple[tuple[int, ...], ...]
    """`leds[k]` are the indices of the rig's LEDs that light image k."""
    exposure: NDArray[np.float64]
    """(L,) exposure time times gain, relative; images are divided by it."""
    black_level: NDArray[np.float64]
    """(L,) stored value of no light."""
    ambient: Ambient | None = None
    files: tuple[str, ...] = ()
    polarisation: str = ""
    """``parallel`` or ``crossed``: the film before the camera beside those before the LEDs; empty
    without films."""
    flat: PixelArray | None = None
    """(L, h, w) a flat matt surface, as stored, on a coarse grid, by which images are divided (mean
    one)."""

    def __repr__(self) -> str:
        count, rows, columns, channels = self.pixels.shape
        kind = "colour" if channels == 3 else "grey"
        return (
            f"Band('{self.name}', {count} images of {rows} x {columns} px, {kind},"
            f" {self.pixels.dtype})"
        )

    @property
    def spectral(self) -> str:
        """``white`` or ``nir``: the band of its LEDs."""
        return spectral_band(self.name)


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
