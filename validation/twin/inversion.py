"""Is the inversion of the skin's blur right on light that the fast twin had no part in?

    python validation/twin/inversion.py            # renders and measures; some minutes of one core
    python validation/twin/inversion.py --smoke    # one tiny crop

Ridged crops under the seven white LEDs are rendered by the reference (diffuse boundary) and kept, with their height,
in ``validation/out/twin/inversion``. Each channel then goes the simple route: near-light photometric stereo with known
lights, slopes divided by the transfer function of :mod:`splitknit.skin.diffusion`, integration; the ridge band is
compared with the truth, for the reference's light without and with glare and, to find the error of the method itself,
for the fast twin's. Results go to ``validation/twin/inversion.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import cv2
import numpy as np
import scipy.fft
from compare import Array, binned
from patches import PITCH_MM, middle, ridged_patch
from reference import ReferenceSettings, reference_scene, render_glare, render_volume
from run import HERE, OUT, source_hash

from splitknit.errors import BadInput
from splitknit.model import default_rig
from splitknit.skin.diffusion import diffusion
from splitknit_simulator.light.renderer import render_band
from splitknit_simulator.light.skin import Channel, Medium, SkinOptics

CHANNELS: tuple[Channel, ...] = ("red", "green", "blue")
REGULARISED = 0.05
"""Added in squares to the transfer function: what it passes less of is not brought back."""
EDGE_MM = 0.33
BAND_MM = 0.32
PIXEL_MM = 2 * PITCH_MM


@dataclass(frozen=True, slots=True)
class Crop:
    """What one crop is of."""

    depth_um: float = 60.0
    factor: float = 1.0
    side_px: int = 128
    radius_mm: float | None = None
    samples: int = 64

    def name(self) -> str:
        shape = "flat" if self.radius_mm is None else f"r{self.radius_mm:g}"
        return f"{self.depth_um:g}um-x{self.factor:g}-{shape}-{self.side_px}px-{self.samples}"


def rendered(crop: Crop, folder: Path) -> dict[str, Array]:
    """Volume light (3, 7, h, w), its standard error, glare (7, h, w) and true height in mm; rendered once."""
    path = folder / f"{crop.name()}.npz"
    if not path.exists():
        rig = default_rig()
        field_mm = crop.side_px * PIXEL_MM + 8.2
        surface = ridged_patch(crop.depth_um, field_mm, radius_mm=crop.radius_mm)
        window = middle(surface, 2 * crop.side_px)
        settings = ReferenceSettings(samples=crop.samples, seed=4)
        scene = reference_scene(surface, window, rig.leds[:7], settings)
        skin = SkinOptics(scattering_factor=crop.factor)
        images = [render_volume(scene, skin.channel(name), settings) for name in CHANNELS]
        glare = render_glare(scene, skin.roughness, settings, samples=64)
        partial = path.with_suffix(".part.npz")
        np.savez_compressed(
            partial,
            radiance=np.stack([one.radiance for one in images]),
            standard_error=np.stack([one.standard_error for one in images]), glare=glare.radiance,
            height_mm=binned(surface.height_mm[window]).astype(np.float32),
            shape_mm=binned(surface.shape_mm[window]).astype(np.float32),
            relief_um=binned(surface.relief_um[window]).astype(np.float32),
        )  # fmt: skip
        partial.replace(path)
    with np.load(path) as data:
        return {name: data[name].astype(np.float64) for name in data.files}


def painted(crop: Crop, folder: Path) -> Array:
    """The fast twin's volume light of the same crop, (3, 7, h, w)."""
    path = folder / f"{crop.name()}-twin.npz"
    if not path.exists():
        surface = ridged_patch(crop.depth_um, crop.side_px * PIXEL_MM + 8.2, radius_mm=crop.radius_mm)
        skin = SkinOptics(scattering_factor=crop.factor)
        media = [skin.channel(name) for name in CHANNELS]
        leds = default_rig().leds[:7]
        light = render_band(surface, leds, Medium(media, skin.roughness, 1.0))
        window = middle(surface, 2 * crop.side_px)
        partial = path.with_suffix(".part.npz")
        np.savez_compressed(
            partial,
            diffuse=np.moveaxis(binned(light.diffuse[(..., *window)]), 1, 0).astype(np.float32),
            glare=binned(light.glare[(slice(None), *window)]).astype(np.float32),
        )
        partial.replace(path)
    with np.load(path) as data:
        return np.asarray(data["diffuse"], dtype=np.float64)


def slopes(images: Array) -> tuple[Array, Array, Array]:
    """Slopes dz/dx, dz/dy (y up) and brightness by least squares with the known LEDs, on the plane z = 0."""
    rows, columns = images.shape[1:]
    x = (np.arange(columns) - (columns - 1) / 2) * PIXEL_MM
    y = ((rows - 1) / 2 - np.arange(rows)) * PIXEL_MM
    points = np.stack([*np.meshgrid(x, y), np.zeros((rows, columns))], axis=-1)
    leds = np.array([led.position_mm for led in default_rig().leds[:7]], dtype=np.float64)
    way = leds - points[:, :, None, :]
    light = 1e4 * way / np.linalg.norm(way, axis=-1, keepdims=True) ** 3
    b = np.einsum("hwkl,lhw->hwk", np.linalg.pinv(light), images)
    return -b[..., 0] / b[..., 2], -b[..., 1] / b[..., 2], b[..., 2]


