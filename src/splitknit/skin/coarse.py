"""The finger's shape from all bands, behind blur and glare, on a coarse grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.integration.poisson import poisson
from splitknit.model import BoolArray, FloatArray
from splitknit.photometric.near_light import pseudo_normals
from splitknit.settings import Checked, Limits
from splitknit.skin.colour import unmixing_weights
from splitknit.skin.diffusion import Diffusion
from splitknit.skin.glare import GlareFit, MicrofacetGlare, fit_glare
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.light import Lighting, lighting, predict, reached_by_all

AnyFloat = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class CoarsePrior(Checked):
    """What is expected of the slopes on the coarse grid."""

    _group = "metric.coarse"
    knee_per_mm: Annotated[float, Limits(0, above=True)] = 5.0
    """Angular frequency (rad/mm) from which the shape's slopes fall off."""
    glare_ratio: Annotated[float, Limits(0)] = 0.16
    """Apparent slope of the glare (in red) over the shape's slopes at low frequencies."""
    noise_ratio: Annotated[float, Limits(0, above=True)] = 0.1
    """Noise of the slopes over the shape's slopes at low frequencies."""
    cutoff_per_mm: Annotated[float, Limits(0, above=True)] = 8.0
    """Angular frequency beyond which slopes are left to the fine grid."""


@dataclass(frozen=True, slots=True, eq=False)
class CoarseStep:
    """Result of one comparison of prediction and images."""

    slope_x: FloatArray
    """(h, w) of all that comparisons have put into the surface."""
    slope_y: FloatArray
    brightness: Mapping[str, float]
    """Diffuse brightness of each channel over the prediction for an albedo of one."""
    glare: Mapping[str, tuple[float, float]]
    """Roughness and strength of the glare by band."""


def unit(normals: FloatArray) -> FloatArray:
    """Unit length, (H, W, 3)."""
    length = np.sqrt((normals * normals).sum(axis=-1, keepdims=True))
    return np.asarray(normals / np.maximum(length, np.float32(1e-9)), dtype=np.float32)


def start_shape(band: BandImages, grid: Grid, plane_mm: float, rounds: int = 2) -> FloatArray:
    """A first shape: near-light photometric stereo of one band, all lights alike, integrated over the mask."""
    height = np.zeros(grid.shape, dtype=np.float32)
    stack = band.stack.sum(axis=0)
    for _ in range(rounds):
        g = pseudo_normals(stack, band.rig, height + np.float32(plane_mm), grid.mask, view=grid.view)
        normals = unit(g)
        nz = np.maximum(normals[..., 2], np.float32(0.15))
        height = integrate(np.asarray(-normals[..., 0] / nz), np.asarray(-normals[..., 1] / nz), grid, nz)
    return height


def slopes_inside(height_mm: FloatArray, grid: Grid) -> tuple[FloatArray, FloatArray]:
    """dz/dx and dz/dy (h, w) of a surface on the grid's mask: no step at its edge, zero outside."""
    x, y = height_gradients(np.where(grid.mask, height_mm, np.float32(np.nan)), grid.pitch_mm)
    return np.nan_to_num(x), np.nan_to_num(y)


def integrate(slope_x: AnyFloat, slope_y: AnyFloat, grid: Grid, weights: FloatArray) -> FloatArray:
    """Height in mm (zero outside the mask, mean zero on it) by weighted masked least squares."""
    height = poisson(slope_x, slope_y, grid.mask, weights=np.clip(weights, 0, 1)) * np.float32(grid.pitch_mm)
    return np.asarray(np.nan_to_num(height, nan=0.0), dtype=np.float32)


