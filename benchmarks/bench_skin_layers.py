"""Seconds and memory of the two-layer fit, 7 x 1528 x 936, against Lambert's model and scipy's fit of single pixels."""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from cases import shadow_case
from splitknit.photometric.hanrahan_krueger import hanrahan_krueger
from splitknit.photometric.hanrahan_krueger_fit import (
    HanrahanKruegerSettings,
    Pixels,
    SkinLayers,
    directions,
    fitted,
    reflected,
)
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust
from timing import machine, print_table, race

NOISE = 0.01
EQUAL = HanrahanKruegerSettings(weights="equal")


def skin_case() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Images of two-layer skin with the relief and lights of the shadow case, layers that differ, and noise."""
    case, layers = shadow_case(), SkinLayers()
    rng = np.random.default_rng(0)
    flat = case.normals.reshape(-1, 3).astype(np.float32)
    strength = np.linalg.norm(case.lights, axis=1, keepdims=True).astype(np.float32)
    unit = (case.lights / strength).astype(np.float32)
    depth = (layers.epidermis_depth * np.exp(rng.normal(0, 0.7, len(flat)))).astype(np.float32)
    fraction = rng.uniform(0.7, 0.97, len(flat)).astype(np.float32)
    base = np.full(len(flat), 0.5, dtype=np.float32)
    exposure = float(np.pi * 0.5 / (EQUAL.base_reflectance * layers.refractive_index**2))
    facing = np.maximum(flat[:, 2], np.float32(0.02))
    stack = np.stack([
        s * reflected((u @ flat.T)[None], facing, u[2:, None], base, fraction, depth, exposure, layers).value[0]
        for u, s in zip(unit, strength, strict=True)
    ])  # fmt: skip
    stack += rng.normal(0, 0.5 * NOISE, stack.shape).astype(np.float32)
    return np.maximum(stack, 0).reshape(case.stack.shape), case.lights, case.mask, case.normals


def by_scipy(stack: np.ndarray, lights: np.ndarray, mask: np.ndarray, pixels: int) -> tuple[float, float, float]:
    """Seconds per pixel of scipy's Levenberg-Marquardt, and how far its costs lie below `Pixels` (mean, max)."""
    chosen = np.random.default_rng(1).choice(np.flatnonzero(mask), pixels, replace=False)
    images = stack.reshape(len(stack), -1)[:, chosen].astype(np.float64)
    g = np.linalg.pinv(lights) @ images
    albedo, strength = np.linalg.norm(g, axis=0), np.linalg.norm(lights, axis=1, keepdims=True)
    median = float(np.median(albedo))
    exposure = np.pi * median / (EQUAL.base_reflectance * EQUAL.layers.refractive_index**2)
    trust = np.ones_like(images) / (EQUAL.noise * albedo)
    own = Pixels(images, trust, (lights / strength)[..., None], strength, albedo, exposure, EQUAL)
    start, costs = own.start(g / albedo), fitted(own, g)[1].cost
    prior = own.start(g / albedo)[3:, 0]
    began, below = time.perf_counter(), []
    for i in range(pixels):
        one = own.take(np.array([i]))

        def residual(theta: np.ndarray, one: Pixels = one) -> np.ndarray:
            normal = directions(theta[:, None])[0]
            model = reflected(
                one.lights[:, :, 0] @ normal, np.maximum(normal[2], 1e-3), one.lights[:, 2],
                one.albedo * np.exp(theta[2]), 1 / (1 + np.exp(-theta[3:4])), np.exp(theta[4:5]), one.exposure,
                EQUAL.layers,
            )  # fmt: skip
            held = (theta[3:] - prior) / [EQUAL.spread_share, EQUAL.spread_depth]
            return np.concatenate([((one.strengths * model.value - one.images) * one.trust)[:, 0], held])

        cost = 2 * least_squares(residual, start[:, i], method="lm").cost
        below.append((costs[i] - cost) / max(cost, 1e-3))
    return (time.perf_counter() - began) / pixels, float(np.mean(below)), float(np.max(below))


def _largest_kb() -> int:
    """Of this program alone: ru_maxrss would count the parent's memory from before the start."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))


def _peak(way: str, file: str, queue: multiprocessing.Queue) -> None:
    with np.load(file) as case:
        stack, lights, mask = case["stack"], case["lights"], case["mask"]
    before = _largest_kb()
    if way == "layers":
        hanrahan_krueger(stack, lights, mask, EQUAL)
    else:
        lambertian(stack, lights, mask)
    queue.put((before, _largest_kb()))


def peak_mb(way: str, file: str) -> tuple[float, float]:
    """Largest resident memory of a process of its own: when the images were read, and after the fit (MB)."""
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    process = context.Process(target=_peak, args=(way, file, queue))
    process.start()
    before, after = queue.get()
    process.join()
    return before / 1024, after / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--pixels", type=int, default=200, help="that scipy fits, one by one")
    chosen = parser.parse_args()
    stack, lights, mask, normals = skin_case()
    print(f"Two-layer skin, {' x '.join(map(str, stack.shape))}, {mask.mean():.0%} of it finger, {machine()}")

    def error(got: np.ndarray) -> str:
        angle = np.degrees(np.arccos(np.clip((got * normals).sum(axis=-1), -1, 1)))
        return f"{angle[mask].mean():.3f}"

    weighted = HanrahanKruegerSettings()
    contenders = {
        "lambertian": lambda: lambertian(stack, lights, mask)[0],
        "robust": lambda: robust(stack, lights, mask)[0],
        "hanrahan_krueger, equal weights (`xie`)": lambda: hanrahan_krueger(stack, lights, mask, EQUAL)[0],
        "hanrahan_krueger, robust weights": lambda: hanrahan_krueger(stack, lights, mask, weighted)[0],
    }
    rows = race(contenders, chosen.rounds)
    print_table(f"Noise of {NOISE:.0%}", rows, error, "mean error deg")
    fit = hanrahan_krueger(stack, lights, mask, EQUAL)[2]
    counts = fit.iterations[mask]
    print(f"\nSteps a pixel: median {np.median(counts):.0f}, 99 % within {np.percentile(counts, 99):.0f}; ", end="")
    print(f"{fit.converged[mask].mean():.2%} of the pixels converged.")
    each, mean, largest = by_scipy(stack, lights, mask, chosen.pixels)
    whole = each * float(mask.sum())
    print(
        f"scipy.optimize.least_squares (lm), {chosen.pixels} pixels one by one: {1e3 * each:.2f} ms each, ",
        end="",
    )
    print(f"{whole / 60:.0f} min for all (extrapolated), {whole / rows[2].median_s:.0f} times the fit's.")
    print(f"Its minima lie lower by {mean:.1e} of the cost in the mean, {largest:.1e} at most.")
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "case.npz")
        np.savez(file, stack=stack, lights=lights, mask=mask)
        for way in ("lambertian", "layers"):
            before, after = peak_mb(way, file)
            print(f"Memory, {way}: {after:.0f} MB at the peak, of which {before:.0f} MB before it began.")


if __name__ == "__main__":
    main()
