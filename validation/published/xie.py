"""Xie's system (the thesis's [42], 2.1 to 2.3): `ea` whose skin has two layers that scatter light.

    python validation/published/xie.py CAPTURE --out RESULT

Light enters through the surface (Fresnel) and is refracted; what the epidermis scatters once, and
the dermis, without end, below it, leaves through the surface again; all that is scattered more
often is a matt base. With mu_i, mu_r the cosines of light and view outside and c_i, c_r those of
the refracted rays, an image is

    I = strength * mu_i * T(mu_i) T(mu_r) / T(1)^2 * (base + exposure * K),
    K = [W p(q; g) (1 - E) + W' p(q; g') E] / (c_i + c_r),    E = exp(-depth (1 / c_i + 1 / c_r)),

q the cosine between the refracted rays towards light and view, p Henyey and Greenstein's phase
function, W the fraction of an interaction that is scattering and not absorption; primes are the
dermis. Fitted at every pixel by Levenberg and Marquardt's method: the normal (2), the base, and W
and optical depth of the epidermis, the last two held to typical skin, as seven images see little of
them.

W. Xie, Z. Song and R. C. Chung, "Real-time three-dimensional fingerprint acquisition via a new
photometric stereo means", Optical Engineering 52 (2013). P. Hanrahan and W. Krueger, "Reflection
from layered surfaces due to subsurface scattering", SIGGRAPH 1993. D. W. Marquardt, "An algorithm
for least-squares estimation of nonlinear parameters", SIAM J. Appl. Math. 11 (1963).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Capture
from splitknit.imaging.geometry import gradients_from_normals
from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.io.capture import read_capture
from splitknit.methods.photographs import FingerSurface, findings_for, photographs_of, placed
from splitknit.methods.photometry import fast_part
from splitknit.model import BoolArray, FloatArray
from splitknit.photometric.lambertian import lambertian
from splitknit.presets import PRESETS
from splitknit.reconstruction import Reconstruction
from splitknit.report.result import write_results

Array = NDArray[Any]
INDEX = 1.5
"""Refractive index of both layers. Skin has 1.37 to 1.5; 1.5 was best on simulated fingers."""
EPIDERMIS_G = 0.79
"""Mean cosine of the angle of scattering in the epidermis; this and the next three from Hanrahan
and Krueger's table."""
DERMIS_G = 0.81
"""Mean cosine of the angle of scattering in the dermis."""
EPIDERMIS = 50.0, 3.8, 0.08
"""Scattering and absorption per mm, and thickness in mm: the prior of each pixel."""
DERMIS_W = 21.7 / (21.7 + 0.3)
BASE_ALBEDO = 0.45
"""Fraction of the light that the matt base gives back, of the median pixel."""
NOISE_SD = 0.02
"""Standard deviation of an image's noise, relative to the albedo."""
W_SD = 1.0
"""Standard deviation of W's logit over the pixels."""
DEPTH_SD = 0.7
"""Standard deviation of the depth's logarithm over the pixels."""
MAX_ITERATIONS = 30
MIN_STEP = 1e-3
"""A pixel has converged when no parameter moves by more."""
MIN_GAIN = 1e-5
"""A pixel has converged when its cost falls by a smaller fraction."""
DAMPING = 1e-3
"""Damping of Levenberg and Marquardt at the start."""
DAMPING_UP = 8.0
"""Factor of the damping after a step that raised the cost."""
DAMPING_DOWN = 0.15
"""Factor of the damping after a step that lowered the cost."""
MAX_STEPS = np.array([0.25, 0.25, 0.7, 2.0, 1.5], dtype=np.float32)[:, None]
LOWER_LIMITS = np.array([-np.inf, -np.inf, -4.0, -9.0, -6.0], dtype=np.float32)[:, None]
UPPER_LIMITS = np.array([np.inf, np.inf, 4.0, 9.0, 5.0], dtype=np.float32)[:, None]
STEEPEST = 0.97
"""Largest f^2 + g^2: 89 deg of slant."""
MAX_SLOPE = 6.0
PIXELS_AT_A_TIME = 20_000


def refracted(cosine: Array) -> tuple[Array, Array]:
    """Cosine inside of a ray with `cosine` outside, and its derivative (Snell)."""
    inside = np.sqrt(1 - (1 - cosine * cosine) / INDEX**2)
    return inside, cosine / (INDEX**2 * inside)


def transmitted(cosine: Array, inside: Array) -> tuple[Array, Array]:
    """Fraction of unpolarised light that passes the surface, T, and dT / d cosine (Fresnel)."""
    across, along = cosine + INDEX * inside, INDEX * cosine + inside
    share = 2 * INDEX * cosine * inside * (1 / across**2 + 1 / along**2)
    slope = 2 * (INDEX**2 - 1) / INDEX / inside
    return share, slope * (
        (INDEX * inside - cosine) / across**3 + (inside - INDEX * cosine) / along**3
    )


