"""Balls pressed into a gel: published ways from images to heights beside ours, on the same photographs.

    python validation/elastomer/peers.py BALLS FLAT --radius-mm 0.2475 [--scan scan.yaml]

Everything is calibrated on every second ball of the image and scored on the others by `caps.py`:
the rms error of caps, spheres of known radius fitted in position, and the gain (median, 5 to 95 %). Written for this
table, by description: *least squares*, one vector (and an ambient) for each light, normals by pseudo-inverse; *lookup
table*, each of three lights' ratios in 24 steps, mean gradient of the calibration's pixels in each cell, empty cells by
the nearest one (Johnson and Adelson, CVPR 2009, section 3; Yuan, Dong and Adelson, Sensors 17, 2762 (2017), section
3.3; six lights are joined to three). Both are integrated by cosine transforms (Frankot and Chellappa 1988, eq. 21, with
mirrored borders), as open sensors' software does.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from caps import CAP, cap, outlines_of_scan
from PIL import Image
from scipy.fft import dctn, idctn
from scipy.ndimage import distance_transform_edt, gaussian_filter

from splitknit import reconstruct
from splitknit.imaging.band import coarse_flat, over_flat
from splitknit.integration.poisson import trusted_height
from splitknit.model import Band, Camera, Capture, Led, Rig
from splitknit.photometric.shading import shading_slopes
from splitknit_rig.calibration.shading import calibrate_shading

STEPS = 24
"""Cells of the lookup table along each axis."""


def photographs(folder: Path) -> np.ndarray:
    """Images (L, H, W) float32, in the order of their names."""
    return np.stack(
        [np.asarray(Image.open(file).convert("L"), dtype=np.float32) for file in sorted(folder.glob("*.png"))]
    )


def cosine_integral(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Height (H, W) in pixels whose differences are nearest to slopes dz/dx, dz/dy (y down), by cosine transforms."""
    right, down = (p[:, 1:] + p[:, :-1]) / 2, (q[1:] + q[:-1]) / 2
    divergence = np.diff(right, axis=1, prepend=0, append=0) + np.diff(down, axis=0, prepend=0, append=0)
    rows, columns = p.shape
    eigen = 2 * np.cos(np.pi * np.arange(rows) / rows)[:, None] + 2 * np.cos(np.pi * np.arange(columns) / columns) - 4
    eigen[0, 0] = 1
    spectrum = dctn(divergence, norm="ortho") / eigen
    spectrum[0, 0] = 0
    return idctn(spectrum, norm="ortho")


class Balls:
    """What the photographs show of balls of known radius: light (n, L) and normals (n, 3), y up."""

    def __init__(self, ratio: np.ndarray, centres: np.ndarray, radius: float) -> None:
        light, normals = [], []
        for x, y in centres:
            reach = int(0.8 * radius) + 1
            rows, columns = np.mgrid[int(y) - reach : int(y) + reach + 1, int(x) - reach : int(x) + reach + 1]
            u, v = (columns - x) / radius, (y - rows) / radius
            part = u * u + v * v < 0.64
            normals.append(np.stack([u, v, np.sqrt(np.clip(1 - u * u - v * v, 0, None))], -1)[part])
            light.append(ratio[:, rows[part], columns[part]].T)
        self.light, self.normals = np.concatenate(light), np.concatenate(normals)


def least_squares(ratio: np.ndarray, balls: Balls, ambient: bool) -> np.ndarray:
    """Heights (H, W) in pixels by one light vector, and an ambient, for each light."""
    near = balls.normals[:, 2] > CAP  # shadows of contact lie farther out
    terms = np.c_[balls.normals[near], np.full((int(near.sum()), 1), 1.0 if ambient else 0.0)]
    fitted = np.linalg.lstsq(terms, balls.light[near], rcond=None)[0]
    scaled = np.einsum("kl,lhw->khw", np.linalg.pinv(fitted[:3].T), ratio - fitted[3][:, None, None])
    steep = np.maximum(scaled[2], 0.1 * np.linalg.norm(scaled, axis=0))
    return cosine_integral(-scaled[0] / steep, scaled[1] / steep)


def lookup_table(ratio: np.ndarray, balls: Balls, flat_light: np.ndarray) -> np.ndarray:
    """Heights (H, W) in pixels by a table from three lights to gradients."""
    join = np.array([[1, 1, 0, 0, 0, 0], [0, 0, 1, 1, 0, 0], [0, 0, 0, 0, 1, 1]]) / 2 if len(ratio) == 6 else np.eye(3)
    seen = np.concatenate([balls.light, flat_light]) @ join.T
    low, high = np.percentile(seen, (0.5, 99.5), axis=0)

    def cells(light: np.ndarray) -> np.ndarray:
        step = np.clip(((light - low) / (high - low) * STEPS).astype(int), 0, STEPS - 1)
        return step @ np.array([STEPS * STEPS, STEPS, 1])

    slopes = np.concatenate([-balls.normals[:, :2] / balls.normals[:, 2:], np.zeros((len(flat_light), 2))])
    where, count = cells(seen), np.zeros(STEPS**3)
    np.add.at(count, where, 1)
    table = np.stack([np.bincount(where, slopes[:, k], STEPS**3) / np.maximum(count, 1) for k in range(2)])
    nearest = distance_transform_edt((count == 0).reshape((STEPS,) * 3), return_distances=False, return_indices=True)
    table = table[:, np.ravel_multi_index(tuple(nearest), (STEPS,) * 3).ravel()]
    found = table[:, cells(np.moveaxis(ratio, 0, -1) @ join.T)]
    return cosine_integral(found[0], -found[1])


