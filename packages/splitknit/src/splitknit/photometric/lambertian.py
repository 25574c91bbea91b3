"""The thesis's photometric stereo: least squares over all lights, the same for every pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

from splitknit.checks import check_lights, check_mask, check_stack
from splitknit.imaging.chunks import gather
from splitknit.model import FloatArray
from splitknit.photometric.equations import surface_by_chunks


def lambertian(stack: Any, lights: Any, mask: Any = None) -> tuple[FloatArray, FloatArray]:
    """Normals and albedo of a matt surface under distant lights, by least squares over all images.

    Shadows and highlights are taken for shading; :func:`splitknit.photometric.robust` leaves them
    out.

    Parameters
    ----------
    stack : (L, H, W) float32
        Linear light, one image a light; three at least.
    lights : (L, 3)
        Directions towards the lights (x right, y up, z to the camera); the length is the relative
        strength.
    mask : (H, W) bool, optional
        The surface; everything by default.

    Returns
    -------
    normals : (H, W, 3) float32
        Unit vectors; zero outside the mask, (0, 0, 1) where all images are black.
    albedo : (H, W) float32
        In units of the images at a light of strength one; NaN outside the mask.

    Raises
    ------
    BadInput
        If shapes or numbers disagree, values are not finite, or the lights are fewer than three,
        duplicate or coplanar.

    References
    ----------
    R. J. Woodham, "Photometric method for determining surface orientation from multiple images",
    Optical Engineering 19 (1980); the thesis, section 3.2.3.

    Examples
    --------
    >>> import numpy as np
    >>> lights = np.array([[0.0, 0.6, 0.8], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    >>> stack = np.tile((0.5 * lights @ [0.0, 0.0, 1.0])[:, None, None], (1, 2, 2))
    >>> normals, albedo = lambertian(stack, lights)
    >>> np.round(normals[0, 0], 3).tolist(), round(float(albedo[0, 0]), 3)
    ([0.0, 0.0, 1.0], 0.5)
    """
    images = check_stack(stack, least=3)
    count, rows, columns = images.shape
    vectors = check_lights(lights, count)
    inside = check_mask(mask, (rows, columns))
    inverse = np.linalg.pinv(vectors).astype(np.float32)  # (3, L)
    return surface_by_chunks(
        inside,
        count,
        lambda chunk, here: np.einsum("ik,kn->in", inverse, gather(images, chunk, here)),
    )