def scattered(cosine: Array, g: float) -> tuple[Array, Array]:
    """Phase function by the cosine between the rays towards light and viewer, and its
    derivative."""
    below = 1 + g * g + 2 * g * cosine
    phase = (1 - g * g) / (4 * np.pi) / (below * np.sqrt(below))
    return phase, -3 * g * phase / below


def reflected(
    mu: Array, view: Array, between: Array, unknowns: tuple[Array, Array, Array], exposure: float
) -> Array:
    """Images (L, n) for strength one, and their derivatives by mu_i, mu_r, base, W and depth: (6,
    L, n).

    `mu` (L, n) and `view` (n,) are cosines with the normal, `between` (L, 1) that of light and
    view; `unknowns`: base, W and optical depth (n,). Where the light is behind the surface
    everything is zero.
    """
    base, share, depth = unknowns
    lit = mu > 0
    mu = np.where(lit, mu, np.float32(1))
    inside, inside_by = refracted(mu)
    outside, outside_by = refracted(view)
    enters, enters_by = transmitted(mu, inside)
    facing = (4 * INDEX / (1 + INDEX) ** 2) ** 2
    leaves, leaves_by = (part / facing for part in transmitted(view, outside))
    turn = (between - mu * view) / INDEX**2 + inside * outside
    upper, upper_by = scattered(turn, EPIDERMIS_G)
    lower, lower_by = (DERMIS_W * part for part in scattered(turn, DERMIS_G))
    passed = np.exp(-depth * (1 / inside + 1 / outside))
    spread = 1 / (inside + outside)
    upper_lit = spread * (1 - passed)
    step = (lower - share * upper) * passed * spread
    once = share * upper * upper_lit + lower * passed * spread
    by_turn = share * upper_by * upper_lit + lower_by * passed * spread
    by_light = by_turn * (outside * inside_by - view / INDEX**2) + inside_by * (
        step * depth / inside**2 - once * spread
    )
    by_view = by_turn * (inside * outside_by - mu / INDEX**2) + outside_by * (
        step * depth / outside**2 - once * spread
    )
    through = np.where(lit, mu * enters, np.float32(0))
    front, level = through * leaves, base + exposure * once
    return np.stack(
        [
            front * level,
            np.where(lit, leaves, np.float32(0)) * (enters + mu * enters_by) * level
            + front * exposure * by_light,
            through * leaves_by * level + front * exposure * by_view,
            front,
            front * exposure * upper * upper_lit,
            -front * exposure * step * (1 / inside + 1 / outside),
        ]
    )


def directions(f: Array, g: Array) -> tuple[Array, Array, Array]:
    """Unit normals (3, n) of stereographic coordinates, and their derivatives by either."""
    twice = 2 / (1 + f * f + g * g)
    x, y = f * twice, g * twice
    by_f, by_g = (twice - x * x, -x * y, -twice * x), (-x * y, twice - y * y, -twice * y)
    return np.stack([x, y, twice - 1]), np.stack(by_f), np.stack(by_g)


def prior() -> tuple[float, float]:
    """Logit of W, and logarithm of the optical depth, of typical skin."""
    scattering, absorption, thickness = EPIDERMIS
    return float(np.log(scattering / absorption)), float(
        np.log(thickness * (scattering + absorption))
    )