def compare(  # noqa: PLR0917
    bands: tuple[BandImages, ...],
    grid: Grid,
    height_mm: FloatArray,
    skin: Mapping[str, Diffusion],
    added: tuple[FloatArray, FloatArray],
    prior: CoarsePrior,
) -> CoarseStep:
    """Predict the images of all bands and correct the slopes.

    As on the fine grid the regularised inverse acts on everything that was measured, z <- W (p - F(z) + M z), so that
    repeating it settles. The ridges need not be known: as much light enters a ridged patch of skin and scatters below
    it as enters a smooth one, because facets that lean away from the light are larger as they are darker.

    Parameters
    ----------
    bands : images on `grid`
    height_mm : (h, w), finite
    skin : transfer function of each channel
    added : slopes (h, w) along x and y that earlier comparisons have put into the surface
    prior : what is expected of shape and glare
    """
    normals = normals_from_gradients(*slopes_inside(height_mm, grid))
    residuals: list[tuple[FloatArray, FloatArray]] = []
    names: list[str] = []
    brightness: dict[str, float] = {}
    glare: dict[str, tuple[float, float]] = {}
    groups: list[list[int]] = []
    transfer = {name: grid.sampled(skin[name]) for band in bands for name in band.channels}
    gloss: GlareFit | None = None
    scale = 1.0
    for band in bands:
        light = lighting(band.rig, grid, height_mm, normals)
        reached = reached_by_all(light, grid)
        expected = predict(light, grid, normals, [transfer[n] for n in band.channels])
        mirrored = MicrofacetGlare(normals, light.vectors)
        dull = _dullest(mirrored(0.3), reached)
        for c, name in enumerate(band.channels):
            brightness[name] = _median_ratio(band.stack[c], expected[c], dull)
            expected[c] *= np.float32(brightness[name])
        if len(band.channels) > 1:
            gloss = _glare_by_colour(band, expected, brightness, reached, light, normals)
            scale = brightness[band.channels[0]] / skin[band.channels[0]].albedo
        elif gloss is None:
            gloss = _glare_by_lights(band, light, reached, normals)
            scale = brightness[band.channels[0]] / skin[band.channels[0]].albedo
        gloss = replace(gloss, strength=min(gloss.strength, MOST_GLARE * float(np.pi) * scale))
        # the same surface mirrors both bands: their glare differs by exposure only, as their diffuse light shows
        strength = gloss.strength * (brightness[band.channels[0]] / skin[band.channels[0]].albedo) / scale
        glare[band.channels[-1]] = (gloss.roughness, strength)
        seen = band.stack - mirrored(gloss.roughness) * np.float32(strength) * grid.mask
        for c, name in enumerate(band.channels):
            correction = _median_ratio(seen[c], expected[c], dull)
            brightness[name] *= correction
            expected[c] *= np.float32(correction)
        both = np.concatenate([seen, expected]).astype(np.float32)
        found = pseudo_normals(both, band.rig, height_mm, grid.mask, light.trust, view=grid.view)
        start = len(names)
        for c, name in enumerate(band.channels):
            residuals.append(lacking_coarse(found[c], found[c + len(band.channels)], grid))
            names.append(name)
        groups.append(list(range(start, len(names))))
    weights = _weights(grid, names, groups, brightness, skin, prior)
    kept = sum(w * transfer[name] for w, name in zip(weights, names, strict=True))
    slope_x, slope_y = (
        grid.inverse(
            kept * grid.forward(added[axis])
            + sum(w * grid.forward(r[axis]) for w, r in zip(weights, residuals, strict=True))
        )
        * grid.mask
        for axis in range(2)
    )
    return CoarseStep(slope_x, slope_y, brightness, glare)


def _dullest(mirrored: FloatArray, region: BoolArray) -> BoolArray:
    """(L, h, w) the third of lights and pixels in `region` that is least glossy, whatever its exact strength."""
    limit = np.quantile(mirrored[:, region], 1 / 3)
    return np.asarray((mirrored <= limit) & region)


def _median_ratio(seen: FloatArray, expected: FloatArray, where: BoolArray) -> float:
    """Median brightness of the images (L, h, w) over the prediction."""
    return float(np.median(seen[where] / np.maximum(expected[where], np.float32(1e-4))))


