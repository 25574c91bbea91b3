"""A print's folder: the pictures, the minutiae and the report that ``splitknit print`` writes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.printing_files import distortion_picture, map_arrays, write_minutiae
from splitknit.apps.printing_rolled import KINDS as ROLLED_KINDS
from splitknit.apps.printing_rolled import laid_flat, read_rolled, write_rolled
from splitknit.apps.printing_sources import Source, read_source
from splitknit.apps.targets import check_target
from splitknit.errors import BadInput, require
from splitknit.io import atomic_file, atomic_folder, canonical_json, provenance, write_image, write_npz, write_print_png
from splitknit.model import FloatArray
from splitknit.prints import (
    CurvatureSettings,
    Enhanced,
    PrintMap,
    PrintQuality,
    PrintQualitySettings,
    PrintSettings,
    Unrolled,
    UnrollSettings,
    as_print,
    curvature,
    gabor_enhance,
    ink,
    plane_map,
    print_quality,
    resample,
    ridge_mask,
    stft_enhance,
    surface_grid,
    thin,
    unroll,
    unrolled_map,
)
from splitknit.prints.unroll import KINDS
from splitknit.recipe.rolled import Rolled
from splitknit.recipe.rolled_settings import RolledSettings
from splitknit.settings import override

RESOLUTIONS = (500.0, 1000.0)
Progress = Callable[[str, float], None]


def print_to_folder(
    path: Path,
    out: Path,
    *,
    method: str = "unroll",
    surface: str | None = None,
    ppi: float = 500.0,
    preset: str = "metric",
    changes: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Make a print of a capture or a result and write all its files; return the facts of ``report.json``.

    Raises
    ------
    BadInput
        Naming the input at fault.
    """
    started = time.perf_counter()
    tell = progress or (lambda stage, share: None)
    settings = override(PrintingSettings(), dict(changes or {}))
    place = checked_surface(method, surface, settings)
    require(ppi in RESOLUTIONS, f"a print has 500 or 1000 pixels per inch, not {ppi:g}.")
    check_target(out, "map.npz", "an earlier print", keep=path)
    with atomic_folder(out) as target:
        source, around = _read(path, method, place, preset, settings, tell)
        timings = {"reading": time.perf_counter() - started}
        tell("printing", 0.75)
        try:
            clock = time.perf_counter()
            made = (
                make_print(source, method, place, ppi, settings)
                if around is None
                else make_rolled_print(around, source, place, ppi, settings)
            )
            timings["printing"] = time.perf_counter() - clock
            tell("enhancing", 0.85)
            clock = time.perf_counter()
            enhanced = enhance(made, ppi, settings)
            ridges = ridge_mask(enhanced)
            lines = thin(ridges)
            timings["enhancing"] = time.perf_counter() - clock
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
        tell("writing", 0.92)
        origin = provenance({**_parameters(method, settings), "surface": place, "ppi": ppi}, source.hashes)
        texts = {"Software": f"splitknit {origin['version']}", "Comment": canonical_json(origin)}
        pictures = {
            "print.png": made.image,
            "enhanced.png": enhanced.image,
            "binary.png": as_print(ridges),
            "thinned.png": as_print(lines),
        }
        for name, picture in pictures.items():
            write_print_png(target / name, picture, ppi, texts)
        write_npz(target / "map.npz", map_arrays(made.map))
        facts: dict[str, Any] = {
            "method": method,
            "surface": place,
            "source": {"path": str(path), "kind": source.kind, "preset": source.preset, "pitch_mm": source.pitch_mm},
            "ppi": ppi,
            "enhanced": settings.enhance,
            **_sizes(made, enhanced, ppi),
        }
        if made.unrolled is not None:
            facts["distortion"] = made.unrolled.distortion.figures()
            write_image(target / "distortion.png", distortion_picture(made.map, made.unrolled))
        if around is not None:
            facts["rolled"] = write_rolled(target, around)
        clock = time.perf_counter()
        quality = measured(made, enhanced, ppi, settings)
        timings["quality"] = time.perf_counter() - clock
        nfiq2 = nfiq2_of(pictures, ppi)
        facts["quality"] = quality_facts(quality, nfiq2)
        sought = settings.minutiae
        facts["minutiae"] = write_minutiae(
            target, pictures, enhanced, sought, made.map, source, origin, round(quality.score)
        )
        timings["total"] = time.perf_counter() - started
        facts["timings_s"] = {name: round(value, 3) for name, value in timings.items()}
        facts["provenance"] = origin
        facts["files"] = sorted([path.name for path in target.iterdir()] + ["report.json"])
        with atomic_file(target / "report.json") as stream:
            stream.write((json.dumps(facts, indent=1, allow_nan=False) + "\n").encode("utf-8"))
    tell("done", 1.0)
    return {**facts, "out": str(out)}


