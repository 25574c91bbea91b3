"""Skin that is dry or scarred: what becomes of its relief, its pigment and its roughness, on the map of the skin."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.simulator.master_print import MasterPrint
from splitknit.simulator.orientation_field import smooth_noise

Array = NDArray[np.float64]

KERATIN = 1.55
"""Refractive index of the dry horny layer (Duck 1990, Physical Properties of Tissue)."""
MOST_PLATES = 4
"""Horny plates with air between them in the thickest scale."""


@dataclass(frozen=True, slots=True, eq=False)
class Weathered:
    """Skin after what happened to it, on the master print's grid."""

    displacement: Array
    """(H, W) mm."""
    share: Array
    """(H, W) 0 to 1: how far a place is affected (in a scar; under a scale)."""
    reflectance: Array | None = None
    """(H, W) diffuse white reflectance of the scales."""


def scale_reflectance(plates: Array, index: float = KERATIN) -> Array:
    """Reflectance of a pile of transparent plates with air between them, light falling straight on.

    References
    ----------
    Stokes 1862, On the intensity of the light reflected from or transmitted through a pile of plates.
    """
    one = ((index - 1.0) / (index + 1.0)) ** 2
    return np.asarray(2.0 * plates * one / (1.0 + (2.0 * plates - 1.0) * one))


def ridge_angle(ridge: NDArray[np.float32], sigma_px: float) -> Array:
    """(H, W) direction of the ridges from u towards v, rad, from the gradient's structure tensor."""
    smooth = cv2.GaussianBlur(ridge, (0, 0), 1.0)
    du = cv2.Sobel(smooth, cv2.CV_64F, 1, 0, scale=0.125)
    dv = -cv2.Sobel(smooth, cv2.CV_64F, 0, 1, scale=0.125)
    uu, vv, uv = (cv2.GaussianBlur(part, (0, 0), sigma_px) for part in (du * du, dv * dv, du * dv))
    return np.asarray(0.5 * np.arctan2(2.0 * uv, uu - vv) + 0.5 * np.pi, dtype=np.float64)


def dried(displacement: Array, master: MasterPrint, severity: float, rng: np.random.Generator) -> Weathered:
    """Lower the ridges, break them, roughen them and let scales come off.

    At severity 1 ridges have shrunk by a quarter (sessions of a population: by 12 % at the dry end), 0.5 fissures a
    square millimetre run across them (0.5 to 1.6 mm long, 25 to 70 um deep), the skin is rough by 5 um, and scales
    (one to four plates) stand 8 um above a third of the ridges. These are our choices; what they rest on: dry skin's
    horny layer comes off in clumps with air below, which reflect white light diffusely (Velthuizen et al. 2008), and
    skin is rougher the drier it is (Dabrowska et al. 2016).
    """
    pitch = float(master.u_mm[1] - master.u_mm[0])
    smooth = cv2.GaussianBlur(displacement, (0, 0), 0.32 / pitch)
    relief = displacement - smooth
    calm = np.exp(-((np.minimum(smooth + 0.12, 0.0) / 0.1) ** 2))  # creases stay as they are
    new = smooth + relief * (1.0 - 0.25 * severity * calm)
    new = new + 1e-3 * 5.0 * severity * smooth_noise(rng, displacement.shape, 0.06 / pitch)
    angle = ridge_angle(master.ridge, 0.5 / pitch)
    new = new - severity * _fissures(rng, angle, master, pitch, 0.5 * severity)
    lumps = smooth_noise(rng, displacement.shape, 0.22 / pitch)
    coarse = smooth_noise(rng, displacement.shape, 1.5 / pitch)
    field = (lumps + 0.5 * coarse) / np.sqrt(1.25)
    threshold = float(np.quantile(field, 1.0 - 0.45 * severity))
    scale = np.clip((field - threshold) / 0.12, 0.0, 1.0) * (master.ridge > 0.35)
    scale = cv2.GaussianBlur(scale, (0, 0), 0.6)
    plates = scale * np.clip(1.0 + 1.5 * (field - threshold), 1.0, MOST_PLATES)
    edge = np.abs(scale * (1.0 - scale)) * 4.0
    new = new + 1e-3 * (8.0 * scale + 6.0 * edge) * calm
    return Weathered(new, scale, scale_reflectance(plates))


