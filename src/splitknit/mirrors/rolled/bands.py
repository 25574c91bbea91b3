"""Ridges by themselves: a relief without what is smooth in it."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.model import BoolArray, FloatArray


def ridge_band(relief: FloatArray, known: BoolArray, pitch_mm: float, sigma_mm: float = 0.32) -> FloatArray:
    """(n, m) relief less its local mean over `known`, zero elsewhere."""
    weight = known.astype(np.float32)
    filled = np.where(known, relief, np.float32(0.0)).astype(np.float32)
    sigma = sigma_mm / pitch_mm
    mean = cv2.GaussianBlur(filled, (0, 0), sigma) / np.maximum(
        cv2.GaussianBlur(weight, (0, 0), sigma), np.float32(1e-3)
    )
    return np.where(known, filled - mean, np.float32(0.0)).astype(np.float32)


def evened(band: FloatArray, known: BoolArray, pitch_mm: float, sigma_mm: float = 1.0) -> FloatArray:
    """(n, m) ridge band over its local standard deviation."""
    size = sigma_mm / pitch_mm
    share = np.maximum(cv2.GaussianBlur(known.astype(np.float32), (0, 0), size), np.float32(1e-3))
    power = cv2.GaussianBlur(np.where(known, band * band, 0).astype(np.float32), (0, 0), size) / share
    typical = float(np.median(power[known])) if known.any() else 1.0
    return np.asarray(band / np.sqrt(power + np.float32(0.1 * typical + 1e-20)), dtype=np.float32)
