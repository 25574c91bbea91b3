"""The unit in which lengths are written and shown: mm, or pixels where nobody has measured the
scale.

Arrays are always in mm. Where the scale is unknown they are in mm of a scale that was assumed for
the methods to work with, and that means nothing to a person. Whatever writes or shows a length
converts it here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class LengthUnit:
    """A unit of lengths, and one of small lengths (ridges)."""

    name: str
    small: str
    per_mm: float
    small_per_mm: float

    @property
    def known(self) -> bool:
        """Whether it is a length that was measured, rather than a pixel."""
        return self.name == "mm"

    @property
    def title(self) -> str:
        """The unit as the head of a file states it."""
        return self.name if self.known else "pixel, the scale is unknown"

    def fitting(self, length_mm: float) -> tuple[str, float]:
        """The unit in which a length is read easily, and that unit's number in a mm: the small one
        below 1 mm.

        >>> MILLIMETRES.fitting(2.5)
        ('mm', 1.0)
        """
        if length_mm < 1.0:
            return self.small, self.small_per_mm
        return self.name, self.per_mm

    def text(self, length_mm: float, sd_mm: float | None = None) -> str:
        """A length in the unit in which it is read easily, and its standard deviation if known.

        >>> MILLIMETRES.text(-1234.0), MILLIMETRES.text(2.5, 0.126)
        ('-1230 mm', '2.5 ± 0.13 mm')
        """
        name, per_mm = self.fitting(abs(length_mm))
        known = "" if sd_mm is None else f" ± {float(f'{per_mm * sd_mm:.2g}'):g}"
        return f"{float(f'{per_mm * length_mm:.3g}'):g}{known} {name}"

    def heights(self, heights_mm: NDArray[np.float32]) -> NDArray[np.float32]:
        """An array of lengths in this unit; the same array where it is in mm already."""
        return heights_mm if self.known else heights_mm * np.float32(self.per_mm)

    def converted(self, value: Any) -> Any:
        """Facts in this unit: mappings, lists, numbers and sentences. A number's unit is the end of
        its name.

        >>> pixels(0.1).converted({"shift_mm": [0.5, 1.0], "area_mm2": 2.0, "gain": 1.5})
        {'shift_px': [5.0, 10.0], 'area_px2': 200.0, 'gain': 1.5}
        """
        return value if self.known else _in_pixels(value, self.per_mm)


def _in_pixels(value: Any, px: float, factor: float = 1.0) -> Any:
    """`value` with a factor for its numbers; names without a unit (colours, bands) have that of the
    mapping around."""
    if isinstance(value, list | tuple):
        return [_in_pixels(item, px, factor) for item in value]
    if not isinstance(value, Mapping):
        return value * factor if isinstance(value, float) else value
    ends = {
        "_per_mm": ("_per_px", 1 / px),
        "_mm2": ("_px2", px * px),
        "_mm": ("_px", px),
        "_um": ("_px", px / 1e3),
    }
    converted = {}
    for name, item in value.items():
        end = next((end for end in ends if name.endswith(end)), "")
        if not end or name.endswith("px_per_mm"):  # the assumed scale itself
            converted[name] = _in_pixels(item, px, factor)
        else:
            unit, own = ends[end]
            converted[name.removesuffix(end) + unit] = _in_pixels(item, px, own)
    return converted


MILLIMETRES = LengthUnit("mm", "\N{MICRO SIGN}m", 1.0, 1000.0)


def pixels(pitch_mm: float) -> LengthUnit:
    """Pixels of a grid whose pitch was assumed."""
    return LengthUnit("px", "px", 1.0 / pitch_mm, 1.0 / pitch_mm)
