"""What a user writes against the core, for mypy alone: where a comment ignores an error, mypy must
find that error."""

from pathlib import Path

import cv2
import numpy as np

import splitknit


def of_a_folder(folder: Path) -> float:
    capture = splitknit.read_capture(folder)
    result: splitknit.Reconstruction = splitknit.reconstruct(
        capture, preset="snk", settings={"keep": True}
    )
    for finding in result.findings:
        print(finding.code, finding.severity, finding.message)
        print(finding.cod)  # type: ignore[attr-defined]
    assert result.ridge_mm is not None
    return float(np.nanmax(result.ridge_mm[result.mask]))


def of_photographs() -> splitknit.Reconstruction:
    capture = splitknit.read_photographs("photos", "lights.txt", px_per_mm=20.0, material="opaque")
    splitknit.read_photographs("photos", "lights.txt", px_per_m=20.0)  # type: ignore[call-arg]
    splitknit.read_photographs("photos", material="wood")  # type: ignore[arg-type]
    return splitknit.reconstruct(capture, presets="metric")  # type: ignore[call-arg]


def of_arrays(files: list[str]) -> float | None:
    images = [cv2.imread(file) for file in files]
    result = splitknit.reconstruct_images(images, np.eye(3), px_per_mm=30.0)
    print(result.heights)  # type: ignore[attr-defined]
    return result.pitch_mm
