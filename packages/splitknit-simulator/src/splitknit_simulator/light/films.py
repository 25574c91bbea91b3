"""Linear polarising films before the LEDs and the camera: how much of each kind of light passes
both.

A film lets pass the field along its axis, projected across the ray. Light that the surface reflects
at a facet keeps its polarisation but for Fresnel's two reflectances, across (s) and along (p) the
plane of incidence, which are signed: they turn a field that lies between them. Light that was
scattered once keeps a part of it, all other light none.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput, Led, Rig
from splitknit.model import Array, FloatArray
from splitknit.nominal import side_lights
from splitknit.settings import Checked, Limits
from splitknit_simulator.light.lighting import Patch, Vectors, arriving, dot
from splitknit_simulator.light.skin import REFRACTIVE_INDEX, ChannelOptics, fresnel
from splitknit_simulator.rigs import triple

SERIES = ("parallel", "crossed")


def turned_film_rad(place: Sequence[float], analyser_rad: float = 0.0) -> float:
    """Axis, as the camera sees it, of the film before a side light: what a facet mirrors to the
    camera then lies along the analyser. A facet reflects less along the plane of incidence than
    across it, so film along the analyser itself would leak up to half of the reflection of a light
    at 72 deg into the crossed images.
    """
    x, y, z = place
    azimuth, height = np.arctan2(y, x) - analyser_rad, np.arctan2(z, np.hypot(x, y))
    across, along = fresnel_amplitudes(np.cos(np.pi / 4 - height / 2))
    turn = np.arctan2(np.abs(along / across) * np.sin(height) * np.sin(azimuth), np.cos(azimuth))
    return float(analyser_rad + azimuth - turn)


@dataclass(frozen=True, slots=True)
class FilmSettings(Checked):
    """Films before the white LEDs and the camera, and what of the skin's light keeps its
    polarisation."""

    _group = "films"

    kind: Literal["none", "analyser", "leds"] = "none"
    """``none``; ``analyser``: the camera's film turns between the two series; ``leds``: it stays,
    and the crossed series has white LEDs of its own beside the first ones."""
    axis_deg: Annotated[float, Limits(-180.0, 180.0)] = 0.0
    """Axis of the LEDs' films of the parallel series as the camera sees it, counter-clockwise from
    x."""
    misalignment_deg: Annotated[float, Limits(0.0, 10.0)] = 0.0
    """Rotation error of the camera's film; each LED's film is off by a random fraction of it,
    either way."""
    extinction: Annotated[float, Limits(1.0)] = 1000.0
    """Ratio of a film's transmission along its axis to that across it."""
    transmission: Annotated[tuple[float, float, float], Limits(0.0, 1.0, above=True)] = (
        0.85,
        0.85,
        0.85,
    )
    """Transmission of light that is polarised along a film's axis: red, green, blue. Different
    numbers tint."""
    kept: Annotated[float, Limits(0.0, 1.0)] = 0.25
    """Fraction of the light scattered once in the skin that keeps its polarisation."""
    shift_px: Annotated[float, Limits(0.0, 2.0)] = 0.0
    """Shift of the image, in a drawn direction, when the camera's film is turned."""


