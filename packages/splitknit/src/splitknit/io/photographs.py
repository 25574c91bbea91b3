"""What is known of photographs that any camera took."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import PYTHON_ONLY, AnyPath, Encoding, refuse_given
from splitknit.errors import require
from splitknit.settings import Limits, check_value, rules_of

if TYPE_CHECKING:
    from splitknit.model import Array, Rig

    Lights = AnyPath | Array | Rig
else:
    Lights = AnyPath


SCALES = Limits(1e-3, 1e5)
"""Of pixels a mm."""


def _value_or_file(kind: Any, tokens: Sequence[Any]) -> float | Path:
    word = tokens[0].value
    try:
        return float(word)
    except ValueError:
        return Path(word)


@dataclass(frozen=True, slots=True)
class GivenPhotographs:
    """Photographs of one object under one light after the other, and all that is known of them.
    Raises BadInput where two facts do not agree.
    """

    images: AnyPath | None = None
    """Folder of photographs, one for each light, in the order of their names (or a pattern of
    names, such as 'photos/white_{light}.jpg'): JPEG, PNG, TIFF, WEBP, BMP; with the extra 'photos'
    HEIC and camera RAW."""
    lights: Lights | None = None
    """Directions towards the lights, a line 'x y z' or 'NAME x y z' for each photograph: x right, y
    up, z to the camera; a fourth number is its brightness (a fourth to sixth: red, green, blue),
    else light_intensities.txt beside the list has it; places in mm where the first line is 'x_mm
    y_mm z_mm', angles where it is 'azimuth_deg elevation_deg' (counter-clockwise from x; 90 at the
    camera); also rig files, .lp of RTI, .dome of Relight (default: lights.txt beside the
    images)."""
    px_per_mm: Annotated[float | None, SCALES] = None
    """Scale on the object, where the input has none; without it heights are in pixels."""
    _: KW_ONLY
    mask: AnyPath | None = None
    """Image, white = object, or transparent elsewhere; all: it fills the photographs (default:
    mask.png beside the images, or their transparency, if any)."""
    material: Literal["skin", "opaque"] | None = None
    """skin: a finger, whose blur of light is undone; opaque (default): any other thing, left as it
    lies."""
    tip_direction_deg: Annotated[float | None, Limits(-360, 360), Parameter("--tip-direction")] = (
        None
    )
    """Where a finger's tip points, within 75 degrees: 0 = up, counter-clockwise; left out, it is
    found."""
    encoding: Encoding | None = None
    """Of the photographs (default: srgb for JPEG, WEBP, HEIC and PNG that states it; linear for RAW
    and 16 bits; else by their shading)."""
    brightness: Literal["estimate", "equal"] | None = None
    """Of the lights of an opaque thing: estimated with its surface, or equal, whatever the list
    states (default: as the list states it, else estimated where that explains the photographs
    clearly better)."""
    background: Annotated[
        float | AnyPath | None, Parameter(converter=_value_or_file, n_tokens=1)
    ] = None
    """Stored value that every pixel has without light, or a photograph with all lights off."""
    crossed: AnyPath | None = None
    """Folder of the same photographs in the same order through crossed polarising films; the others
    are then the ones through parallel films; one exposure for all."""
    flat: AnyPath | None = None
    """Photographs of a flat matt surface, one for each light in the same order and exposure: those
    of the object are divided by them."""
    nir: Annotated[AnyPath | None, PYTHON_ONLY] = None
    """Near-infrared photographs, a folder or a pattern: the band ``nir``; their lights are the NIR
    LEDs of the rig, or those of a list in their own folder."""
    light_frame: str | None = None
    """Where x and y of the lights' directions point in the image, where not right-up: right-down (y
    down), left-up (mirrored), left-down, up-left, up-right, down-left, down-right."""
    ridge_period_mm: Annotated[float | None, Parameter("--ridge-period")] = None
    """Take the scale from a finger's ridges, which lie so many mm apart: 0.45 is usual, people
    differ by 8 %."""

    def __post_init__(self) -> None:
        for name, rule in rules_of(type(self)):  # type: ignore[arg-type]  # a class is hashable
            check_value(f"`{name}`", rule, getattr(self, name))
        both = self.px_per_mm is not None and self.ridge_period_mm is not None
        require(not both, "`px_per_mm` and `ridge_period_mm` both give the scale; choose one.")

    @property
    def background_image(self) -> AnyPath | None:
        """The image with all lights off, if there is one."""
        return None if isinstance(self.background, float | int) else self.background

    def refuse_without_images(self, *others: str) -> None:
        """Refuse what only photographs have where there are none, but for `others`. Raises
        BadInput."""
        if self.images is None:
            stated = {field.name: getattr(self, field.name) for field in fields(self)}
            for name in (*others, "nir"):
                del stated[name]
            refuse_given("goes with `images`.", **stated)


OF_CAPTURES = ("tip_direction_deg", "light_frame", "px_per_mm", "ridge_period_mm")
"""What is known of photographs, and can be stated of a capture folder too."""


AllPhotographs = Annotated[GivenPhotographs, Parameter("*", group="Photographs")]
NO_PHOTOGRAPHS = GivenPhotographs()