def _fissures(rng: np.random.Generator, angle: Array, master: MasterPrint, pitch: float, per_mm2: float) -> Array:
    """(H, W) depth of short cracks across the ridges, mm."""
    rows, columns = angle.shape
    count = int(rng.poisson(per_mm2 * rows * columns * pitch * pitch))
    canvas = np.zeros(angle.shape)
    place = rng.random((2, count)) * np.array([[rows - 1], [columns - 1]])
    length = rng.uniform(0.5, 1.6, count) / pitch
    turn = rng.normal(0.0, np.deg2rad(20.0), count) + 0.5 * np.pi
    width = rng.uniform(0.025, 0.05, count) / pitch
    depth = 1e-3 * rng.uniform(25.0, 70.0, count)
    for k in range(count):
        row, column = place[:, k]
        way = angle[int(row), int(column)] + turn[k]
        reach = int(0.5 * length[k] + 3.0 * width[k]) + 1
        top, left = max(int(row) - reach, 0), max(int(column) - reach, 0)
        bottom, right = min(int(row) + reach + 1, rows), min(int(column) + reach + 1, columns)
        dv = row - np.arange(top, bottom)[:, None]
        du = np.arange(left, right)[None, :] - column
        along = du * np.cos(way) + dv * np.sin(way)
        across = -du * np.sin(way) + dv * np.cos(way)
        taper = np.clip(1.0 - (2.0 * along / length[k]) ** 2, 0.0, 1.0)
        patch = canvas[top:bottom, left:right]
        np.maximum(patch, depth[k] * taper * np.exp(-0.5 * (across / max(width[k], 0.7)) ** 2), out=patch)
    return canvas


def scarred(displacement: Array, master: MasterPrint, severity: float, rng: np.random.Generator) -> Weathered:
    """Draw up to three scars across the pad: strips without ridges or pores, sunken or raised, with soft edges.

    At severity 1 there are three, about 1.1 mm wide (0.1 mm at severity 0: a healed scratch), 6 to 14 mm long; three in
    four are sunken by up to 60 um, the others raised as much. Skin does not grow ridges again where the dermis was cut
    (Maceo 2011, in The Fingerprint Sourcebook, chapter 2). Ridges that were sewn together out of line are not modelled.
    """
    pitch = float(master.u_mm[1] - master.u_mm[0])
    u, v = master.u_mm[None, :], master.v_mm[:, None]
    share = np.zeros(displacement.shape)
    lift = np.zeros(displacement.shape)
    places = rng.permutation(3)
    for number in range(3):
        cu, cv = rng.uniform(-4.0, 4.0), 8.0 + 4.0 * places[number] + rng.uniform(0.0, 3.0)
        way, bend = rng.uniform(0.0, np.pi), rng.uniform(-0.03, 0.03)
        half_mm, length = (0.05 + 0.5 * severity) * rng.uniform(0.7, 1.3), rng.uniform(6.0, 14.0)
        rise = 1e-3 * severity * rng.uniform(20.0, 60.0) * (1.0 if rng.random() < 0.25 else -1.0)
        wave = rng.uniform(0.0, 2.0 * np.pi)
        if number >= np.ceil(3.0 * severity):
            continue
        along = (u - cu) * np.cos(way) + (v - cv) * np.sin(way)
        across = -(u - cu) * np.sin(way) + (v - cv) * np.cos(way)
        across = across - bend * along**2 - 0.15 * np.sin(1.3 * along + wave)
        half = half_mm * np.clip(1.0 - (2.0 * along / length) ** 4, 0.0, 1.0)
        inside = np.clip(0.5 + (half - np.abs(across)) / 0.12, 0.0, 1.0) * (half > 0.0)
        share = np.maximum(share, inside * inside * (3.0 - 2.0 * inside))
        lift = lift + rise * np.exp(-0.5 * (across / max(half_mm, 0.1)) ** 2) * (half > 0.0) * np.clip(
            half / half_mm, 0, 1
        )
    level = cv2.GaussianBlur(displacement, (0, 0), 0.5 / pitch)
    smooth = cv2.GaussianBlur(lift, (0, 0), 0.1 / pitch)
    return Weathered((1.0 - share) * displacement + share * level + smooth, share)
