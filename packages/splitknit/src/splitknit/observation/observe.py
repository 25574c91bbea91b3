"""From a capture to linear light: all that the stages behind know of photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from splitknit.capture import Band, Capture
from splitknit.findings import Finding
from splitknit.imaging.light_field import flat_promised, lights_in_front
from splitknit.model import BoolArray, FloatArray, PixelArray, Rig
from splitknit.observation.coloured import LightsSettings, as_lit
from splitknit.observation.films import aligned
from splitknit.observation.light import Light

_IN_FRONT = 4
"""So many lights in front of the finger do without those to its side."""


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Linear light of a finger, or a thing, under every LED."""

    rig: Rig
    bands: Mapping[str, Light]
    """``white`` always; ``nir`` where it was captured; ``white_crossed`` where `white` is a
    parallel series."""
    material: str
    """``skin`` or ``opaque``, see :class:`splitknit.Capture`."""
    tip_direction_deg: float | None = None
    mask: BoolArray | None = None
    side: Light | None = None
    """White light from the side of the finger, with a crossed series as the white band has one;
    `bands` have the light from the front then."""
    hashes: Mapping[str, str] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    @property
    def white(self) -> Light:
        """The white band."""
        return self.bands["white"]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns of the camera's images."""
        return self.rig.camera.image_size

    @property
    def encoding(self) -> str:
        """How light was stored, for messages: ``linear`` or ``srgb``."""
        return self.white.encoding

    @property
    def other_encoding(self) -> Literal["linear", "srgb"]:
        """The encoding that was not stated."""
        return "linear" if self.encoding == "srgb" else "srgb"

    def as_if_stored(self, encoding: str) -> Observation:
        """The observation as if the files had another encoding."""
        bands = {name: light.as_if_stored(encoding) for name, light in self.bands.items()}
        return replace(self, bands=bands)

    def with_light(self, light: Light) -> Observation:
        """The observation with another light in place of the band of its name."""
        return replace(self, bands={**self.bands, light.name: light})

    def under(self, rig: Rig) -> Observation:
        """The observation as if it had been made with another rig of the same LEDs."""
        bands = {name: light.under(rig) for name, light in self.bands.items()}
        return replace(self, rig=rig, bands=bands)

    def without_films(self) -> Observation:
        """The observation whose white light is the mean of its parallel and crossed series, where
        it has both. It has half the brightness of light without films, and its shading.
        """
        crossed = self.bands.get("white_crossed")
        if crossed is None:
            return self
        return self.with_light(replace(self.white, crossed=crossed))


def observe(
    capture: Capture,
    lights: LightsSettings | None = None,
    camera: Literal["calibrated", "orthographic"] = "calibrated",
) -> Observation:
    """The linear light of a capture.

    `lights`: coloured LEDs to compose; `camera`: ``orthographic`` takes rays as parallel whatever
    the rig file says. Raises BadInput if coloured exposures cannot be composed, or the rig's films
    were measured under other LEDs.
    """
    bands = {name: _grey_as_grey(band, capture.rig) for name, band in capture.bands.items()}
    capture = _with_camera(replace(capture, bands=bands), camera)
    capture, findings = as_lit(capture, lights or LightsSettings())
    rig = capture.rig
    light = {
        name: Light(band, rig, capture.encoding, promised=_promised(band, rig))
        for name, band in capture.bands.items()
    }
    facts: dict[str, Any] = {}
    if "white_crossed" in light:
        facts["films"] = "taken as ideal" if rig.films is None else "measured"
        if rig.films is not None:
            light["white_crossed"] = aligned(light["white_crossed"], light["white"], rig.films)
    observation = Observation(
        rig,
        light,
        capture.material,
        capture.tip_direction_deg,
        capture.mask,
        hashes=capture.hashes,
        facts=facts,
        findings=findings,
    )
    return _side_apart(observation)


def _with_camera(capture: Capture, model: str) -> Capture:
    camera = capture.rig.camera
    if model == "calibrated" or camera.model == "orthographic":
        return capture
    plain = replace(camera, model="orthographic", matrix=None, distortion=None)
    return replace(capture, rig=replace(capture.rig, camera=plain))


def _promised(band: Band, rig: Rig) -> FloatArray | None:
    """Where images are divided by flat ones: the brightness that the rig's lights have on a flat
    surface."""
    if band.flat is None:
        return None
    return flat_promised(rig.select(rig.lights_of(band.leds)), band.flat.shape)


def _side_apart(observation: Observation) -> Observation:
    """The observation whose white bands have the lights in front of the finger, and the others as
    `side`.

    A light from the side leaves half of a finger, and valleys between ridges, in shadow: skin under
    it looks like no surface under the lights in front. What is not skin, coloured lights, and
    lights in mirrors stay as they are.
    """
    white = observation.white
    if observation.material != "skin" or observation.rig.mirrors or white.colours:
        return observation
    front = lights_in_front(white.rig)
    if front.all() or front.sum() < _IN_FRONT:
        return observation
    series = [name for name in ("white", "white_crossed") if name in observation.bands]
    in_front = np.flatnonzero(front).tolist()
    at_side = np.flatnonzero(~front).tolist()
    bands = {name: observation.bands[name].of_images(in_front) for name in series}
    side, *crossed = (observation.bands[name].of_images(at_side) for name in series)
    if crossed:
        side = replace(side, crossed=crossed[0])
    return replace(observation, bands={**observation.bands, **bands}, side=side)


def _grey_as_grey(band: Band, rig: Rig) -> Band:
    """The band in one channel where its three are equal: a grey camera's images that were stored as
    colour."""

    def equal(pixels: PixelArray) -> bool:
        least = pixels.min(axis=-1)
        return bool((pixels.max(axis=-1) - least <= np.iinfo(pixels.dtype).max // 255).all())

    def every_equal(step: int) -> bool:
        return all(equal(image[::step, ::step]) for image in band.pixels)

    colour = band.pixels.shape[-1] == 3 and not rig.colours_of(band.leds)
    # a coarse look first, which nearly all coloured images end at
    if not colour or not equal(band.pixels[0, ::16][:, ::16]):
        return band
    if not every_equal(16) or not every_equal(1):
        return band
    ambient = band.ambient
    if ambient is not None and not equal(ambient.pixels):
        return band
    return replace(
        band,
        pixels=np.stack([image[..., 1:2] for image in band.pixels]),
        ambient=None if ambient is None else replace(ambient, pixels=ambient.pixels[..., 1:2]),
    )
