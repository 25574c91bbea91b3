"""Areal surface texture: height parameters of ISO 25178-2."""

from __future__ import annotations

import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray


def areal_roughness(height_mm: FloatArray, pitch_mm: float) -> dict[str, float]:
    """Height and hybrid parameters of a surface: its form is to be removed before, as in a result's relief.

    Raises BadInput if no square of four pixels is known. Source: ISO 25178-2:2021, sections 4.2 (Sq, Sz, Sa) and 4.4
    (Sdr).

    Parameters
    ----------
    height_mm : (H, W), NaN where nothing was measured; its mean is subtracted
    pitch_mm : distance of the pixels

    Returns
    -------
    dict
        ``Sa_um`` (mean absolute height), ``Sq_um`` (root mean square), ``Sz_um`` (highest peak to lowest pit) and
        ``Sdr_percent`` (developed over projected area less one, of the squares whose four corners are known, two
        triangles each).

    Examples
    --------
    >>> wave = 0.01 * np.sin(2 * np.pi * np.arange(200) / 50)
    >>> {name: round(value, 2) for name, value in areal_roughness(np.tile(wave, (9, 1)), 0.01).items()}
    {'Sa_um': 6.36, 'Sq_um': 7.07, 'Sz_um': 19.96, 'Sdr_percent': 0.39}
    """
    known = height_mm[np.isfinite(height_mm)].astype(np.float64)
    a, b, c, d = (height_mm[i : i - 1 or None, j : j - 1 or None] / pitch_mm for i in (0, 1) for j in (0, 1))
    upper = np.sqrt(1.0 + (b - a) ** 2 + (c - a) ** 2)  # twice the areas of the triangles a b c and b c d
    lower = np.sqrt(1.0 + (d - c) ** 2 + (d - b) ** 2)
    area = (0.5 * (upper + lower)).astype(np.float64)
    require(bool(np.isfinite(area).any()), "the surface has no square of four known pixels.")
    known -= known.mean()
    return {
        "Sa_um": float(np.abs(known).mean() * 1e3),
        "Sq_um": float(np.sqrt((known**2).mean()) * 1e3),
        "Sz_um": float(np.ptp(known) * 1e3),
        "Sdr_percent": float(np.nanmean(area) * 100.0 - 100.0),
    }
