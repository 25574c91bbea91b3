"""What is written beside a print: its minutiae, on paper and in space, and a picture of its distortion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.apps.pictures import ColourArray, colour, on_paper
from splitknit.apps.printing_sources import Source
from splitknit.errors import BadInput
from splitknit.io.finger_codes import FINGER_CODES
from splitknit.io.iso19794 import write_iso19794
from splitknit.io.minutiae3d import Minutiae3D, angles_of, write_minutiae3d
from splitknit.io.minutiae_record import FingerView, MinutiaeRecord, pixels_per_cm
from splitknit.io.provenance import JsonValue
from splitknit.matching.minutiae_record import Minutiae
from splitknit.matching.space_minutiae import in_space
from splitknit.model import FloatArray
from splitknit.prints import Enhanced, PrintMap, Unrolled, phase_minutiae
from splitknit.prints.print_map import NOWHERE

Array = NDArray[np.float64]
AREA_LIMIT, ANISOTROPY_LIMIT = 0.15, 0.3
"""Ends of the colour bars of the distortion picture."""


def by_phase(image: NDArray[np.uint8], enhanced: Enhanced, ppi: float = 500.0) -> Minutiae:
    """Minutiae of a print by the phase of its ridges, on the grid of 500 ppi as mindtct's."""
    found = phase_minutiae(image, enhanced, ppi)
    scale = 500.0 / ppi
    place = np.rint((found.place_px + 0.5) * scale - 0.5).astype(np.int32)
    size = max(1, round(image.shape[0] * scale)), max(1, round(image.shape[1] * scale))
    column, row = (np.clip(place[:, k], 0, size[1 - k] - 1) for k in (0, 1))
    return Minutiae(column, row, found.direction_rad, found.kind, found.quality, size)


def write_minutiae(  # noqa: PLR0917
    target: Path,
    pictures: Mapping[str, NDArray[np.uint8]],
    enhanced: Enhanced,
    sought_in: str,
    print_map: PrintMap,
    source: Source,
    origin: dict[str, JsonValue],
    finger_quality: int,
) -> dict[str, Any]:
    """Write ``minutiae.iso`` and, where there is a surface, ``minutiae3d.json``; return what is known of them.

    Minutiae are sought by mindtct in ``print.png`` or ``enhanced.png`` of `pictures`, as `sought_in` (without ``.png``)
    says, or by the phase of the ridges (``phase``), which needs no package; `finger_quality` (0 to 100) goes into the
    record.

    Without the package that mindtct comes with, nothing is written and the facts say what to install.
    """
    from splitknit.matching.minutiae import extract  # noqa: PLC0415 - large, and not everywhere

    try:
        if sought_in == "phase":
            found, where = by_phase(pictures["print.png"], enhanced, print_map.ppi), "print.png, by the phase"
        else:
            found, where = extract(pictures[f"{sought_in}.png"], print_map.ppi), f"{sought_in}.png"
    except BadInput as error:
        return {"written": False, "missing": f"{' '.join(str(error).split())} Or find them with --set minutiae=phase."}
    finger = source.subject.get("finger", "unknown")
    finger = finger if isinstance(finger, str) and finger in FINGER_CODES else "unknown"
    view = FingerView(
        x_px=found.x_px,
        y_px=found.y_px,
        direction_rad=found.direction_rad,
        type=found.type,
        quality=found.quality,
        size=found.size,
        finger_quality=finger_quality,
        finger=finger,
        resolution_ppcm=pixels_per_cm(500.0),
    )
    write_iso19794(target / "minutiae.iso", MinutiaeRecord((view,)))
    facts: dict[str, Any] = {
        "written": True,
        "sought_in": where,
        "count": len(found.x_px),
        "finger": finger,
    }
    if source.height_mm is not None or source.points_mm is not None:
        scale = print_map.ppi / 500.0
        places = (np.stack([found.x_px, found.y_px], axis=1).astype(np.float64) + 0.5) * scale - 0.5
        space = minutiae_in_space(places, found.direction_rad, print_map, source)
        good = np.isfinite(space).all(axis=1)
        theta, phi = angles_of(space[good, 3:]) if bool(good.any()) else (np.zeros(0), np.zeros(0))
        x, y, z = space[good, :3].T
        record = Minutiae3D(x, y, z, theta, phi, found.type[good], found.quality[good], finger, origin)
        write_minutiae3d(target / "minutiae3d.json", record)
        facts["in_space"] = int(good.sum())
    return facts


