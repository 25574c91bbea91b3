"""The two-layer fit on fingers that the two-layer model itself has painted: is what can be known recovered?"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from xie_skin import Skin, layers, paint
from xie_ways import SHIPPED, error_deg

from splitknit.photometric.hanrahan_krueger import hanrahan_krueger
from splitknit.photometric.hanrahan_krueger_fit import HanrahanKruegerSettings, Pixels, SkinLayers
from splitknit.photometric.lambertian import lambertian
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import lay_down

SKINS = {
    "skin of the book": Skin(),
    "thin and dark": Skin(base=0.05, depth=0.02 * 53.8),
}
"""In the first the layers give 1 % of the light and are too thick to be seen through; in the second 8 %."""
NOISES = (0.0, 0.002, 0.01)
"""Relative to the median image."""


def on_itself(seed: int, scale: float) -> list[dict[str, Any]]:
    """One row a skin and noise: errors of both models, and what the noise allows."""
    surface, drawn = lay_down(seed, settings=TwinSettings(scale=scale))
    lights = drawn.rig.select(tuple((k,) for k in range(7))).light_vectors()
    mask, normals = surface.mask, surface.normals.astype(np.float64)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1, 2), slice(columns[0], columns[-1] + 1, 2)
    mask, normals = mask[window], normals[window]
    normals = np.where(mask[..., None], normals, [0.0, 0.0, 1.0])
    found = []
    for name, skin in SKINS.items():
        rng = np.random.default_rng([seed, 0x42])
        fraction, depth = layers(skin, mask.shape, drawn.rig.camera.px_per_mm / 2, rng)
        clean = paint(normals, lights, skin, fraction, depth)
        level = float(np.median(clean[:, mask]))
        for noise in NOISES:
            noisy = clean + rng.normal(0, 1, clean.shape) * (noise * level)
            stack = (0.4 / level * np.maximum(noisy, 0)).astype(np.float32)
            plain, albedo = lambertian(stack, lights, mask)
            settings = _settings(skin, max(noise, 1e-3), float(np.median(albedo[mask])) * level / 0.4)
            got, _, fit = hanrahan_krueger(stack, lights, mask, settings)
            error = error_deg(got, normals)[mask]
            row = {
                "skin": name, "noise": noise,
                "lambertian_deg": float(error_deg(plain, normals)[mask].mean()),
                "layers_deg": float(error.mean()), "layers_rms_deg": float(np.sqrt((error**2).mean())),
                "converged": float(fit.converged[mask].mean()),
            }  # fmt: skip
            for key, true, seen in (
                ("share", _logit(fraction), _logit(fit.fraction)),
                ("depth", np.log(depth), np.log(fit.depth)),
            ):
                row[f"{key}_correlation"] = float(np.corrcoef(true[mask], seen[mask])[0, 1])
                row[f"{key}_error"] = float(np.sqrt(np.mean((true - seen)[mask] ** 2)))
                row[f"{key}_spread"] = float(np.std(true[mask]))
            if noise > 0:
                row["allowed_rms_deg"] = _allowed(
                    np.where(mask[..., None], normals, 0), lights, settings, (fraction, depth), albedo
                )
            found.append(row)
    return found


def _settings(skin: Skin, noise: float, albedo: float) -> HanrahanKruegerSettings:
    """Those of the skin itself. The images' scale is that of the median Lambertian albedo, which surface and layers
    have a part in: the base reflectance is given in its units."""
    rate = 53.8
    book = SkinLayers(
        refractive_index=skin.index, epidermis_asymmetry=skin.upper_g, dermis_asymmetry=skin.lower_g,
        epidermis_scattering_per_mm=rate * skin.fraction, epidermis_absorption_per_mm=rate * (1 - skin.fraction),
        epidermis_thickness_mm=skin.depth / rate,
    )  # fmt: skip
    return replace(
        SHIPPED, layers=book, base_reflectance=albedo, noise=noise, weights="equal", spread_share=skin.share_spread,
        spread_depth=skin.depth_spread,
    )  # fmt: skip


def _logit(fraction: Any) -> Any:
    return np.log(fraction / (1 - fraction))


def _allowed(normals: Any, lights: Any, settings: Any, layered: Any, albedo: Any) -> float:
    """Root mean square angle that the noise and the spread of the layers leave, to first order (Cramer and Rao)."""
    mask = normals[..., 2] > 0
    lit = mask & ((normals @ lights.T).min(axis=-1) > 0)
    n, (fraction, depth) = normals[lit].T, (field[lit] for field in layered)
    strength = np.linalg.norm(lights, axis=1, keepdims=True)
    bright = albedo[lit].astype(np.float64)
    exposure = (
        np.pi * float(np.median(albedo[mask])) / (settings.base_reflectance * settings.layers.refractive_index**2)
    )
    # the noise is the same everywhere, in units of the median image
    sigma = settings.noise * 0.4
    pixels = Pixels(
        np.zeros((len(lights), n.shape[1])), np.full((len(lights), n.shape[1]), 1 / sigma),
        (lights / strength)[..., None], strength, bright, exposure, settings,
    )  # fmt: skip
    theta = np.stack([n[0] / (1 + n[2]), n[1] / (1 + n[2]), np.zeros(n.shape[1]), _logit(fraction), np.log(depth)])
    moments = pixels.equations(theta).moments
    matrix = np.empty((n.shape[1], 5, 5))
    for k, (i, j) in enumerate(zip(*np.triu_indices(5), strict=True)):
        matrix[:, i, j] = matrix[:, j, i] = moments[k]
    covariance = np.linalg.inv(matrix)
    angle = (1 + n[2]) ** 2 * (covariance[:, 0, 0] + covariance[:, 1, 1])
    return float(np.rad2deg(np.sqrt(angle.mean())))
