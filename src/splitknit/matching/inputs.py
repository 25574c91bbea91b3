"""What is matched, as it comes: captures, results, templates and prints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import naming, require
from splitknit.io.capture import photographs_hint, read_capture
from splitknit.io.images import read_image
from splitknit.io.prints import read_print_png
from splitknit.io.results import read_fields
from splitknit.io.templates import read_template
from splitknit.matching.minutiae import extract, installed
from splitknit.matching.ridge_band import print_band
from splitknit.matching.surface import MatchingSettings, surface_template
from splitknit.matching.template import VERSION, Template, make_template, unpack
from splitknit.model import Capture, Progress, Reconstruction, Surface, no_progress, surface_of

_IMAGES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
_PPI = 500.0


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of the two that are compared."""

    path: Path
    kind: str
    """``capture``, ``result``, ``template`` or ``print``."""
    surface: Surface | None = None
    template: Template | None = None


def read_side(
    given: Path | Reconstruction | Capture, preset: str, settings: MatchingSettings, progress: Progress = no_progress
) -> Side:
    """Read one side, whatever it is, and make its template.

    Raises
    ------
    BadInput
        If it is none of the four, or cannot be read.
    """
    if isinstance(given, Reconstruction | Capture):
        result = given if isinstance(given, Reconstruction) else _reconstructed(given, preset, progress)
        surface = surface_of(result)
        return Side(Path("reconstruction"), "result", surface, surface_template(surface, settings))
    path = given
    progress(f"reading {path.name}", 0.1)
    try:
        found = path.exists()
    except (OSError, ValueError):
        found = False
    require(found, f"there is no '{path}'; name a capture folder, a result folder, a template (.skt) or a print.")
    if path.is_dir():
        kind = "result" if (path / "height.npz").is_file() else "capture"
        known = kind == "result" or (path / "capture.json").is_file()
        require(
            known,
            f"'{path}' is neither a result (height.npz) nor a capture (capture.json); name one "
            f"{photographs_hint(path)}.",
        )
        if kind == "result":
            surface = read_surface(path / "height.npz")
        else:
            capture = read_capture(path)
            surface = surface_of(naming(path, lambda: _reconstructed(capture, preset, progress)))
        return naming(path, lambda: Side(path, kind, surface, surface_template(surface, settings)))
    if path.suffix.lower() == ".npz":
        surface = read_surface(path)
        return naming(path, lambda: Side(path, "result", surface, surface_template(surface, settings)))
    if path.suffix.lower() in _IMAGES:
        image, ppi = read_print(path)
        return naming(path, lambda: Side(path, "print", None, print_template(image, ppi, settings)))
    payload = read_template(path, VERSION)
    return naming(path, lambda: Side(path, "template", None, unpack(payload)))


def print_template(image: NDArray[np.uint8], ppi: float = _PPI, settings: MatchingSettings | None = None) -> Template:
    """Template of a print (H, W), ridges dark, with its minutiae where `nbis-py` is installed.

    Raises
    ------
    BadInput
        As :func:`splitknit.matching.ridge_band.print_band`.
    """
    settings = settings or MatchingSettings()
    template = make_template(print_band(image, ppi, settings.band), settings.template)
    return replace(template, minutiae=extract(image, ppi, enhance=True)) if installed() else template


def read_surface(path: Path) -> Surface:
    """Read a result's ``height.npz``.

    Raises
    ------
    BadInput
        If it is damaged, or an array is missing or of another shape.
    """
    arrays = read_fields(path, ("ridge_mm", "shape_mm", "normals"), ("whole",))
    return Surface(**arrays)


def _reconstructed(capture: Capture, preset: str, progress: Progress) -> Reconstruction:
    from splitknit.pipeline import reconstruct  # noqa: PLC0415 - a template needs none of it

    return reconstruct(capture, preset, progress=lambda stage, fraction: progress(stage, 0.1 + 0.7 * fraction))


def read_print(path: Path) -> tuple[NDArray[np.uint8], float]:
    """Read a print (H, W) and its resolution in pixels per inch.

    Raises
    ------
    BadInput
        If it is no 8-bit grey image of about 500 ppi.
    """
    ppi: float | None = None
    image: NDArray[Any]
    if path.suffix.lower() == ".png":
        file = read_print_png(path)
        image, ppi = file.image, file.resolution_ppi
    else:
        pixels = read_image(path)
        grey = pixels.ndim == 2 or pixels.shape[-1] == 1
        require(grey and pixels.dtype == np.uint8, f"{path} is not an 8-bit grey image; save the print as one.")
        image = pixels.reshape(pixels.shape[:2])
    ppi = _PPI if ppi is None else ppi
    require(
        abs(ppi / _PPI - 1.0) < 0.05,
        f"{path} states that it has {ppi:.0f} pixels per inch; resample the print to {_PPI:.0f}.",
    )
    return np.asarray(image), ppi