def _read(  # noqa: PLR0917
    path: Path, method: str, place: str, preset: str, settings: PrintingSettings, tell: Progress
) -> tuple[Source, Rolled | None]:  # fmt: skip
    """What the print is made from, and the finger around its front where the print is rolled."""
    if method == "rolled":
        return read_rolled(path, preset, settings.rolled, tell)
    photo = method == "photo"
    surface = not photo or place != "plane"
    return read_source(path, photo=photo, surface=surface, preset=preset, progress=tell), None


def _parameters(method: str, settings: PrintingSettings) -> dict[str, Any]:
    """What a print follows from; the rolled finger's settings only where it is one."""
    found = {"method": method, **asdict(settings)}
    if method != "rolled":
        found.pop("rolled")
    return found


def _sizes(made: Print, enhanced: Enhanced, ppi: float) -> dict[str, Any]:
    return {
        "size": list(made.image.shape),
        "mirrored": True,
        "ridges": "dark",
        "ridge_period_mm": _periods(enhanced, ppi),
        "area_mm2": round(float(made.weight.sum()) * (25.4 / ppi) ** 2, 1),
        "ridge_area_mm2": round(float(enhanced.mask.sum()) * (25.4 / ppi) ** 2, 1),
    }


def _periods(enhanced: Enhanced, ppi: float) -> dict[str, float]:
    period = enhanced.field.period_mm(ppi)[enhanced.field.mask]
    low, middle, high = (round(float(value), 4) for value in np.percentile(period, [5, 50, 95]))
    return {"p5": low, "median": middle, "p95": high}


# Quality of a print as a report tells it: NFIQ 2, our own figures and score, and what to do in words.

MOST_SENTENCES = 3
LEAST_WORTH = 0.7
"""A figure that is worth less is spoken of."""
FULL_WORTH = 0.95
"""Of the ridges' height: from here on, soft edges are the finger's own."""


def nfiq2_of(pictures: Mapping[str, NDArray[np.uint8]], ppi: float) -> dict[str, int | None] | None:
    """NFIQ 2 of ``print.png`` and ``enhanced.png``, None where it sees no print; None without the package for it."""
    from splitknit.matching.minutiae import NFIQ2_FAILED, nfiq2  # noqa: PLC0415 - large, and not everywhere

    try:
        found = {name: nfiq2(pictures[f"{name}.png"], ppi) for name in ("print", "enhanced")}
    except BadInput:
        return None
    return {name: None if value == NFIQ2_FAILED else value for name, value in found.items()}


def quality_facts(found: PrintQuality, nfiq2: dict[str, int | None] | None) -> dict[str, Any]:
    """What ``report.json`` holds under ``quality``: plain numbers and sentences."""

    def rounded(values: Mapping[str, float | None]) -> dict[str, float | None]:
        return {name: None if value is None else round(value, 3) for name, value in values.items()}

    return {
        "nfiq2": nfiq2,
        "ours": round(found.score, 1),
        "figures": rounded(asdict(found.figures)),
        "worth": rounded(found.worth),
        "advice": list(advice(found)),
    }


def advice(found: PrintQuality) -> tuple[str, ...]:
    """What is wrong with a print and what to do, at most three sentences, the worst first; empty if nothing is.

    Every figure that is worth less than 0.7 may speak; figures with one remedy speak once, through the worst of them.
    """
    spoken: dict[str, None] = {}
    causes: set[str] = set()
    for name, worth in sorted(found.worth.items(), key=lambda item: item[1]):
        cause = _CAUSES[name]
        if cause == "soft" and found.worth.get("ridge_height_um", 0.0) >= FULL_WORTH:
            continue  # defocus lowers ridges as well; soft but high ones grew that way
        if worth < LEAST_WORTH and cause not in causes and len(spoken) < MOST_SENTENCES:
            causes.add(cause)
            spoken[_sentence(cause, name, found)] = None
    return tuple(spoken)


_CAUSES = {
    "ridge_height_um": "weak",
    "ridge_share": "lost",
    "gap_share": "gaps",
    "coherence": "noise",
    "plausible_share": "noise",
    "sharpness": "soft",
    "ridge_area_mm2": "partial",
    "ridge_length_mm": "partial",
    "centre_offset_mm": "beside",
}


