"""Which of the finger's pixels carry enough light for photometric stereo."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, check_stack, require
from splitknit.finger.regions import bounding_box, erode, fill_holes, largest_component
from splitknit.model import BoolArray, FloatArray

_DARK_FRACTION = 0.03
"""A light reaches a pixel if it is brighter than this share of the finger's median brightness."""
_SATURATION = 0.98
"""Values from here on are saturated (linear, full scale is one), unless the caller says otherwise."""
_MIN_LIGHTS = 3
"""Lights that must reach a pixel unsaturated; three determine a normal."""
_PINHOLE_MM2 = 1.0
"""Holes up to this area are filled: a few unreliable pixels harm less than a hole in the surface."""


def photometric_mask(
    stack: FloatArray,
    finger: BoolArray,
    px_per_mm: float,
    *,
    saturation: float | NDArray[np.float64] | None = None,
) -> BoolArray:
    """Drop pixels that too few lights reach; keep one component without pinholes. At full resolution.

    The thesis drops pixels that no light makes brighter than a threshold; here the threshold follows the finger's own
    brightness, and three lights must pass it.

    Parameters
    ----------
    stack : (L, H, W) float32 linear
    finger : (H, W) bool
    px_per_mm : float
    saturation : float or (L,), optional
        Value at which each image saturates on the stack's scale (after exposures were made equal).

    Returns
    -------
    mask : (H, W) bool, inside `finger`

    Raises
    ------
    BadInput
        If nothing is left.

    References
    ----------
    The thesis, section 3.3.1.5 (refined mask).
    """
    stack = check_stack(stack)
    finger = check_mask(finger, (stack.shape[1], stack.shape[2]), name="the finger's mask")
    box = bounding_box(finger)
    inside = finger[box]
    least = min(_MIN_LIGHTS, len(stack))
    ceilings = np.broadcast_to(np.asarray(_SATURATION if saturation is None else saturation), (len(stack),))
    sample = stack[:, box[0], box[1]][:, ::4, ::4][:, inside[::4, ::4]]
    sample = sample if sample.size else stack[:, finger]
    floor = np.float32(_DARK_FRACTION * float(np.median(sample)))
    count = np.zeros(inside.shape, dtype=np.uint8)
    for image, ceiling in zip(stack[:, box[0], box[1]], ceilings, strict=True):
        count += (image > floor) & (image < np.float32(ceiling))
    good = fill_holes(inside & (count >= least), _PINHOLE_MM2 * px_per_mm**2)
    # an isolated dark pixel at the outline would leave a bay one pixel wide, and a bridge as thin is no surface
    good = largest_component(good & inside)
    require(
        bool(erode(good, 2.0).any()),
        f"hardly any pixel of the finger is reached by {least} lights without saturating: correct the exposure.",
    )
    result = np.zeros(finger.shape, dtype=np.bool_)
    result[box] = good
    return result