def integrated(fields: Sequence[tuple[Array, Array]], transfers: Sequence[Any]) -> Array:
    """Height in mm whose slopes, blurred by each channel's transfer function, fit the channels' slopes best.

    Fields are mirrored, so that nothing wraps around; a transfer of None leaves the blur in.
    """
    rows, columns = fields[0][0].shape
    wy = -2 * np.pi * scipy.fft.fftfreq(2 * rows, PIXEL_MM)[:, None]
    wx = 2 * np.pi * scipy.fft.rfftfreq(2 * columns, PIXEL_MM)[None, :]
    omega = np.hypot(wx, wy)
    above, below = np.zeros(omega.shape, dtype=np.complex128), np.zeros(omega.shape)
    for (p, q), transfer in zip(fields, transfers, strict=True):
        gain = np.ones_like(omega) if transfer is None else transfer(omega)
        p_all = np.block([[p, -p[:, ::-1]], [p[::-1], -p[::-1, ::-1]]])
        q_all = np.block([[q, q[:, ::-1]], [-q[::-1], -q[::-1, ::-1]]])
        along = -1j * (wx * scipy.fft.rfft2(p_all) + wy * scipy.fft.rfft2(q_all))
        above += gain * along / np.maximum(omega**2, 1e-9)
        below += gain**2
    spectrum = above / (below + (0.0 if transfers[0] is None else REGULARISED**2))
    spectrum[0, 0] = 0.0
    return np.asarray(scipy.fft.irfft2(spectrum, (2 * rows, 2 * columns))[:rows, :columns])


def ridge_band(height: Array) -> Array:
    """Height without its Gaussian mean."""
    return height - cv2.GaussianBlur(height, (0, 0), BAND_MM / PIXEL_MM, borderType=cv2.BORDER_REFLECT)


def likeness(estimate_mm: Array, truth_mm: Array) -> dict[str, float]:
    """Correlation, gain and rms (um) of the ridge band away from the crop's edge."""
    edge = int(np.ceil(EDGE_MM / PIXEL_MM))
    inner = (slice(edge, -edge), slice(edge, -edge))
    found, true = (1e3 * ridge_band(one)[inner] for one in (estimate_mm, truth_mm))
    found, true = found - found.mean(), true - true.mean()
    return {
        "correlation": float((found * true).sum() / np.sqrt((found**2).sum() * (true**2).sum())),
        "gain": float((found * true).sum() / (true**2).sum()),
        "rms_um": float(np.sqrt(((found - true) ** 2).mean())),
        "truth_um": float(true.std()),
    }


def measured(crop: Crop, data: dict[str, Array], assumed: float) -> dict[str, Any]:
    """All ways of one crop; `assumed` is the scattering factor that the inversion takes for true."""
    skin = SkinOptics(scattering_factor=crop.factor)
    result: dict[str, Any] = {
        "depth_um": crop.depth_um, "factor": crop.factor, "assumed_factor": assumed, "radius_mm": crop.radius_mm,
        "noise_of_a_pixel": float((data["standard_error"] / data["radiance"]).mean()),
    }  # fmt: skip
    truth = data["height_mm"]
    for kind, light, glare in (
        ("volume", "radiance", 0.0),
        ("with_glare", "radiance", data["glare"]),
        ("twin", "twin", 0.0),
    ):
        if light not in data:
            continue
        fields, transfers, row = [], [], {}
        for index, name in enumerate(CHANNELS):
            p, q, bright = slopes(data[light][index] + glare)
            optics = skin.channel(name)
            transfer = diffusion(optics.scattering_per_mm * assumed / crop.factor, optics.absorption_per_mm)
            fields.append((p, q))
            transfers.append(transfer)
            row[name] = likeness(integrated([(p, q)], [transfer]), truth)
            row[name + "_blurred"] = likeness(integrated([(p, q)], [None]), truth)
            level = cv2.GaussianBlur(bright, (0, 0), BAND_MM / PIXEL_MM, borderType=cv2.BORDER_REFLECT)
            by_brightness = 1e-3 * (bright / level - 1.0) / optics.relief_gain_per_um
            row[name + "_brightness"] = likeness(by_brightness, truth)
        row["all"] = likeness(integrated(fields, transfers), truth)
        result[kind] = row
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="The inversion of the skin's blur on the reference's light.")
    parser.add_argument("--smoke", action="store_true", help="one tiny crop")
    options = parser.parse_args(arguments)
    folder = OUT / "inversion" / source_hash()[:12]
    folder.mkdir(parents=True, exist_ok=True)
    crops = [Crop(depth, factor) for factor in (1.0, 0.7, 1.4) for depth in (60.0, 90.0)]
    curved = [Crop(60.0, side_px=192, radius_mm=8.0, samples=96)]
    if options.smoke:
        crops, curved = [Crop(side_px=48, samples=16)], []
    rows = []
    try:
        for crop in crops:
            print(crop.name(), flush=True)
            data = rendered(crop, folder)
            if crop.factor == 1.0:
                data["twin"] = painted(crop, folder)
            for assumed in dict.fromkeys((crop.factor, 1.0)):
                rows.append(measured(crop, data, assumed))
        for crop in curved:  # for chain.py
            print(crop.name(), flush=True)
            rendered(crop, folder)
            painted(crop, folder)
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    out = OUT / "inversion-smoke.json" if options.smoke else HERE / "inversion.json"
    out.write_text(json.dumps({"source_sha256": source_hash(), "crops": rows}, indent=1, default=float) + "\n")
    print(f"wrote {out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
