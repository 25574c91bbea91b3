"""What is known of photographs that any camera took, beside their lights and their scale."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from splitknit.errors import require
from splitknit.verbs import AnyPath, Encoding, Help, Job, check


def _value_or_file(text: str) -> float | Path:
    with contextlib.suppress(ValueError):
        return float(text)
    return Path(text)


PxPerMm = Annotated[
    float | None, Help("scale on the object, where the input has none; without it heights are in pixels", "X")
]
RidgePeriod = Annotated[
    float | None,
    Help(
        "take the scale from a finger's ridges, which lie MM apart: 0.45 is usual, people differ by 8 %",
        "MM",
        option="--ridge-period",
    ),
]


def check_scale(px_per_mm: float | None, ridge_period_mm: float | None) -> None:
    """Refuse two scales, and numbers that are none. Raises BadInput."""
    both = px_per_mm is not None and ridge_period_mm is not None
    require(not both, "`px_per_mm` and `ridge_period_mm` both give the scale; choose one.")
    usual = px_per_mm is None or 1e-3 <= px_per_mm <= 1e5
    require(usual, f"`px_per_mm` must be a number from 0.001 to 100000, not {px_per_mm}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotographOptions(Job):
    """What is known of photographs beside their lights and their scale."""

    # fmt: off
    mask: Annotated[AnyPath | None, Help(
        "image, white = object, or transparent elsewhere; all: it fills the photographs (default: mask.png beside the "
        "images, or their transparency, if any)", "FILE")] = None
    material: Annotated[Literal["skin", "opaque"] | None, Help(
        "skin: a finger, whose blur of light is undone; opaque (default): any other thing, left as it lies")] = None
    tip_direction_deg: Annotated[float | None, Help(
        "where a finger's tip points, within 75 degrees: 0 = up, counter-clockwise; left out, it is found",
        "DEG", option="--tip-direction")] = None
    encoding: Annotated[Encoding | None, Help(
        "of the photographs (default: srgb for JPEG, WEBP, HEIC and PNG that states it; linear for RAW and 16 bits; "
        "else by their shading)")] = None
    brightness: Annotated[Literal["estimate", "equal"] | None, Help(
        "of the lights of an opaque thing: estimated with its surface, or equal, whatever the list states (default: as "
        "the list states it, else estimated where that explains the photographs clearly better)")] = None
    max_megapixels: Annotated[float | None, Help(
        "reduce larger photographs to so many megapixels, by means over areas (default: they stay as they are)",
        "MEGAPIXELS", option="--max-size")] = None
    background: Annotated[float | AnyPath | None, Help(
        "stored value that every pixel has without light, or a photograph with all lights off",
        "VALUE|FILE", read=_value_or_file)] = None
    crossed: Annotated[AnyPath | None, Help(
        "folder of the same photographs in the same order through crossed polarising films; those of `folder` are then"
        " the ones through parallel films; one exposure for all", "DIR")] = None
    mosaic: Annotated[Literal["mono", "colour"] | None, Help(
        "the photographs are raw frames of a camera with films on its pixels (90, 45 / 135, 0 degrees; mono: Sony "
        "IMX250MZR, colour: IMX250MYR); each holds the parallel and the crossed image")] = None
    film_deg: Annotated[float, Help(
        "of `mosaic`: direction of the film before the LEDs, 0 along the rows", "DEG", option="--film-angle")] = 90.0
    flat: Annotated[AnyPath | None, Help(
        "photographs of a flat matt surface, one for each light in the same order and exposure: those of the object "
        "are divided by them", "DIR")] = None
    nir: Annotated[AnyPath | None, Help(
        "near-infrared photographs, a folder or a pattern: the band ``nir``; their lights are the NIR LEDs of the rig,"
        " or those of a list in their own folder", python_only=True)] = None
    # fmt: on

    def __post_init__(self) -> None:
        check(self)
        tip, size = self.tip_direction_deg, self.max_megapixels
        turned = tip is None or abs(tip) <= 360.0
        require(turned, "`tip_direction_deg` must be an angle from -360 to 360 degrees, 0 = up, counter-clockwise.")
        require(size is None or 0.0 < size <= 1000, f"`max_megapixels` must be megapixels up to 1000, not {size}.")
        require(abs(self.film_deg) <= 360, "`film_deg` must be an angle from -360 to 360 degrees, 0 along the rows.")
        others = self.encoding == "srgb", self.max_megapixels, self.background_image, self.crossed
        frames = "a mosaic of films is linear and holds both series in each frame"
        left_out = "leave out `encoding` srgb, `max_megapixels`, `crossed` and a `background` that is a photograph."
        require(self.mosaic is None or not any(others), f"{frames}: {left_out}")
        require(self.nir is None or self.mosaic is None, "`nir` does not go with `mosaic`.")

    @property
    def background_image(self) -> AnyPath | None:
        """The image with all lights off, if there is one."""
        return None if isinstance(self.background, float | int) else self.background