def fit(images: Array, lights: Array, start: Array, albedo: Array, exposure: float) -> Array:
    """Parameters (5, n) of images (L, n): f, g, logarithm of base over albedo, logit of W,
    logarithm of the depth.

    `lights`: (L, 3); `start`: Lambertian normals (3, n), and their `albedo` (n,).
    """
    strength = np.linalg.norm(lights, axis=1)[:, None].astype(np.float32)
    units = (lights / strength).astype(np.float32)
    trust = np.float32(1 / NOISE_SD) / albedo
    here = np.zeros((5, images.shape[1]), dtype=np.float32)
    here[:2] = start[:2] / (1 + np.maximum(start[2], 0))
    here[3], here[4] = prior()
    here = moved(here, np.zeros_like(here))

    def equations(p: Array, part: Array) -> tuple[Array, Array, Array]:
        """Cost (n,), gradient (5, n) and normal matrix (5, 5, n) of the pixels `part`."""
        normals, by_f, by_g = directions(p[0], p[1])
        share = 1 / (1 + np.exp(-p[3]))
        depth = np.exp(p[4])
        base = albedo[part] * np.exp(p[2])
        value, light, view, of_base, of_share, of_depth = reflected(
            units @ normals, normals[2], units[:, 2:], (base, share, depth), exposure
        )
        scale = strength * trust[part]
        slopes = scale * np.stack(
            [
                light * (units @ by_f) + view * by_f[2],
                light * (units @ by_g) + view * by_g[2],
                of_base * base,
                of_share * share * (1 - share),
                of_depth * depth,
            ]
        )
        residual = value * scale - images[:, part] * trust[part]
        cost = (residual**2).sum(axis=0)
        gradient = (slopes * residual).sum(axis=1)
        matrix = np.einsum("iln,jln->ijn", slopes, slopes)
        for row, spread, usual in zip((3, 4), (W_SD, DEPTH_SD), prior(), strict=True):
            away = (p[row] - usual) / spread
            cost += away**2
            gradient[row] += away / spread
            matrix[row, row] += 1 / spread**2
        return cost, gradient, matrix

    active = np.arange(images.shape[1])
    damping = np.full(images.shape[1], DAMPING)
    cost, gradient, matrix = equations(here, active)
    for _ in range(MAX_ITERATIONS):
        damped = matrix * (1 + damping * np.eye(5)[..., None]) + 1e-12 * np.eye(5)[..., None]
        step = np.linalg.solve(np.moveaxis(damped, -1, 0), -gradient.T[..., None])[..., 0].T
        trial = moved(here[:, active], step.astype(np.float32))
        new = equations(trial, active)
        better = new[0] < cost
        still = (np.abs(trial - here[:, active]).max(axis=0) < MIN_STEP) | (
            better & (cost - new[0] < MIN_GAIN * cost)
        )
        here[:, active] = np.where(better, trial, here[:, active])
        cost, gradient, matrix = (
            np.where(better, n, k) for n, k in zip(new, (cost, gradient, matrix), strict=True)
        )
        damping = np.clip(damping * np.where(better, DAMPING_DOWN, DAMPING_UP), 1e-7, 1e7)
        on = ~still & (damping < 1e7)
        active, damping = active[on], damping[on]
        cost, gradient, matrix = cost[on], gradient[:, on], matrix[..., on]
        if not active.size:
            break
    return here


def moved(parameters: Array, step: Array) -> Array:
    """Parameters after a step, none further than its longest one, inside the hemisphere and the
    bounds."""
    shorter = np.minimum(1, (MAX_STEPS / np.maximum(np.abs(step), 1e-20)).min(axis=0))
    result = np.clip(parameters + step * shorter, LOWER_LIMITS, UPPER_LIMITS)
    square = result[0] ** 2 + result[1] ** 2
    result[:2] *= np.minimum(1, np.sqrt(STEEPEST / np.maximum(square, 1e-20)))
    return np.asarray(result, dtype=np.float32)


def layered_normals(
    images: FloatArray, lights: Array, inside: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Normals (H, W, 3) and albedo (H, W) of images (L, H, W) under distant lights (L, 3)."""
    normals, albedo = lambertian(images, lights, inside)
    typical = float(np.median(albedo[inside]))
    exposure = np.pi * typical / (BASE_ALBEDO * INDEX**2)
    places = np.flatnonzero(inside)
    flat = images.reshape(len(images), -1)
    towards = normals.reshape(-1, 3)
    bright = albedo.ravel()
    for part in np.array_split(places, max(1, len(places) // PIXELS_AT_A_TIME)):
        faint = np.maximum(bright[part], np.float32(1e-4 * typical))
        parameters = fit(flat[:, part], lights, towards[part].T, faint, exposure)
        towards[part] = directions(parameters[0], parameters[1])[0].T
        bright[part] = faint * np.exp(parameters[2])
    return normals, albedo


def heights(capture: Capture) -> Reconstruction:
    """The surface of a capture, not split, as the preset `ea` reconstructs it by another
    reflectance."""
    settings = PRESETS["ea"]
    photographs = photographs_of(capture, settings.finding())
    white, _ = photographs.white_and_nir(settings, plane_mm=0.0)
    images = np.maximum(white.light.grey, np.float32(0))
    normals, albedo = layered_normals(images, white.rig.light_vectors(), white.inside)
    slopes = gradients_from_normals(normals, white.inside, MAX_SLOPE)
    height_mm = frankot_chellappa(*slopes, white.inside) * white.pitch_mm
    relief = fast_part(height_mm, white)
    facts = {"shape_source": "white", "separation": "none", "heights": "measured"}
    surface = FingerSurface(
        height_mm, relief, height_mm - relief, albedo, normals, whole=True, facts=facts
    )
    result = placed(photographs, surface, settings.top_mm)
    return replace(result, preset="xie", findings=findings_for(photographs, settings))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("capture", type=Path)
    parser.add_argument(
        "--out", type=Path, required=True, help="folder of the result, as of splitknit reconstruct"
    )
    options = parser.parse_args(arguments)
    capture = read_capture(options.capture)
    write_results(heights(capture), capture, options.out)
    print(f"Written to {options.out}.")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