def _sentence(cause: str, name: str, found: PrintQuality) -> str:
    figures = found.figures
    lost = 100 * (1 - figures.ridge_share)
    noise = "directions of ridges disagree" if name == "coherence" else "distances of ridges are not plausible"
    sentences = {
        "weak": f"Ridges are weak ({figures.ridge_height_um or 0:.0f} um), missing over {lost:.0f} % of the area: dry, "
        "worn, wet or out of focus; moisten the finger if it is dry, dry it if it is wet, check the focus, and capture "
        "again.",
        "lost": f"Ridges are missing over {lost:.0f} % of the finger's area; check focus and exposure, clean finger "
        "and lens, and capture again.",
        "gaps": f"{100 * figures.gap_share:.0f} % of the skin between ridges shows none: glare, a crease, a scar, "
        "water, dirt or blur; wipe the finger and the lens, check the focus, and capture again.",
        "noise": f"The picture is noisy or the finger dusty ({noise}); wipe it, lengthen the exposure, keep the finger "
        "still, and capture again.",
        "soft": "The ridges' edges are soft; focus the camera on the finger, keep it still, and capture again.",
        "partial": f"Only {figures.ridge_length_mm:.0f} mm of ridges ({figures.ridge_area_mm2:.0f} mm2) are in view; "
        "push the finger further in, its pad to the camera, and capture again.",
        "beside": f"The ridges lie {figures.centre_offset_mm:.0f} mm beside the finger's middle; turn its pad to the "
        "camera and capture again.",
    }
    return sentences[cause]


# Prints of a finger: what is inked (relief, curvature, photograph), and where (finger plane, unrolled skin).

METHODS = ("relief", "unroll", "curvature", "photo", "rolled")
SURFACES = ("plane", *KINDS)


@dataclass(frozen=True, slots=True)
class PrintingSettings:
    """All that ``splitknit print --set`` can change."""

    ink: PrintSettings = field(default_factory=PrintSettings)
    unroll: UnrollSettings = field(default_factory=UnrollSettings)
    curvature: CurvatureSettings = field(default_factory=CurvatureSettings)
    enhance: Literal["gabor", "stft"] = "gabor"
    """How ``enhanced.png`` is made."""
    minutiae: Literal["phase", "print", "enhanced"] = "phase"
    """``phase``: minutiae are read off the phase of the enhanced ridges; else the picture in which mindtct seeks."""
    quality: PrintQualitySettings = field(default_factory=PrintQualitySettings)
    rolled: RolledSettings = field(default_factory=RolledSettings)
    """Of ``rolled``: how the views of a capture with mirrors become one finger."""


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """A print, and where its pixels come from."""

    image: NDArray[np.uint8]
    """(h, w) ridges dark."""
    weight: FloatArray
    """(h, w) share of the pixel that lies on the finger, 0 to 1."""
    map: PrintMap
    values: FloatArray
    """(h, w) what its quality is measured on: the relief in mm, or the light of the photograph."""
    in_mm: bool
    """Whether it is the relief."""
    unrolled: Unrolled | None = None


def make_print(
    source: Source, method: str, surface: str | None = None, ppi: float = 500.0,
    settings: PrintingSettings | None = None,
) -> Print:  # fmt: skip
    """Make a print of a finger.

    Parameters
    ----------
    source : Source
        From :func:`splitknit.apps.printing_sources.read_source`.
    method : ``relief``, ``unroll``, ``curvature`` or ``photo``
    surface : ``plane``, ``free``, ``arc``, ``tube`` or ``cylinder``, optional
        Where it is printed. ``relief``, ``curvature`` and ``photo`` are printed on the finger plane unless this says
        otherwise; ``unroll`` is the relief on the skin laid flat (``free``).
    ppi : float
    settings : PrintingSettings, optional

    Raises
    ------
    BadInput
        If the source lacks what is needed, or there are no ridges.
    """
    settings = settings or PrintingSettings()
    require(method != "rolled", "a rolled print is made from a capture with mirrors: make_rolled_print.")
    place = checked_surface(method, surface, settings)
    inks = replace(settings.ink, ppi=ppi)
    unrolled: Unrolled | None = None
    if place == "plane":
        print_map = plane_map(source.pitch_mm, source.input_from_upright, source.upright_size, ppi)
    else:
        unrolled, print_map = _laid_flat(source, place, ppi, settings.unroll)
    if method == "curvature":
        height = _needed(source.height_mm)
        found = curvature(
            height, source.mask, source.pitch_mm, settings.curvature, source.x_mm, source.y_mm
        ).shape_index
        known = source.mask & np.isfinite(found)
        require(bool(known.any()), "the finger is too small for a curvature map.")
        values, weight = resample(found, known, source.pitch_mm, print_map)
        ink(values, weight, inks)  # refuses what has no ridges
        grey = np.clip((values - 0.25) / 0.5, 0.0, 1.0)  # valleys 0, ridges 1
        image = np.round(255.0 * (1.0 - grey * weight)).astype(np.uint8)
        relief = _needed(source.ridge_mm)
        inked, _ = resample(relief, source.mask & np.isfinite(relief), source.pitch_mm, print_map)
    else:
        field_of = _needed(source.photo if method == "photo" else source.ridge_mm)
        inked, weight = resample(field_of, source.mask & np.isfinite(field_of), source.pitch_mm, print_map)
        image = ink(inked, weight, inks)
    return Print(image, weight, print_map, inked, method != "photo", unrolled)