def minutiae_in_space(places: Array, directions_rad: Array, print_map: PrintMap, source: Source) -> Array:
    """(N, 6) x, y, z in mm of the upright finger's frame, and the direction there, of places (N, 2) of a print.

    NaN where the print shows nothing, or the surface is not known.
    """
    if source.points_mm is not None:
        return _on_chart(
            source.points_mm,
            print_map.input_from_print(places),
            print_map.directions_in_input(places, directions_rad),
        )
    assert source.height_mm is not None
    points = None if source.x_mm is None or source.y_mm is None else (source.x_mm, source.y_mm)
    return in_space(
        places, directions_rad, print_map, source.height_mm, source.pitch_mm, source.input_from_upright, points
    )


def _on_chart(points_mm: FloatArray, there: Array, ahead: Array) -> Array:
    """(N, 6) points and directions of places (N, 2) of a chart (H, W, 3), heading `ahead` (N,) on it."""
    step = np.stack([np.cos(ahead), -np.sin(ahead)], axis=1)  # rows run downwards
    here, before, after = (_read(points_mm, at) for at in (there, there - step, there + step))
    return np.column_stack([here, after - before])


def _read(points_mm: FloatArray, places: Array) -> Array:
    """(N, 3) bilinear values of (H, W, 3) at places (N, 2; column, row); NaN outside and beside NaN."""
    if len(places) == 0:
        return np.zeros((0, 3))
    x, y = (np.ascontiguousarray(np.nan_to_num(places[:, d], nan=-10.0), dtype=np.float32) for d in range(2))
    nan = float("nan")
    values = cv2.remap(
        points_mm, x[:, None], y[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(nan, nan, nan)
    )
    return np.asarray(values[:, 0], dtype=np.float64)


def distortion_picture(print_map: PrintMap, unrolled: Unrolled) -> ColourArray:
    """(h, w, 3) two maps side by side with their colour bars, on the pixels of the print.

    Left: area on the print over area of the skin, blue too small, orange too large. Right: by how much more the skin is
    stretched one way than the other.
    """
    node = np.linalg.inv(unrolled.grid.input_from_grid)
    x = node[0, 0] * print_map.columns + node[0, 1] * print_map.rows + node[0, 2] - 0.5
    y = node[1, 0] * print_map.columns + node[1, 1] * print_map.rows + node[1, 2] - 0.5
    shown = print_map.columns > 0.5 * NOWHERE
    panels = []
    for field, low, high, title in (
        (unrolled.distortion.area, -AREA_LIMIT, AREA_LIMIT, "area"),
        (unrolled.distortion.anisotropy, 0.0, ANISOTROPY_LIMIT, "one way"),
    ):
        known = np.isfinite(field)
        filled, share = np.where(known, field, 0.0).astype(np.float32), known.astype(np.float32)
        values, weight = (
            np.asarray(cv2.remap(part, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR), dtype=np.float32)
            for part in (filled, share)
        )
        evened = (values / np.maximum(weight, np.float32(1e-3))).astype(np.float32)
        picture = colour(evened, low, high, diverging=low < 0)
        picture = on_paper(picture, (shown & (weight > 0.01)).astype(np.float32))
        panels.append(np.vstack([picture, _bar(picture.shape[1], low, high, title)]))
    return np.hstack([panels[0], np.full((panels[0].shape[0], 12, 3), 255, np.uint8), panels[1]])


def _bar(width: int, low: float, high: float, title: str) -> ColourArray:
    """A colour bar with its ends in percent."""
    bar = np.full((46, width, 3), 255, dtype=np.uint8)
    ramp = np.linspace(low, high, max(width - 40, 2), dtype=np.float32)[None].repeat(12, axis=0)
    bar[6:18, 20 : 20 + ramp.shape[1]] = colour(ramp, low, high, diverging=low < 0)
    texts = (f"{100 * low:+.0f} %" if low else "0", title, f"{100 * high:+.0f} %")
    for text, share in zip(texts, (0.0, 0.5, 1.0), strict=True):
        (length, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
        place = int(4 + share * (width - 8 - length))
        cv2.putText(bar, text, (place, 37), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 40), 1, cv2.LINE_AA)
    return bar


def map_arrays(print_map: PrintMap) -> dict[str, Any]:
    """What ``map.npz`` holds."""
    return {
        "columns": print_map.columns,
        "rows": print_map.rows,
        "ppi": np.float64(print_map.ppi),
        "input_from_grid": print_map.input_from_grid,
        "print_of_grid": print_map.print_of_grid,
        "surface": np.array(print_map.surface),
    }
