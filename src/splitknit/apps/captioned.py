"""A picture with its caption, legend and scale bar, as pages show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from splitknit.apps.pictures import data_uri

_NO_LEGEND = Markup("")


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure of the report."""

    title: str
    uri: str
    caption: str
    width: int
    height: int
    legend: Markup = _NO_LEGEND
    scale_percent: float = 0.0
    """Length of the scale bar in percent of the picture's width; 0 = none."""
    scale_label: str = ""


def captioned(  # noqa: PLR0917
    title: str,
    image: NDArray[np.uint8],
    caption: str,
    legend: Markup = _NO_LEGEND,
    pitch_mm: float = 0.0,
    photo: bool = False,
) -> Picture:
    """A picture as a data URI, with a bar of a round length where the size of a pixel is known."""
    height, width = image.shape[:2]
    bar_mm = next((b for b in (10.0, 5.0, 2.0, 1.0, 0.5) if b < 0.45 * width * pitch_mm), 0.0) if pitch_mm else 0.0
    return Picture(
        title=title,
        uri=data_uri(image, photo=photo),
        caption=caption,
        width=width,
        height=height,
        legend=legend,
        scale_percent=round(100 * bar_mm / (width * pitch_mm), 2) if bar_mm else 0.0,
        scale_label=f"{bar_mm:g} mm",
    )