@dataclass(frozen=True, slots=True, eq=False)
class Films:
    """Films as they are mounted: what passes them under each LED."""

    settings: FilmSettings
    polariser_rad: Array  # (2, L) axes of the LEDs' films in both series, as the camera sees them
    analyser_rad: Array  # (2,) axes of the camera's film
    shift_px: Array  # (2,) columns and rows by which the crossed series is shifted
    # by series and LED: axes (x, y, z) of the films before side lights, which face the finger, not
    # the camera
    side_axes: Mapping[tuple[int, int], Vectors]

    def specular(self, series: int, k: int, light: Vectors, view: Vectors) -> Array:
        """What passes of the light that the surface reflects, over what it reflects of unpolarised
        light.

        Without films' absorption along their axis, see :meth:`transmitted`. `series`: 0 parallel, 1
        crossed; `k`: LED; `light`, `view`: unit vectors from the surface to the LED and to the
        camera.
        """
        passed = reflected_through(light, view, *self._mounted(series, k))
        return 0.5 * passed / fresnel(np.sqrt(0.5 + 0.5 * dot(light, view)))

    def once_scattered(self, series: int, k: int, light: Vectors, view: Vectors) -> Array:
        """What light scattered once adds, over itself, to what would pass had it lost its
        polarisation."""
        polariser, analyser, leak = self._mounted(series, k)
        fields = [_unit(_across(field, view)) for field in _fields(polariser, light)]
        weights = (1.0, leak)
        passed: Any = 0.0
        for field, a in zip(fields, weights, strict=True):
            for axis, b in zip(_fields(analyser, view), weights, strict=True):
                passed = passed + a * b * dot(field, axis) ** 2
        return np.asarray(self.settings.kept * (0.5 * passed - self.depolarised))

    def _mounted(self, series: int, k: int) -> tuple[float | Vectors, float, float]:
        """Axes of the film before an LED and of the camera's, and their leak."""
        polariser = self.side_axes.get((series, k), float(self.polariser_rad[series, k]))
        return polariser, float(self.analyser_rad[series]), 1.0 / self.settings.extinction

    @property
    def ambient(self) -> NDArray[np.float32]:
        """(3,) what passes of light that meets the camera's film only, over what two films leave;
        no :meth:`on_camera` tint.
        """
        leak = 1.0 / self.settings.extinction
        return np.asarray(
            2.0 / (1.0 + leak) / np.array(self.settings.transmission), dtype=np.float32
        )

    def on_camera(self, frame: FloatArray, crossed: bool) -> FloatArray:
        """(H, W, 3) a frame with the films' tint, shifted where the camera's film is turned."""
        passing = self.transmitted()
        return moved(frame * (passing / passing.max()), self.shift_px * crossed)

    @property
    def depolarised(self) -> float:
        """What passes of light that has lost its polarisation, without films' absorption along
        their axis."""
        return float(0.25 * (1.0 + 1.0 / self.settings.extinction) ** 2)

    def transmitted(self) -> NDArray[np.float32]:
        """(3,) transmission of two films along their axes."""
        return np.asarray(self.settings.transmission, dtype=np.float32) ** 2


def mounted_films(settings: FilmSettings, leds: Sequence[Led], rng: np.random.Generator) -> Films:
    """Mount films before the white LEDs (of each series) and the camera; `rng` draws how far they
    are off.

    Those before side lights are turned, see :func:`turned_film_rad`.
    """
    off, axis = np.deg2rad(settings.misalignment_deg), np.deg2rad(settings.axis_deg)
    polariser = axis + off * rng.uniform(-1.0, 1.0, (2, len(leds)))
    analyser = np.full(2, axis + off)
    if settings.kind == "leds":
        polariser[1] += np.pi / 2
    else:
        polariser[1] = polariser[0]
        analyser[1] += np.pi / 2
    side_axes = {}
    for k in side_lights(leds):
        place = leds[k].position_mm or ()
        for series, along in enumerate((axis, axis + np.pi / 2 * (settings.kind == "leds"))):
            polariser[series, k] += turned_film_rad(place, along) - along
            side_axes[series, k] = _fields(float(polariser[series, k]), _unit(place))[0]
    direction = rng.uniform(0.0, 2.0 * np.pi)
    shift = (
        settings.shift_px
        * np.array([np.cos(direction), np.sin(direction)])
        * (settings.kind == "analyser")
    )
    return Films(settings, polariser, analyser, shift, side_axes)


_CROSSED_LED_DISTANCE_MM = 6.0
"""From the LEDs of the parallel series, where the crossed one has its own."""


def with_crossed_leds(rig: Rig) -> Rig:
    """The rig with as many further white LEDs, each beside one of its own, farther around the
    camera's axis."""
    added = []
    for led in rig.leds:
        if led.band == "white":
            if led.position_mm is None:
                raise BadInput(
                    "films.kind 'leds' needs near LEDs, but the rig's have no position_mm."
                )
            x, y, z = led.position_mm
            turn = _CROSSED_LED_DISTANCE_MM / max(float(np.hypot(x, y)), _CROSSED_LED_DISTANCE_MM)
            sine, cosine = np.sin(turn), np.cos(turn)
            place = np.array([x * cosine - y * sine, x * sine + y * cosine, z])
            added.append(replace(led, position_mm=triple(place)))
    return replace(rig, leds=(*rig.leds, *added))


