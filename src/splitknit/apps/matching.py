"""Matching of files: captures, results, templates and prints in, similarity and alignment out."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from splitknit.check import BadInput, require
from splitknit.geometry import height_gradients, normals_from_gradients
from splitknit.io import read_capture, read_image, read_npz, read_print_png
from splitknit.io.templates import read_template, write_template
from splitknit.match import (
    VERSION,
    FmrTable,
    RidgeBandSettings,
    RidgeMatchSettings,
    Template,
    TemplateSettings,
    ThesisSettings,
    finger_images,
    make_template,
    pack,
    print_band,
    ridge_band,
    ridge_match,
    thesis_match,
    unpack,
)
from splitknit.match.thesis import FingerImages
from splitknit.pipeline import reconstruct
from splitknit.settings import override

Progress = Callable[[str, float], None]
T = TypeVar("T")
METHODS = ("ridge", "thesis")
_IMAGES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
_PPI = 500.0
_FMR_TABLE = "match_fmr.json"
"""Made by validation/match/impostors.py."""


@dataclass(frozen=True, slots=True)
class MatchingSettings:
    """All that ``splitknit match --set`` can change."""

    band: RidgeBandSettings = field(default_factory=RidgeBandSettings)
    template: TemplateSettings = field(default_factory=TemplateSettings)
    ridge: RidgeMatchSettings = field(default_factory=RidgeMatchSettings)
    thesis: ThesisSettings = field(default_factory=ThesisSettings)


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """What matching needs of a reconstruction."""

    ridge_mm: NDArray[np.float32]
    shape_mm: NDArray[np.float32]
    normals: NDArray[np.float32]
    mask: NDArray[np.bool_]
    pitch_mm: float
    input_from_upright: NDArray[np.float64]
    upright_size: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of the two that are compared."""

    path: Path
    kind: str
    """``capture``, ``result``, ``template`` or ``print``."""
    surface: Surface | None = None
    template: Template | None = None


def no_progress(stage: str, share: float) -> None:
    """Say nothing."""