def make_rolled_print(rolled: Rolled, source: Source, kind: str, ppi: float, settings: PrintingSettings) -> Print:
    """Make a print of a finger around its front.

    Raises
    ------
    BadInput
        If there are no ridges or too little skin.
    """
    unrolled, print_map = laid_flat(rolled, kind, ppi, settings.unroll)
    inked, weight = resample(_needed(source.ridge_mm), source.mask, source.pitch_mm, print_map)
    image = ink(inked, weight, replace(settings.ink, ppi=ppi))
    return Print(image, weight, print_map, inked, True, unrolled)


def checked_surface(method: str, surface: str | None, settings: PrintingSettings) -> str:
    """Where a print is made; refuses what does not go together.

    Raises
    ------
    BadInput
        If method or surface are not known, or ``unroll`` is asked for on the plane.
    """
    require(method in METHODS, f"method must be one of {', '.join(METHODS)}, but it is '{method}'.")
    require(surface is None or surface in SURFACES, f"surface must be one of {', '.join(SURFACES)}, not '{surface}'.")
    if method == "rolled":
        kind = surface or (settings.unroll.kind if settings.unroll.kind in ROLLED_KINDS else "free")
        require(kind in ROLLED_KINDS, f"a rolled finger is laid flat {' or '.join(ROLLED_KINDS)}, not on the {kind}.")
        return kind
    if surface is None:
        return settings.unroll.kind if method == "unroll" else "plane"
    require(
        not (method == "unroll" and surface == "plane"),
        "--method unroll cannot be printed on the plane; use --method relief for that.",
    )
    return surface


def enhance(made: Print, ppi: float, settings: PrintingSettings | None = None) -> Enhanced:
    """Enhance a print the way the settings say."""
    settings = settings or PrintingSettings()
    require(settings.enhance in ("gabor", "stft"), f"enhance must be gabor or stft, but it is '{settings.enhance}'.")
    if settings.enhance == "stft":
        return stft_enhance(made.image, ppi, made.weight > 0.5)
    return gabor_enhance(made.image, ppi, made.weight > 0.5)


def measured(made: Print, enhanced: Enhanced, ppi: float, settings: PrintingSettings | None = None) -> PrintQuality:
    """How good a print is; `enhanced` is what :func:`enhance` made of it."""
    values = (np.float32(1000.0) * made.values).astype(np.float32) if made.in_mm else made.values
    chosen = (settings or PrintingSettings()).quality
    return print_quality(values, made.weight, enhanced.field, ppi, in_um=made.in_mm, settings=chosen)


def _needed(values: FloatArray | None) -> FloatArray:
    if values is None:
        raise BadInput("this kind of print needs a reconstruction or a photograph that the input does not hold.")
    return values


def _laid_flat(source: Source, kind: str, ppi: float, settings: UnrollSettings) -> tuple[Unrolled, PrintMap]:
    grid = surface_grid(
        _needed(source.shape_mm),
        source.mask,
        source.pitch_mm,
        source.input_from_upright,
        source.upright_size,
        source.x_mm,
        source.y_mm,
        settings.grid,
    )
    unrolled = unroll(grid, override(settings, {"kind": kind}))
    return unrolled, unrolled_map(unrolled, kind, ppi, settings.slant_deg)
