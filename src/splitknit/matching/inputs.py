"""What is matched, as it comes: captures, results, templates and prints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import naming, require
from splitknit.io import read_capture, read_image, read_npz, read_print_png
from splitknit.io.templates import read_template
from splitknit.matching import VERSION, Template, make_template, print_band, unpack
from splitknit.model import Progress, no_progress
from splitknit.pipeline import reconstruct
from splitknit.recipe.matchable import MatchingSettings, Surface, surface_of, surface_template

_IMAGES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
_PPI = 500.0
LARGEST_MM = 1000.0
"""Of a result's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of the two that are compared."""

    path: Path
    kind: str
    """``capture``, ``result``, ``template`` or ``print``."""
    surface: Surface | None = None
    template: Template | None = None


def read_side(path: Path, preset: str, settings: MatchingSettings, progress: Progress = no_progress) -> Side:
    """Read one side, whatever it is, and make its template.

    Raises
    ------
    BadInput
        If it is none of the four, or cannot be read.
    """
    progress(f"reading {path.name}", 0.1)
    try:
        found = path.exists()
    except (OSError, ValueError):
        found = False
    require(found, f"there is no '{path}'; name a capture folder, a result folder, a template (.skt) or a print.")
    if path.is_dir():
        kind = "result" if (path / "height.npz").is_file() else "capture"
        known = kind == "result" or (path / "capture.json").is_file()
        require(known, f"'{path}' is neither a result (height.npz) nor a capture (capture.json); name one of them.")
        surface = read_surface(path / "height.npz") if kind == "result" else _reconstructed(path, preset, progress)
        return naming(path, lambda: Side(path, kind, surface, surface_template(surface, settings)))
    if path.suffix.lower() == ".npz":
        surface = read_surface(path)
        return naming(path, lambda: Side(path, "result", surface, surface_template(surface, settings)))
    if path.suffix.lower() in _IMAGES:
        image, ppi = read_print(path)
        band = naming(path, lambda: print_band(image, ppi, settings.band))
        return naming(path, lambda: Side(path, "print", None, make_template(band, settings.template)))
    payload = read_template(path, VERSION)
    return naming(path, lambda: Side(path, "template", None, unpack(payload)))


def read_surface(path: Path) -> Surface:
    """Read a result's ``height.npz``.

    Raises
    ------
    BadInput
        If it is damaged, or an array is missing or of another shape.
    """
    needed = ("ridge_mm", "shape_mm", "normals", "mask", "pitch_mm", "input_from_upright", "upright_size")
    arrays = read_npz(path, needed)
    for name in needed:
        require(name in arrays, f"{path} holds no '{name}'; reconstruct the capture again.")
    shape = arrays["mask"].shape
    expected = {
        "ridge_mm": shape, "shape_mm": shape, "normals": (*shape, 3), "pitch_mm": (), "input_from_upright": (3, 3),
        "upright_size": (2,),
    }  # fmt: skip
    for name, size in expected.items():
        fits = arrays[name].shape == size and arrays[name].dtype.kind in "fiub"
        require(fits and len(shape) == 2, f"{path}: '{name}' has another shape than a result's; reconstruct it again.")
    matrix = arrays["input_from_upright"].astype(np.float64)
    usable = bool(np.isfinite(matrix).all()) and abs(float(np.linalg.det(matrix[:2, :2]))) > 1e-9
    good = arrays["upright_size"].dtype.kind in "iu"
    rows, columns = arrays["upright_size"].tolist() if good else (0, 0)
    usable = usable and 0 < rows <= 20_000 and 0 < columns <= 20_000 and rows * columns <= 100_000_000
    pitch = float(arrays["pitch_mm"])
    usable = usable and 0 < pitch * max(rows, columns) <= LARGEST_MM
    require(
        usable,
        f"{path}: 'input_from_upright', 'upright_size' or 'pitch_mm' cannot be used; reconstruct the capture again.",
    )
    return Surface(
        ridge_mm=arrays["ridge_mm"].astype(np.float32, copy=False),
        shape_mm=arrays["shape_mm"].astype(np.float32, copy=False),
        normals=arrays["normals"].astype(np.float32, copy=False),
        mask=arrays["mask"].astype(np.bool_),
        pitch_mm=pitch,
        input_from_upright=matrix,
        upright_size=(rows, columns),
    )


def _reconstructed(folder: Path, preset: str, progress: Progress) -> Surface:
    capture = read_capture(folder)
    result = naming(
        folder,
        lambda: reconstruct(capture, preset, progress=lambda stage, fraction: progress(stage, 0.1 + 0.7 * fraction)),
    )
    return surface_of(result)


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
        f"{path} says that it has {ppi:.0f} pixels per inch; resample the print to {_PPI:.0f}.",
    )
    return np.asarray(image), ppi
