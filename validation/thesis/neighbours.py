"""Local binary patterns at the thesis's distance of neighbours, 13 um, and what images of fewer pixels lose.

The same fingers in the same poses and light are photographed at several scales. Two ways reach neighbours that are
nearer than a pixel: ``linear`` between pixels, and ``finer``, on images that are first interpolated (cubic) to the
thesis's 75.7 px/mm. Linear interpolation cannot help the four neighbours along rows and columns: they lie between the
pixel and the next one, and are larger than the pixel exactly where the next one is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from compared import Way, captures_of, compare_pairs, each, kept_images, read_images
from numpy.typing import NDArray
from trials import Pairs, Table, Trial

from splitknit.io.capture import read_capture
from splitknit.io.provenance import settings_hash
from splitknit.model import FloatArray, surface_of
from splitknit.pipeline import reconstruct
from splitknit.presets import preset_settings
from splitknit_match.evaluation.protocol import comparisons
from splitknit_match.matching.features import REFERENCE_PX_PER_MM, cell_px, uniform_bins
from splitknit_match.matching.surface import surface_images
from splitknit_match.matching.thesis import ATTRIBUTES, FingerImages
from splitknit_simulator.population.folder import simulate_population
from splitknit_simulator.population.sessions import PopulationSettings

SCALES = (1.0, 0.4)
SMALL_SCALES = (0.25, 0.1)
PEOPLE = 4
FINGERS = ("right_index", "right_middle", "left_thumb", "left_ring")
MATCHED = ("normals", "relief")
PIXEL_UM = 1000.0 / REFERENCE_PX_PER_MM
"""Of the thesis's images, whose patterns have neighbours one pixel away."""


def codes_at(image: FloatArray, radius: float) -> NDArray[np.uint8]:
    """Codes (H, W) as of :func:`splitknit_match.matching.features.lbp_codes`, neighbours `radius` pixels away."""
    border = int(np.ceil(radius)) + 1
    padded = np.pad(image, border, mode="edge")

    def shifted(source: FloatArray, shift: float, axis: int) -> FloatArray:
        first = int(np.floor(shift + 1e-9))
        near, far = (np.roll(source, -k, axis) for k in (first, first + 1))
        return np.asarray(cv2.addWeighted(near, 1.0 - shift + first, far, shift - first, 0.0))

    codes = np.zeros(image.shape, dtype=np.uint8)
    for k in range(8):
        size = radius * np.sqrt(0.5) if k % 2 else radius
        right, up = (round(float(part(k * np.pi / 4))) * size for part in (np.cos, np.sin))
        there = shifted(shifted(padded, right, 1), -up, 0)[border:-border, border:-border]
        codes |= (there >= image).astype(np.uint8) << np.uint8(k)
    return codes


def patterns_at(image: FloatArray, px_per_mm: float, radius_um: float, finer: bool = False) -> NDArray[np.float32]:
    """Local binary patterns of a channel (H, W) with neighbours at a distance, cells as the thesis's.

    `finer`: of the channel as interpolated to 75.7 px/mm.
    """
    if finer:
        factor = REFERENCE_PX_PER_MM / px_per_mm
        size = round(image.shape[1] * factor), round(image.shape[0] * factor)
        image, px_per_mm = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)), REFERENCE_PX_PER_MM
    cell = cell_px(px_per_mm)
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    codes = cv2.LUT(codes_at(image, 1e-3 * radius_um * px_per_mm), uniform_bins())[: rows * cell, : columns * cell]
    number = np.arange(rows * cell)[:, None] // cell * columns + np.arange(columns * cell)[None, :] // cell
    counts = np.bincount((59 * number + codes).ravel(), minlength=59 * rows * columns).astype(np.float32)
    grid = counts.reshape(-1, 59)
    return np.asarray(grid / np.linalg.norm(grid, axis=1, keepdims=True), dtype=np.float32).ravel()


def ways_of(scale: float, scales: Sequence[float]) -> list[Way]:
    """What is compared at a scale: neighbours one pixel away, 13 um away where a pixel is larger, and of the finest
    images also at the distance of the others' pixels.
    """
    distances = [(PIXEL_UM / scale, "")]
    if scale < 1:
        distances += [(PIXEL_UM, ", linear"), (PIXEL_UM, ", finer")]
    if scale == max(scales):
        distances += [(PIXEL_UM / other, "") for other in scales if other != scale]
    return [
        Way(
            f"scale {scale:g}, {radius_um:.0f} um{how}",
            partial(patterns_at, radius_um=radius_um, finer=how.endswith("finer")),
            attribute,
            ATTRIBUTES[attribute],
        )
        for radius_um, how in distances
        for attribute in MATCHED
    ]


def neighbours_table(  # noqa: PLR0917
    scratch: Path, people: int, fingers: Sequence[str], seed: int, scales: Sequence[float], jobs: int
) -> Table:
    """Trials at every scale of a population of its own, two sessions, all pairs.

    Captures, images and comparisons are kept in `scratch`: what was stopped goes on.
    """
    trials: list[Trial] = []
    pairs = None
    for scale in scales:
        settings = PopulationSettings(seed=seed, scale=scale)
        place = scratch / settings_hash([settings, preset_settings("snk"), people, fingers])[:12]
        facts = simulate_population(
            place / "people", settings, subjects=people, sessions=2, fingers=fingers, workers=jobs
        )
        print(f"neighbours: scale {scale:g}, {facts['simulated']} captures simulated", flush=True)
        names = [path.parent for path in sorted((place / "people").glob("S*/session_*/*/capture.json"))]
        captures = captures_of([path.relative_to(place / "people").as_posix() for path in names])
        each(partial(_keep, place), captures.names.tolist(), jobs)
        every = comparisons(captures.finger.tolist(), captures.session.tolist())
        pairs = Pairs(captures, every.a, every.b)
        trials += compare_pairs(pairs, partial(_read, place), ways_of(scale, scales), place / "scores", jobs)
    assert pairs is not None
    return Table(pairs, tuple(trials), ())


def _keep(place: Path, name: str) -> None:
    def images() -> FingerImages:
        found = surface_images(surface_of(reconstruct(read_capture(place / "people" / name), "snk")))
        needed = [name for of in MATCHED for name in ATTRIBUTES[of]]
        return replace(found, channels={name: found.channels[name] for name in needed})

    kept_images(_file(place, name), images)


def _read(place: Path, name: str) -> FingerImages | None:
    return read_images(_file(place, name))


def _file(place: Path, name: str) -> Path:
    return place / "images" / (name.replace("/", "_") + ".npz")