def match_files(
    a: Path,
    b: Path | None,
    *,
    method: str = "ridge",
    template: Path | None = None,
    preset: str = "metric",
    settings: MatchingSettings | dict[str, Any] | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Compare two fingers' files, or make the template of one; return facts for ``--json``.

    Parameters
    ----------
    a, b
        Capture folder, result folder, template (``.skt``) or 500-ppi print. Without `b` only the template is made.
    method
        ``ridge`` or ``thesis``.
    template
        File to write the template of `a` into.
    preset
        By which captures are reconstructed.

    Raises
    ------
    BadInput
        Naming the file at fault.
    """
    require(method in METHODS, f"method must be 'ridge' or 'thesis', but it is '{method}'.")
    require(b is not None or template is not None, "name a second finger to compare with, or --template to write.")
    chosen = settings if isinstance(settings, MatchingSettings) else override(MatchingSettings(), settings or {})
    if template is not None:
        sources = [path.expanduser().resolve() for path in (a, b) if path is not None]
        require(
            template.expanduser().resolve() not in sources, f"'{template}' is one of the inputs; name another file."
        )
    first = read_side(a, preset, chosen, progress)
    facts: dict[str, Any] = {"method": method, "a": _facts(first)}
    if b is not None:
        second = read_side(b, preset, chosen, progress)
        facts["b"] = _facts(second)
        progress("comparing", 0.9)
        compare = _by_ridges if method == "ridge" else _by_thesis
        facts |= compare(first, second, chosen)
    if template is not None:
        payload = pack(_template(first))
        write_template(template, payload, VERSION)
        facts["template"] = {"file": str(template), "bytes": template.stat().st_size, "version": VERSION}
    progress("done", 1.0)
    return facts


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
        return _naming(path, lambda: Side(path, kind, surface, surface_template(surface, settings)))
    if path.suffix.lower() == ".npz":
        surface = read_surface(path)
        return _naming(path, lambda: Side(path, "result", surface, surface_template(surface, settings)))
    if path.suffix.lower() in _IMAGES:
        image, ppi = _read_print(path)
        band = _naming(path, lambda: print_band(image, ppi, settings.band))
        return _naming(path, lambda: Side(path, "print", None, make_template(band, settings.template)))
    payload = read_template(path, VERSION)
    return _naming(path, lambda: Side(path, "template", None, unpack(payload)))


def surface_template(surface: Surface, settings: MatchingSettings) -> Template:
    """Template of a reconstruction."""
    band = ridge_band(
        surface.ridge_mm,
        surface.mask,
        surface.pitch_mm,
        surface.shape_mm,
        surface.input_from_upright,
        surface.upright_size,
        settings.band,
    )
    return make_template(band, settings.template)


def surface_images(surface: Surface) -> FingerImages:
    """Channels of a reconstruction for the thesis's matcher."""
    across, up = height_gradients(surface.shape_mm, surface.pitch_mm)
    return finger_images(
        surface.normals,
        surface.ridge_mm,
        surface.mask,
        surface.pitch_mm,
        surface.input_from_upright,
        surface.upright_size,
        normals_from_gradients(across, up),
    )


def read_surface(path: Path) -> Surface:
    """Read a result's ``height.npz``.

    Raises
    ------
    BadInput
        If it is damaged, or an array is missing or of another shape.
    """
    arrays = read_npz(path)
    needed = ("ridge_mm", "shape_mm", "normals", "mask", "pitch_mm", "input_from_upright", "upright_size")
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
    rows, columns = (int(side) for side in arrays["upright_size"])
    usable = usable and 0 < rows <= 20_000 and 0 < columns <= 20_000
    require(usable, f"{path}: 'input_from_upright' or 'upright_size' cannot be used; reconstruct the capture again.")
    return Surface(
        ridge_mm=arrays["ridge_mm"].astype(np.float32),
        shape_mm=arrays["shape_mm"].astype(np.float32),
        normals=arrays["normals"].astype(np.float32),
        mask=arrays["mask"].astype(np.bool_),
        pitch_mm=float(arrays["pitch_mm"]),
        input_from_upright=matrix,
        upright_size=(rows, columns),
    )


def _reconstructed(folder: Path, preset: str, progress: Progress) -> Surface:
    capture = read_capture(folder)
    result = _naming(
        folder, lambda: reconstruct(capture, preset, progress=lambda stage, share: progress(stage, 0.1 + 0.7 * share))
    )
    return Surface(
        result.ridge_mm, result.shape_mm, result.normals, result.mask, result.pitch_mm, result.input_from_upright,
        result.upright_size,
    )  # fmt: skip


def _read_print(path: Path) -> tuple[NDArray[np.uint8], float]:
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


def _by_ridges(a: Side, b: Side, settings: MatchingSettings) -> dict[str, Any]:
    left, right = _template(a), _template(b)
    found = ridge_match(left, right, settings.ridge)
    return {
        "similarity": found.similarity,
        "fmr": false_match_rate(found.similarity) if found.compared and _as_calibrated(settings) else None,
        "compared": found.compared,
        "overlap_mm2": found.overlap_mm2,
        "correlation": found.correlation,
        "alignment": {"rotation_deg": found.rotation_deg, "right_mm": found.right_mm, "up_mm": found.up_mm},
    }


def false_match_rate(similarity: float) -> float | None:
    """Rate at which other (simulated) fingers reach this similarity of the ridge matcher; None without a table.

    Never below one over the number of impostor comparisons that the table was measured on.
    """
    file = resources.files("splitknit.apps") / _FMR_TABLE
    if not file.is_file():
        return None
    document = json.loads(file.read_text(encoding="utf-8"))
    table = FmrTable(np.array(document["similarity"]), np.array(document["fmr"]), int(document["impostors"]))
    return table(similarity)


def _as_calibrated(settings: MatchingSettings) -> bool:
    """Whether scores mean what they meant when the table was measured."""
    plain = MatchingSettings()
    return (settings.band, settings.template, settings.ridge) == (plain.band, plain.template, plain.ridge)


def _by_thesis(a: Side, b: Side, settings: MatchingSettings) -> dict[str, Any]:
    images = []
    for side in (a, b):
        if side.surface is None:
            raise BadInput(
                f"{side.path} is a {side.kind}; the thesis's matcher needs a surface: name a capture or a result."
            )
        images.append(_naming(side.path, partial(surface_images, side.surface)))
    found = thesis_match(images[0], images[1], settings.thesis)
    return {
        "similarity": found.similarity,
        "fmr": None,
        "compared": found.compared,
        "overlap": found.ratio,
        "dissimilarity": dict(found.dissimilarity),
        "distances": dict(found.distances),
        "alignment": {"right_mm": found.shift_px / images[0].px_per_mm},
    }


def _template(side: Side) -> Template:
    assert side.template is not None
    return side.template


def _facts(side: Side) -> dict[str, Any]:
    template = _template(side)
    return {"path": str(side.path), "kind": side.kind, "area_mm2": template.area_mm2, "acquired": not template.empty}


def _naming(path: Path, work: Callable[[], T]) -> T:
    """Let what stages refuse, which know arrays only, name the file."""
    try:
        return work()
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
