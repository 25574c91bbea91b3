"""Glare of a band: told by its colour, or by the lights alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from splitknit.model import BoolArray, FloatArray
from splitknit.skin.bands import BandImages
from splitknit.skin.facets import Facets, at, mean_glare
from splitknit.skin.glare import GlareFit, fit_glare
from splitknit.skin.light import Lighting

MOST_GLARE = 1.0
"""Most glare that is predicted, over that of a clean boundary with the skin's refractive index. What is left over is
told by its colour; what is predicted in excess draws relief that is not there."""
ROUGHNESSES = (0.12, 0.16, 0.20, 0.25, 0.30, 0.36, 0.42)


def glare_by_colour(  # noqa: PLR0917
    band: BandImages,
    expected: FloatArray,
    brightness: Mapping[str, float],
    reached: BoolArray,
    light: Lighting,
    normals: FloatArray,
    facets: Facets | None,
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
    vectors = light.vectors[:, :, some][:, :, None]
    there = at(facets, some)
    best = GlareFit(ROUGHNESSES[0], 0.0, 0.0)
    total = float((white * white).sum(dtype=np.float64))
    for roughness in ROUGHNESSES:
        lobe = mean_glare(normals[some][None], there, vectors, roughness)[:, 0]
        power = float((lobe * lobe).sum(dtype=np.float64))
        product = max(float((lobe * white).sum(dtype=np.float64)), 0.0)
        if power > 0 and product * product / power > best.explained * total:
            best = GlareFit(roughness, product / power, product * product / power / max(total, 1e-30))
    return best


def glare_by_lights(
    band: BandImages, light: Lighting, reached: BoolArray, normals: FloatArray, facets: Facets | None
) -> GlareFit:
    """Glare of a grey band: what no matt surface explains."""
    some = _some(reached)
    vectors = light.vectors[:, :, some]
    there = at(facets, some)

    def model(roughness: float) -> FloatArray:
        return mean_glare(normals[some][None], there, vectors[:, :, None], roughness)[:, 0]

    lit = vectors * light.entering[:, None][:, :, some]
    return fit_glare(band.stack[-1][:, some], lit, model, ROUGHNESSES)


def _some(region: BoolArray) -> BoolArray:
    """Every other row of a large region."""
    if int(region.sum()) < 8000:
        return region
    chosen = region.copy()
    chosen[::2] = False
    return chosen