def with_vectors(ratio: np.ndarray, balls: Balls, pitch_mm: float, preset: str) -> np.ndarray:
    """Heights (H, W) in pixels of a preset, given light vectors and ambient."""
    near = balls.normals[:, 2] > CAP
    terms = np.c_[balls.normals[near], np.ones(int(near.sum()))]
    fitted = np.linalg.lstsq(terms, balls.light[near], rcond=None)[0]
    strength = np.linalg.norm(fitted[:3], axis=0)
    stored = np.clip((ratio - fitted[3][:, None, None]) / strength[:, None, None] * 12000, 0, 65535).astype(np.uint16)
    leds = tuple(Led("white", direction=(float(x), float(y), float(z))) for x, y, z in (fitted[:3] / strength).T)
    count = len(leds)
    band = Band("white", stored[..., None], tuple((k,) for k in range(count)), np.ones(count), np.zeros(count))
    rig = Rig(Camera(1 / pitch_mm, stored.shape[1:]), leds)
    whole = np.ones(stored.shape[1:], dtype=np.bool_)
    return reconstruct(Capture(rig, {"white": band}, material="opaque", mask=whole), preset).height_mm / pitch_mm


def by_shading(pressed: np.ndarray, flat: np.ndarray, options: argparse.Namespace, pitch_mm: float) -> np.ndarray:
    """Heights (H, W) in pixels by `splitknit calibrate shading`'s functions, from the calibration's balls alone."""
    del pitch_mm
    grid = np.stack([coarse_flat(one / 255) for one in flat])
    fit = calibrate_shading([pressed / 255], grid, options.radius_mm, None, [options.taught])
    slopes, deviation = shading_slopes(fit.shading, over_flat(pressed / 255, grid))
    return np.asarray(trusted_height(*slopes, np.square(deviation.min() / deviation)))


def scored(height_px: np.ndarray, pitch_mm: float, radius_mm: float, centres: np.ndarray) -> str:
    """Cells of the table: rms of the caps in um, and gain."""
    rms, gains = [], []
    for centre in centres:
        error, _, _ = cap(height_px * pitch_mm, pitch_mm, radius_mm, centre)
        rms.append(1000 * np.sqrt(np.mean(error**2)))
        gains.append(cap(height_px * pitch_mm, pitch_mm, radius_mm, centre, gain=True)[2])
    low, middle, high = np.percentile(gains, (5, 50, 95))
    return f"{np.sqrt(np.mean(np.square(rms))):.2f} | {middle:.3f} ({low:.3f} to {high:.3f})"


def table(pressed: np.ndarray, flat: np.ndarray, centres: np.ndarray, options: argparse.Namespace) -> Iterator[str]:
    """Lines of the page's table, worst first."""
    radius, pitch_mm = options.radius_mm / options.pitch_mm, options.pitch_mm
    smooth = np.maximum(np.stack([gaussian_filter(one, 8) for one in flat]), 1)
    ratio = pressed / smooth
    size = np.array(ratio.shape[:0:-1])
    inside = ((centres > radius) & (centres < size - radius)).all(axis=1)
    order = np.lexsort((centres[:, 1].round(-2), centres[:, 0].round(-2)))
    alternate = np.zeros(len(centres), dtype=np.bool_)
    alternate[order[::2]] = True
    taught, scored_balls = inside & alternate, inside & ~alternate
    options.taught = np.c_[centres[taught], np.full(int(taught.sum()), radius)]
    balls = Balls(ratio, centres[taught], radius)
    empty = (
        (flat / np.maximum(np.stack([gaussian_filter(one, 8) for one in flat]), 1))[:, ::40, ::40]
        .reshape(len(flat), -1)
        .T
    )
    ways: dict[str, Callable[[], np.ndarray]] = {
        "least squares, a vector for each light": lambda: least_squares(ratio, balls, False),
        "the same with ambient": lambda: least_squares(ratio, balls, True),
        "lookup table": lambda: lookup_table(ratio, balls, empty),
        "`ea`, these vectors and ambient": lambda: with_vectors(ratio, balls, pitch_mm, "ea"),
        "`metric`, the same": lambda: with_vectors(ratio, balls, pitch_mm, "metric"),
        "`--shading`": lambda: by_shading(pressed, flat, options, pitch_mm),
    }
    yield "| method | caps, um rms | gain, median (5 to 95 %) |"
    yield "| --- | --- | --- |"
    rows = {}
    for name, way in ways.items():
        rows[name] = scored(way(), pitch_mm, options.radius_mm, centres[scored_balls])
    for name in sorted(rows, key=lambda one: -float(rows[one].split(" |")[0])):
        yield f"| {name} | {rows[name]} |"
    yield f"{int(taught.sum())} balls calibrate, {int(scored_balls.sum())} are scored."


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("balls", type=Path)
    parser.add_argument("flat", type=Path)
    parser.add_argument("--radius-mm", type=float, required=True)
    parser.add_argument("--pitch-mm", type=float, default=0.00340346, help="side of a pixel")
    parser.add_argument("--scan", type=Path, help="scan.yaml with the balls' outlines (default: that beside the balls)")
    options = parser.parse_args()
    centres = outlines_of_scan(options.scan or options.balls / "scan.yaml")
    for line in table(photographs(options.balls), photographs(options.flat), centres, options):
        print(line, flush=True)


if __name__ == "__main__":
    main()