def once_scattered(patch: Patch, led: Led, optics: Sequence[ChannelOptics]) -> Iterator[FloatArray]:
    """Yield for each channel the (h, w) radiance of light that the skin scattered once, refracted
    in and out.

    It is blurred by half a mean free path, about as far as this light goes sideways (Chandrasekhar
    1960, Radiative Transfer, section 47: a half-space that scatters once, evenly in all
    directions).
    """
    light, strength = arriving(patch, led)
    cosine = np.maximum(dot(light, patch.normal), 0.0)
    seen = np.clip(patch.nv, 0.0, 1.0)
    before, behind = (np.sqrt(1.0 - (1.0 - c * c) / REFRACTIVE_INDEX**2) for c in (cosine, seen))
    passed = (
        strength * cosine * (1.0 - fresnel(cosine)) * (1.0 - fresnel(seen)) / REFRACTIVE_INDEX**2
    )
    sent = np.where(patch.mask, passed / (before + behind) / (4.0 * np.pi), 0.0).astype(np.float32)
    for medium in optics:
        extinction = medium.scattering_per_mm + medium.absorption_per_mm
        blurred = cv2.GaussianBlur(sent, (0, 0), max(0.5 * patch.px_per_mm / extinction, 0.1))
        yield np.asarray(
            blurred * np.float32(medium.scattering_per_mm / extinction) * patch.mask,
            dtype=np.float32,
        )


def moved(frame: FloatArray, shift_px: Array) -> FloatArray:
    """(H, W, C) a frame whose content has moved by so many columns and rows; beyond its border the
    border goes on."""
    if not shift_px.any():
        return frame
    matrix, how = np.column_stack([np.eye(2), shift_px]), cv2.INTER_LANCZOS4
    moved = cv2.warpAffine(
        frame, matrix, frame.shape[1::-1], flags=how, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(np.maximum(moved, 0.0), dtype=np.float32)


def reflected_through(
    light: Vectors, view: Vectors, polariser: float | Vectors, analyser_rad: float, leak: float
) -> Array:
    """What a facet that mirrors the LED to the camera reflects through both films, of light
    polarised by the first.

    `light`, `view`: unit vectors from the facet to the LED and to the camera; the films' axes are
    angles as the camera sees them, or a vector; `leak`: transmission across a film's axis over that
    along it. Summed over both fields behind the first film (of weight 1 and `leak`) and both axes
    of the second. Born and Wolf, Principles of Optics, 1.5.2, equation (21): the signed amplitudes.
    """
    cosine = np.sqrt(0.5 + 0.5 * dot(light, view))
    across, along = fresnel_amplitudes(cosine)
    s = _cross(light, view)
    size = np.sqrt(dot(s, s))
    # light along the line of sight has no plane of incidence; any will do
    level = size < 1e-9
    off_axis = np.where(np.abs(light[0]) < 0.9, 1.0, 0.0)
    any_across = _cross(light, (off_axis, 1.0 - off_axis, 0.0))
    s = _unit(tuple(np.where(level, b, a) for a, b in zip(s, any_across, strict=True)))
    before, behind = _cross(light, s), _cross(s, view)  # s x d with d = -light; s x v
    passed: Any = 0.0
    for field, a in zip(_fields(polariser, light), (1.0, leak), strict=True):
        on_s, on_p = across * dot(field, s), along * dot(field, before)
        for axis, b in zip(_fields(analyser_rad, view), (1.0, leak), strict=True):
            passed = passed + a * b * (on_s * dot(axis, s) + on_p * dot(axis, behind)) ** 2
    return np.asarray(passed)


def fresnel_amplitudes(cosine: FloatArray, ratio: float = REFRACTIVE_INDEX) -> tuple[Array, Array]:
    """Signed amplitudes of the field across (s) and along (p) the plane of incidence, light from
    the thinner medium."""
    c = np.asarray(cosine, dtype=np.float64)
    t = np.sqrt(1.0 - (1.0 - c * c) / ratio**2)
    return (c - ratio * t) / (c + ratio * t), (ratio * c - t) / (ratio * c + t)


def _fields(axis: float | Vectors, ray: Vectors) -> tuple[Vectors, Vectors]:
    """Unit vectors across a ray: along the film's axis, and square to it."""
    first = _unit(
        _across((np.cos(axis), np.sin(axis), 0.0) if isinstance(axis, float) else axis, ray)
    )
    return first, _cross(ray, first)


def _across(vector: Vectors, ray: Vectors) -> Vectors:
    along = dot(vector, ray)
    return tuple(v - along * r for v, r in zip(vector, ray, strict=True))


def _unit(vector: Vectors) -> Vectors:
    size = np.sqrt(dot(vector, vector))
    return tuple(v / size for v in vector)


def _cross(a: Vectors, b: Vectors) -> Vectors:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
