"""Which part of one image shows the finger itself, and which parts show it in mirrors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import BadInput, require
from splitknit.shape.settings import ViewSettings
from splitknit.types import BoolArray, Camera, FloatArray, Mirror
from splitknit.view import pixels_of

Array = NDArray[np.float64]
FindFinger = Callable[[FloatArray, float], BoolArray]
"""From an image (h, w, C) and its px_per_mm to the mask of the finger in it."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Masks of one finger's views in one image, on blocks of `binning` pixels a side."""

    front: BoolArray
    """(h, w)."""
    mirrors: Mapping[str, BoolArray]
    """(h, w) by the mirrors' names; those that show no finger are left out."""
    binning: int


def view_binning(px_per_mm: float, settings: ViewSettings | None = None) -> int:
    """How many pixels a side are averaged before views are looked for."""
    return max(1, int(px_per_mm / (settings or ViewSettings()).px_per_mm))


def mirror_outline(mirror: Mirror, camera: Camera, binning: int = 1) -> Array:
    """(n, 2) column and row of a mirror's nominal outline in an image of blocks of `binning` pixels a side."""
    full = pixels_of(camera, np.asarray(mirror.corners_mm, dtype=np.float64))
    return np.asarray((full - 0.5 * (binning - 1)) / binning)


def find_views(  # noqa: PLR0917
    image: FloatArray,
    camera: Camera,
    mirrors: Mapping[str, Mirror],
    find_finger: FindFinger,
    binning: int,
    settings: ViewSettings | None = None,
) -> Views:
    """Find the finger itself and its mirror images.

    The front view is what `find_finger` sees of the image without the mirrors' nominal outlines; each mirror's view is
    what it sees around that mirror's outline, without the front view. A mirror's frame, second reflections and the
    finger's far parts are left out because one piece of skin is wanted from each.

    Parameters
    ----------
    image : (h, w, C) float32
        Linear, in blocks of `binning` pixels a side of the camera's image.
    camera : Camera
    mirrors : by name, where they nominally are
    find_finger : mask of the finger in an image, :func:`splitknit.preprocess.finger_mask` say
    binning : int
    settings : ViewSettings, optional

    Raises
    ------
    BadInput
        If there are no mirrors, none shows a finger, a view is cut by a mirror's edge, or there are two fingers.
    """
    settings = ViewSettings() if settings is None else settings
    require(bool(mirrors), "the rig has no mirrors: name them in rig.json, or take the shape from light.")
    px_per_mm = camera.px_per_mm / binning
    shape = (image.shape[0], image.shape[1])
    nominal = {name: _filled(mirror_outline(mirror, camera, binning), shape) for name, mirror in mirrors.items()}
    in_any = np.logical_or.reduce(list(nominal.values()))
    front = _largest_in(image, ~in_any, px_per_mm, find_finger, settings)
    if front is None:
        raise BadInput("no finger was found beside the mirrors: check the exposure, the LEDs and the finger's place.")
    _refuse_second(image, front, in_any, px_per_mm)
    found: dict[str, BoolArray] = {}
    near_front = _grown(front, 0.4 * px_per_mm)

    def look(name: str) -> BoolArray | None:
        allowed = _grown(nominal[name], settings.reach_mm * px_per_mm) & ~near_front
        for other, area in nominal.items():
            if other != name:
                allowed &= ~area
        return _largest_in(image, allowed, px_per_mm, find_finger, settings)

    with ThreadPoolExecutor(2) as pool:
        seen = dict(zip(sorted(mirrors), pool.map(look, sorted(mirrors)), strict=True))
    for name, view in seen.items():
        if view is not None:
            _refuse_contact(name, view, front, px_per_mm)
            found[name] = view
    require(
        bool(found),
        "no mirror shows the finger: check that the rig file's mirrors are the ones in the picture, or take the shape "
        "from light (--shape nir or white).",
    )
    return Views(front, found, binning)


def without_mirrors(image: FloatArray, camera: Camera, mirrors: Mapping[str, Mirror], binning: int) -> FloatArray:
    """The image (h, w) or (h, w, C) with the mirrors' nominal outlines filled with the backdrop beside them."""
    shape = (image.shape[0], image.shape[1])
    outlines = [_filled(mirror_outline(mirror, camera, binning), shape) for mirror in mirrors.values()]
    return _blanked(image, ~np.logical_or.reduce(outlines), camera.px_per_mm / binning)


def _blanked(image: FloatArray, inside: BoolArray, px_per_mm: float) -> FloatArray:
    """The image whose pixels outside `inside` look like the backdrop beside them."""
    if inside.all():
        return image
    done = image.copy()
    ring = inside & ~_shrunk(inside, max(2.0, 0.4 * px_per_mm))
    done[~inside] = np.median(done[ring], axis=0) if ring.any() else np.float32(0.0)
    return done


def _largest_in(
    image: FloatArray, allowed: BoolArray, px_per_mm: float, find_finger: FindFinger, settings: ViewSettings
) -> BoolArray | None:
    """The finger in the part of the image that is `allowed`, or None."""
    rows, columns = np.flatnonzero(allowed.any(axis=1)), np.flatnonzero(allowed.any(axis=0))
    if rows.size < 20 or columns.size < 20:
        return None
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    inside = allowed[window]
    part = _blanked(image[window], inside, px_per_mm)
    try:
        mask = find_finger(part, px_per_mm) & inside
    except BadInput:
        return None
    whole = np.zeros(allowed.shape, dtype=np.bool_)
    whole[window] = mask
    return whole if mask.any() else None


def _refuse_second(image: FloatArray, front: BoolArray, in_any: BoolArray, px_per_mm: float) -> None:
    """Refuse another finger beside the first: about as bright, and nearly as large."""
    light = image if image.ndim == 2 else image.sum(axis=2)
    other = (light > 0.5 * float(np.median(light[front]))) & ~in_any & ~_grown(front, 1.5 * px_per_mm)
    _, _, stats, _ = cv2.connectedComponentsWithStats(other.astype(np.uint8))
    largest = max((int(area) for area in stats[1:, cv2.CC_STAT_AREA]), default=0)
    require(
        largest < 0.25 * float(front.sum()),
        "there are two fingers in the picture, or a mirror that the rig file does not name: lay one finger there at a "
        "time, and name all mirrors.",
    )


def _refuse_contact(name: str, view: BoolArray, front: BoolArray, px_per_mm: float) -> None:
    """Refuse a finger that lies on its own mirror image."""
    near = _grown(front, 0.6 * px_per_mm) & view
    require(
        int(near.sum()) < (1.0 * px_per_mm) ** 2,
        f"the finger touches the edge of the {name} mirror: lay it in the middle between the mirrors.",
    )


def _filled(outline: Array, shape: tuple[int, int]) -> BoolArray:
    canvas = np.zeros(shape, dtype=np.uint8)
    cv2.fillPoly(canvas, [np.round(outline * 16).astype(np.int32)], 1, shift=4)
    return np.asarray(canvas, dtype=np.bool_)


def _grown(mask: BoolArray, radius: float) -> BoolArray:
    size = 2 * max(1, round(radius)) + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)), dtype=np.bool_)


def _shrunk(mask: BoolArray, radius: float) -> BoolArray:
    return ~_grown(~mask, radius)
