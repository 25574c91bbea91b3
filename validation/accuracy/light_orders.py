"""Lights of a gel's photographs, which have no list: tests/external checks orders and frames of
lights on them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from splitknit.io.images import read_image
from splitknit.model import FloatArray


def lights_of_balls(data: Path) -> FloatArray:
    """Light vectors of the gel's six lights, by least squares on the tops of the balls whose
    outlines are listed."""
    text = (data / "elastomer" / "BGA-001" / "scan.yaml").read_text()
    files = [data / "elastomer" / "BGA-001" / f"image{k:02d}.png" for k in range(7, 13)]
    stack = np.stack([read_image(file)[..., 0] for file in files]).astype(np.float64)
    normals, light = [], []
    for ball in re.findall(r"r: ([\d.]+)\s+x: ([\d.-]+)\s+y: ([\d.-]+)", text):
        radius, column, row = (float(value) for value in ball)
        reach = int(0.6 * radius)
        x0 = round(column)
        y0 = round(row)
        if min(x0, y0) < reach or x0 + reach >= stack.shape[2] or y0 + reach >= stack.shape[1]:
            continue
        down, across = np.mgrid[-reach : reach + 1, -reach : reach + 1] / radius
        top = across**2 + down**2 < 0.36
        up = np.sqrt(np.maximum(1.0 - across**2 - down**2, 0.0))
        normals.append(np.stack([across, -down, up], axis=-1)[top])
        light.append(stack[:, y0 - reach : y0 + reach + 1, x0 - reach : x0 + reach + 1][:, top].T)
    return np.linalg.lstsq(np.concatenate(normals), np.concatenate(light), rcond=None)[0].T / 255.0
