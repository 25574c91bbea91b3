"""Ridge periods on our prints against the truth, of ``over_fingers.py``.

The capture's ``truth.npz`` has the true surface. Around many points, a patch of 3 mm of the true
relief is laid flat on the true surface by itself (its own small unrolling, which is as good as
exact over 3 mm) and its ridge period is measured; the same ruler is laid on the same place of our
print. What is reported is the period on the print over the true one, minus one, by slant.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splitknit.finger.ridges import ink
from splitknit.io.npz import read_npz
from splitknit_match.prints.make import make_print
from splitknit_match.prints.print_map import resample, unrolled_map
from splitknit_match.prints.ridge_field import ridge_field
from splitknit_match.prints.sources import Source, read_source
from splitknit_match.prints.unroll import surface_grid, unroll
from splitknit_match.rolled.chart import surface_normals

POINTS = 150
ZONES = {
    "centre (< 20 deg)": (0, 20),
    "20-40 deg": (20, 40),
    "40-55 deg": (40, 55),
    "55-65 deg": (55, 65),
}
PATCH_MM = 3.2


def true_period(truth: dict, source: Source, place: np.ndarray, slant_deg: float) -> float | None:
    """Ridge period (mm) on the true skin around a pixel."""
    reach = int(PATCH_MM / source.pitch_mm * 0.62)
    row, column = (round(float(v)) for v in place[::-1])
    rows = slice(max(0, row - reach), row + reach)
    columns = slice(max(0, column - reach), column + reach)
    shape = truth["shape_mm"][rows, columns]
    mask = np.isfinite(shape)
    if mask.mean() < 0.7:
        return None
    frame = np.eye(3)
    grid = surface_grid(shape, mask, source.pitch_mm, frame, mask.shape, node_mm=0.25)
    print_map = unrolled_map(unroll(grid), "free", slant_deg=80)
    relief = (truth["height_mm"] - truth["shape_mm"])[rows, columns]
    known = mask & np.isfinite(relief)
    image = ink(*resample(relief, known, source.pitch_mm, print_map))
    here = print_map.print_from_input(
        np.array([[column - columns.start, row - rows.start]], dtype=float)
    )[0]
    return period_at(image, here)


def period_at(image: np.ndarray, place: np.ndarray) -> float | None:
    """Ridge period (mm) of a print around a pixel, both prints measured with one ruler: a window of
    2.2 mm."""
    half = 22
    column, row = (round(float(v)) for v in place)
    if min(column, row) < half or column + half > image.shape[1] or row + half > image.shape[0]:
        return None
    part = np.ascontiguousarray(image[row - half : row + half, column - half : column + half])
    if (part > 250).mean() > 0.6:
        return None
    try:
        field = ridge_field(part)
    except ValueError:
        return None
    middle = tuple(slice(n // 2 - 2, n // 2 + 2) for n in field.mask.shape)
    if not field.mask[middle].all() or field.coherence[middle].min() < 0.8:
        return None
    return 25.4 / 500 / float(np.mean(field.frequency_px[middle]))


def period_errors(capture: Path, result: Path) -> dict[tuple[str, str], list[float]]:
    """Relative errors of the ridge period on our print, by its kind and by slant."""
    errors: dict[tuple[str, str], list[float]] = {}
    truth = read_npz(capture / "truth.npz")
    estimated = read_source(result, photo=False, surface=True)
    relief = (truth["height_mm"] - truth["shape_mm"]).astype(np.float32)
    mask = estimated.mask & np.isfinite(relief)
    parts = (truth["height_mm"], relief, truth["shape_mm"])
    true = Source(
        "result",
        mask,
        estimated.pitch_mm,
        estimated.input_from_upright,
        estimated.upright_size,
        *parts,
        truth.get("x_mm"),
        truth.get("y_mm"),
    )
    grid = surface_grid(
        true.shape_mm, mask, true.pitch_mm, true.input_from_upright, true.upright_size
    )
    slant = np.rad2deg(np.arccos(np.abs(surface_normals(grid.points_mm)[..., 2])))
    nodes = np.argwhere(grid.inside)
    rng = np.random.default_rng(1)
    # as many places in each zone
    chosen = []
    for low, high in ZONES.values():
        zone = nodes[(slant[tuple(nodes.T)] >= low) & (slant[tuple(nodes.T)] < high)]
        chosen += list(zone[rng.permutation(len(zone))[: POINTS // len(ZONES)]])
    prints = {
        kind: make_print(estimated, "relief" if kind == "plane" else "unroll", kind)
        for kind in ("free", "plane")
    }
    for node in chosen:
        place = grid.input_from_grid[:2, :2] @ node[::-1] + grid.input_from_grid[:2, 2]
        wanted = true_period(truth, true, place, slant[tuple(node)])
        if wanted is None:
            continue
        zone = next(z for z, (low, high) in ZONES.items() if low <= slant[tuple(node)] < high)
        for kind, finger_print in prints.items():
            where = finger_print.map.print_from_input(place[None])[0]
            period = period_at(finger_print.image, where) if np.isfinite(where).all() else None
            if period is not None:
                errors.setdefault((kind, zone), []).append(period / wanted - 1.0)
    return errors
