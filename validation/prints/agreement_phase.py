"""Minutiae of a print as the points about which the phase of its ridges turns: what the print
holds, not what an extractor makes of it.

The truth's minutiae are defined so, on the noise-free master; here the same is asked of the print
alone (its own directions, its own Gabor-filtered wave). Nothing of the truth enters.

References
----------
K. Larkin and P. Fletcher, "A coherent framework for fingerprint analysis", Optics Express 15, 2007.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit_match.prints.enhance import Enhanced
from splitknit_match.records.minutiae_record import Minutiae
from splitknit_simulator.finger.ridges import phase_singularities


def phase_minutiae(image: NDArray[np.uint8], enhanced: Enhanced) -> Minutiae:
    """Minutiae of a print (h, w) whose enhanced form is at hand; their quality (0 to 100) is how
    well both agree around them."""
    wave = -enhanced.wave
    singular = phase_singularities(wave, ridge_angles(enhanced))
    place = np.rint(singular[:, :2]).astype(np.int32)
    there = enhanced.mask[place[:, 1], place[:, 0]]
    singular, place = singular[there], place[there]
    quality = np.round(100 * np.clip(likeness(image, wave)[place[:, 1], place[:, 0]], 0, 1)).astype(
        np.uint8
    )
    kind = np.zeros(len(place), dtype=np.uint8)
    return Minutiae(
        place[:, 0], place[:, 1], singular[:, 2] % (2 * np.pi), kind, quality, image.shape
    )


def ridge_angles(enhanced: Enhanced) -> NDArray[np.float64]:
    """(h, w) direction of the ridges, counter-clockwise, from the nodes of the field."""
    field, (rows, columns) = enhanced.field, enhanced.wave.shape
    size = field.mask.shape[1] * field.step_px, field.mask.shape[0] * field.step_px
    double = [np.cos(2 * field.orientation_rad), np.sin(2 * field.orientation_rad)]
    cosine, sine = (
        cv2.resize(part, size, interpolation=cv2.INTER_CUBIC)[:rows, :columns] for part in double
    )
    return 0.5 * np.arctan2(sine, cosine).astype(np.float64)


def likeness(
    image: NDArray[np.uint8], wave: NDArray[np.float32], sigma_px: float = 4.0
) -> NDArray[np.float32]:
    """(h, w) local correlation of a print with the wave made of it."""
    grey = 127.0 - cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    both, of_wave, of_print = (
        cv2.GaussianBlur(p, (0, 0), sigma_px) for p in (wave * grey, wave * wave, grey * grey)
    )
    return np.asarray(both / np.sqrt(of_wave * of_print + 1e-6), dtype=np.float32)
