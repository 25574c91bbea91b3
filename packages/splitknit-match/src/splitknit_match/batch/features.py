"""Reconstruction of one capture in all cases: one file of the store for each case."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput, Capture, read_capture, reconstruct
from splitknit.errors import BadExposure, require
from splitknit.finger.locate import FingerSettings
from splitknit.finger.ridges import surface_print
from splitknit.io.images import decode_image
from splitknit.io.prints import encode_print_png, provenance_texts
from splitknit.io.provenance import provenance, settings_hash
from splitknit.methods.photographs import FingerPhotographs
from splitknit.networks.unet import network_threads
from splitknit.pipeline import located
from splitknit.presets import chosen_settings
from splitknit.reconstruction import surface_of
from splitknit_match.batch.cases import Case
from splitknit_match.batch.population import CaptureRef
from splitknit_match.batch.store import (
    SUFFIX,
    TEMPLATES,
    read_origin,
    read_table,
    write_surface,
    write_table,
)
from splitknit_match.matching.surface import surface_template
from splitknit_match.matching.template import pack
from splitknit_match.prints.minutiae import extract
from splitknit_match.records.minutiae_record import no_minutiae, pack_minutiae
from splitknit_match.tasks import Done

PRINT_PPI = 500.0
"""Resolution of the prints that are kept. Source: definition."""
_QUALITY = ("ridge_contrast", "sharpness", "brightness", "ambient_share", "length_mm", "width_mm")
QUALITY = {f"{name}_{band}": (band, name) for band in ("white", "nir") for name in _QUALITY}
"""Columns of quality, and the band and figure of each."""
_MINUTIAE_VERSION = 2
"""Version of the minutiae that are kept; those of version 1 included ends at the outline. Source:
definition."""


def reconstruct_capture(
    store: Path,
    population: Path,
    population_sha256: str,
    surfaces: bool,
    task: tuple[CaptureRef, Sequence[Case]],
) -> Done:
    """Reconstruct a capture and write a table of one row for each case.

    A capture that cannot be read gets no row, so that a later run looks at it again; one whose
    sound images are black or overexposed is a failure to acquire.
    """
    taken, cases = task
    name = taken.name
    capture, unusable = None, ""
    try:
        capture = read_capture(population / name, threads=network_threads())
    except BadInput as error:
        unusable = str(error).replace(f"{population}/", "")  # the same wherever it lies
        if not isinstance(error, BadExposure):
            return Done(0, unreadable=((name, unusable),))
    failures = []
    fingers: dict[FingerSettings, FingerPhotographs] = {}
    for case in cases:
        row = failed_row(taken, unusable)
        if capture is not None:
            file = store / "surfaces" / case.name / f"{name}{SUFFIX}" if surfaces else None
            row |= _reconstructed(capture, fingers, case, file)
        if row["failure"]:
            failures.append(f"{case.name}, {name}: {row['failure']}")
        origin = provenance(case.document(), {name: row["input_sha256"]}) | {
            "kind": "features",
            "kind_version": 1,
            "case": case.name,
            "population_sha256": population_sha256,
            "matching_sha256": TEMPLATES["settings_sha256"],
        }
        write_table(store / "features" / case.name / f"{name}{SUFFIX}", [row], origin)
    return Done(len(cases), failures=tuple(failures))


def failed_row(capture: CaptureRef, failure: str) -> dict[str, Any]:
    """Row of a capture that could not be acquired."""
    return {
        "capture": capture.name, "subject": capture.subject, "finger": capture.finger,
        "session": capture.session, "acquired": False, "failure": failure, "area_mm2": 0.0,
        **dict.fromkeys(QUALITY), "warnings": "[]", "input_sha256": "",
        "template": b"", "print": b"",
    }  # fmt: skip


def _reconstructed(
    capture: Capture,
    fingers: dict[FingerSettings, FingerPhotographs],
    case: Case,
    surface_file: Path | None,
) -> dict[str, Any]:
    """Columns of a reconstruction, or of why there is none; `fingers`: the finger as cases before
    located it, by their settings; `surface_file`: where its surface is kept."""
    inputs = {"input_sha256": settings_hash(dict(sorted(capture.hashes.items())))}
    finding = chosen_settings(case.preset, case.settings())[1].finding()
    try:
        if finding not in fingers:
            fingers[finding] = located(capture, case.preset, case.settings())
        result = reconstruct(fingers[finding], case.preset, case.settings())
    except BadInput as error:
        return inputs | {"failure": str(error)}
    surface = surface_of(result)
    if surface_file is not None:
        write_surface(surface_file, surface, result.height_mm)
    template = surface_template(surface)
    small = "the ridge band that could be acquired is too small for a template."
    texts = provenance_texts(
        provenance({"preset": result.preset, **result.settings}, result.hashes)
    )
    return inputs | {
        **{key: result.quality.get(band, {}).get(name) for key, (band, name) in QUALITY.items()},
        "acquired": not template.empty,
        "failure": small if template.empty else "",
        "area_mm2": float(np.sum(result.mask)) * result.pitch_mm**2,
        "warnings": json.dumps(list(result.warnings)),
        "template": pack(template),
        "print": encode_print_png(surface_print(result, PRINT_PPI), PRINT_PPI, texts),
    }


def extract_minutiae(features: Path, target: Path, file: Path) -> Done:
    """Find the minutiae of the print of a table of features."""
    table = read_table(file, ["capture", "print"])
    capture, data = table["capture"][0], table["print"][0]
    minutiae = no_minutiae()
    if data:
        name = f"the print of '{capture}' in '{file}'"
        pixels = decode_image(data, name)
        require(
            pixels.shape[2] == 1 and pixels.dtype == np.uint8, f"{name} is not an 8-bit grey image."
        )
        minutiae = extract(np.asarray(pixels[..., 0], dtype=np.uint8))
    row = {
        "capture": capture,
        "acquired": minutiae.acquired,
        "minutiae": pack_minutiae(minutiae),
    }
    origin = read_origin(file) | {"kind": "minutiae", "kind_version": _MINUTIAE_VERSION}
    write_table(target / file.relative_to(features), [row], origin)
    return Done(1)
