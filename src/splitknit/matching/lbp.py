"""Local binary patterns in cells: the features of the thesis's matching.

Codes are bytes: bit k is set where the neighbour at the angle 2 pi k / 8, counter-clockwise from the right, is at least
as large as the pixel itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_image, require
from splitknit.model import FloatArray
from splitknit.settings import Checked, Limits

Codes = NDArray[np.uint8]
AnyArray = np.ndarray[Any, Any]

REFERENCE_PX_PER_MM = 75.7
"""Scale at which the thesis's sizes in pixels hold."""
_STRIP = 48


_CELL_PX = 64.0
"""Side of a cell; what is left at the right and lower border is not used."""


@dataclass(frozen=True, slots=True)
class LbpSettings(Checked):
    """Patterns and cells; sizes hold at 75.7 px/mm and scale with the image."""

    radius_px: Annotated[float, Limits(0, above=True)] = 1.0
    """Of the circle of neighbours; on coarser images at least one of their pixels."""
    uniform: bool = True
    """Whether patterns with more than two changes around the circle share one bin (59 bins instead of 256)."""
    normalisation: Literal["l2", "l1", "none"] = "l2"
    """Of each cell's histogram: ``l2`` (unit length), ``l1`` (unit sum) or ``none`` (counts)."""
    interpolation: Literal["linear", "nearest"] = "linear"
    """``linear`` takes diagonal neighbours on the circle, ``nearest`` the nearest pixels."""

    def radius(self, px_per_mm: float) -> float:
        """Radius in pixels of an image."""
        return max(1.0, self.radius_px * px_per_mm / REFERENCE_PX_PER_MM)

    def cell(self, px_per_mm: float) -> int:
        """Side of a cell in pixels of an image."""
        return max(4, round(_CELL_PX * px_per_mm / REFERENCE_PX_PER_MM))


def lbp_codes(image: FloatArray, radius: float = 1.0, interpolation: str = "linear") -> Codes:
    """Codes (H, W) of an image (H, W); pixels beyond the border repeat its edge.

    Raises
    ------
    BadInput
        If the image is not finite and two-dimensional, or the radius is not positive.

    References
    ----------
    Ojala, Pietikainen and Maenpaa 2002, Multiresolution gray-scale and rotation invariant texture classification with
    local binary patterns, section 2.1; the thesis, section 5.2.1.

    Examples
    --------
    >>> lbp_codes(np.array([[0, 0, 0], [0, 5, 9], [0, 0, 0]], np.float32))[1, 1].item()
    1
    """
    image = check_image(image)
    require(np.isfinite(radius) and 0 < radius < 1000, f"the radius must be positive, but it is {radius}.")
    diagonal = radius * float(np.sqrt(0.5))
    if interpolation == "nearest":
        diagonal, radius = float(np.round(diagonal)), float(np.round(radius))
    border = int(np.ceil(radius)) + 1
    padded = cv2.copyMakeBorder(image, border, border, border, border, cv2.BORDER_REPLICATE)
    height, width = image.shape
    codes = np.zeros((height, width), dtype=np.uint8)
    reached = np.empty((_STRIP, width), dtype=np.bool_)
    bits = np.empty((_STRIP, width), dtype=np.uint8)
    for top in range(0, height, _STRIP):  # strips stay in the cache
        rows = min(_STRIP, height - top)
        strip = padded[top : top + rows + 2 * border]
        centre = strip[border:-border, border:-border]
        right, middle, left = (_across(strip, shift, border) for shift in (diagonal, 0.0, -diagonal))
        neighbours = (
            _across(strip[border:-border], radius, border),
            _down(right, -diagonal, border),
            _down(middle, -radius, border),
            _down(left, -diagonal, border),
            _across(strip[border:-border], -radius, border),
            _down(left, diagonal, border),
            _down(middle, radius, border),
            _down(right, diagonal, border),
        )
        code = codes[top : top + rows]
        for bit, neighbour in enumerate(neighbours):
            np.greater_equal(neighbour, centre, out=reached[:rows])
            np.left_shift(reached[:rows].view(np.uint8), bit, out=bits[:rows])
            np.bitwise_or(code, bits[:rows], out=code)
    return codes


def _across(strip: AnyArray, shift: float, border: int) -> AnyArray:
    """The strip without its side borders, seen from places `shift` columns to the right, linear."""
    first, part = _split(shift)
    width = strip.shape[1] - 2 * border
    near = strip[:, border + first : border + first + width]
    if part == 0.0:
        return near
    far = strip[:, border + first + 1 : border + first + 1 + width]
    return cv2.addWeighted(near, 1.0 - part, far, part, 0.0)


def _down(strip: AnyArray, shift: float, border: int) -> AnyArray:
    """The strip without its upper and lower borders, seen from places `shift` rows down, linear."""
    first, part = _split(shift)
    height = strip.shape[0] - 2 * border
    near = strip[border + first : border + first + height]
    if part == 0.0:
        return near
    far = strip[border + first + 1 : border + first + 1 + height]
    return cv2.addWeighted(near, 1.0 - part, far, part, 0.0)


def _split(shift: float) -> tuple[int, float]:
    first = int(np.floor(shift + 1e-9))
    part = shift - first
    return first, part if part > 1e-9 else 0.0


def uniform_bins() -> Codes:
    """(256,) the bin of each code: 0 to 57 for the uniform ones in rising order, 58 for all others."""
    codes = np.arange(256, dtype=np.uint32)
    turned = (codes >> 1) | ((codes & 1) << 7)
    changes = np.array([int(value).bit_count() for value in codes ^ turned])
    return np.where(changes <= 2, np.cumsum(changes <= 2) - 1, 58).astype(np.uint8)


_UNIFORM = uniform_bins()


def cell_histograms(codes: Codes, cell: int, settings: LbpSettings | None = None) -> NDArray[np.float32]:
    """Histograms of codes (H, W) in whole cells, normalised: shape (rows, columns, 59 or 256).

    Raises
    ------
    BadInput
        If the image is smaller than a cell.
    """
    settings = settings or LbpSettings()
    rows, columns = codes.shape[0] // cell, codes.shape[1] // cell
    require(rows > 0 and columns > 0, f"the image of {codes.shape} pixels is smaller than a cell of {cell} pixels.")
    bins = 59 if settings.uniform else 256
    if settings.uniform:
        codes = np.asarray(cv2.LUT(codes, _UNIFORM))
    cut = codes[: rows * cell, : columns * cell]
    result = np.empty((rows, columns, bins), dtype=np.float32)
    for row in range(rows):
        band = cut[row * cell : (row + 1) * cell]
        for column in range(columns):
            part = np.ascontiguousarray(band[:, column * cell : (column + 1) * cell])
            result[row, column] = np.bincount(part.ravel(), minlength=bins)
    if settings.normalisation == "l2":
        result /= np.sqrt((result * result).sum(axis=2, keepdims=True))
    elif settings.normalisation == "l1":
        result /= result.sum(axis=2, keepdims=True)
    return result


def lbp_features(image: FloatArray, px_per_mm: float, settings: LbpSettings | None = None) -> NDArray[np.float32]:
    """Feature vector of one channel (H, W): the normalised histograms of all cells."""
    settings = settings or LbpSettings()
    codes = lbp_codes(image, settings.radius(px_per_mm), settings.interpolation)
    return cell_histograms(codes, settings.cell(px_per_mm), settings).ravel()