def lacking_coarse(found: FloatArray, expected: FloatArray, grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Slopes that `found` (h, w, 3) has beyond `expected`, to first order and whatever the local albedo.

    With p the expected slope, -(G_x + p G_z) / D vanishes where G is parallel to the expectation; D is the expected
    z component times the smooth ratio of the two.
    """
    expected_z = np.maximum(expected[..., 2], 0.1 * np.sqrt((expected * expected).sum(axis=-1)) + np.float32(1e-6))
    inside = grid.mask & (expected_z > 0.05 * np.median(expected_z[grid.mask]))
    albedo = grid.smooth(np.maximum(found[..., 2], 0) / expected_z, inside, 0.8)
    scale = np.maximum(albedo * expected_z, np.float32(1e-4))
    slopes = []
    for axis in range(2):
        expected_slope = -expected[..., axis] / expected_z
        value = -(found[..., axis] + expected_slope * found[..., 2]) / scale
        slopes.append(np.where(grid.mask, np.clip(value, -0.6, 0.6), np.float32(0.0)).astype(np.float32))
    return slopes[0], slopes[1]


def _weights(  # noqa: PLR0917
    grid: Grid,
    names: list[str],
    groups: list[list[int]],
    brightness: Mapping[str, float],
    skin: Mapping[str, Diffusion],
    prior: CoarsePrior,
) -> list[FloatArray]:
    """Weights of the channels on the grid's frequencies; each band has a glare of its own."""
    omega = np.linspace(0, float(grid.omega[2].max()), 512)
    transfer = np.stack([skin[name](omega) for name in names])
    reference = brightness[names[0]]
    glare = np.zeros((len(names), len(groups)))
    for g, members in enumerate(groups):
        for c in members:
            glare[c, g] = reference / max(brightness[names[c]], 1e-6)
    signal = 1 / (1 + (omega / prior.knee_per_mm) ** 2) ** 2
    mirrored = np.full(omega.shape, prior.glare_ratio**2)
    weights = unmixing_weights(transfer, glare, signal, mirrored, np.full(len(names), prior.noise_ratio**2))
    weights = weights * np.exp(-0.5 * (omega / prior.cutoff_per_mm) ** 2)
    return [grid.radial(omega, w) for w in weights]


# Glare of a band: told by its colour, or by the lights alone.

MOST_GLARE = 1.0
"""Most glare that is predicted, over that of a clean boundary with the skin's refractive index. What is left over is
told by its colour; what is predicted in excess draws relief that is not there."""
ROUGHNESSES = (0.12, 0.16, 0.20, 0.25, 0.30, 0.36, 0.42)


def _glare_by_colour(  # noqa: PLR0917
    band: BandImages,
    expected: FloatArray,
    brightness: Mapping[str, float],
    reached: BoolArray,
    light: Lighting,
    normals: FloatArray,
) -> GlareFit:
    """Glare of a colour band: what the images have beyond the expectation, and alike in all channels.

    Per pixel and light the excess is split, by least squares over the channels, into a part with the skin's colour (the
    shape is not right yet) and a white part; strength and roughness fit the white part.
    """
    some = _some(reached)
    excess = (band.stack - expected)[:, :, some]
    skin = np.array([brightness[name] for name in band.channels], dtype=np.float32)
    n, sum_b, sum_bb = np.float32(len(skin)), skin.sum(), (skin * skin).sum()
    tinted = np.einsum("c,cln->ln", skin, excess)
    white = (excess.sum(axis=0) * sum_bb - sum_b * tinted) / max(float(n * sum_bb - sum_b * sum_b), 1e-9)
    mirrored = MicrofacetGlare(normals[some], light.vectors[:, :, some])
    best = GlareFit(ROUGHNESSES[0], 0.0, 0.0)
    total = float((white * white).sum(dtype=np.float64))
    for roughness in ROUGHNESSES:
        lobe = mirrored(roughness)
        power = float((lobe * lobe).sum(dtype=np.float64))
        product = max(float((lobe * white).sum(dtype=np.float64)), 0.0)
        if power > 0 and product * product / power > best.explained * total:
            best = GlareFit(roughness, product / power, product * product / power / max(total, 1e-30))
    return best


def _glare_by_lights(band: BandImages, light: Lighting, reached: BoolArray, normals: FloatArray) -> GlareFit:
    """Glare of a grey band: what no matt surface explains."""
    some = _some(reached)
    vectors = light.vectors[:, :, some]
    lit = vectors * light.entering[:, None][:, :, some]
    return fit_glare(band.stack[-1][:, some], lit, MicrofacetGlare(normals[some], vectors), ROUGHNESSES)


def _some(region: BoolArray) -> BoolArray:
    """Every other row of a large region."""
    if int(region.sum()) < 8000:
        return region
    chosen = region.copy()
    chosen[::2] = False
    return chosen
