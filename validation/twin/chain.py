"""The whole chain of `metric` on the reference's light: shape, glare, blur and relief of a curved crop.

    python validation/twin/chain.py        # after inversion.py, which renders the crops

The crops (5 mm of a cylinder of 8 mm radius) have no outline and no near-infrared band. The reference's volume light is
noisier than a camera's, so what varies faster than 5 cycles/mm is taken out of it (skin passes hardly any of that);
glare is added as it is. `drift` moves each LED's volume light away from that LED, as light that is refracted into skin
does (docs/experiments/simulator-reference.md); the diffuse boundary has none. Results go to
``validation/twin/chain.json``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft
from inversion import CHANNELS, PIXEL_MM, likeness
from measure import drift_mm, lights
from scipy import ndimage

from splitknit.methods.metric import metric_skin
from splitknit.model import default_rig
from splitknit.skin.diffusion import SkinSettings as AssumedSkin
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.images import MetricSettings
from splitknit_simulator.light.skin import SkinOptics

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out" / "twin"
CUT_PER_MM = 5.0


def main() -> int:
    """Reconstruct every curved crop that has been rendered."""
    rows: list[dict[str, Any]] = []
    for path in sorted((OUT / "inversion").glob("*/*-r8-*.npz")):
        if path.stem.endswith(("-twin", ".part")):
            continue
        with np.load(path) as data:
            crop = {name: data[name].astype(np.float64) for name in data.files}
        with np.load(path.with_name(path.stem + "-twin.npz")) as data:
            painted = {name: data[name].astype(np.float64) for name in data.files}
        volume = np.stack([[low_pass(one) for one in channel] for channel in crop["radiance"]])
        for way in ("colour", "network"):
            networks = load(way)
            if way == "network" and networks is None:
                continue
            for name, light, gloss, drift in (
                ("reference, volume", volume, 0.0, 0.0),
                ("reference", volume, crop["glare"], 0.0),
                ("reference, drift 0.5", volume, crop["glare"], 0.5),
                ("reference, drift 1", volume, crop["glare"], 1.0),
                ("twin", painted["diffuse"], painted["glare"], 0.0),
            ):
                images = drifted(light, drift) + gloss
                found = reconstructed(images, way, networks)
                row = {"crop": path.stem, "way": way, "light": name, **likeness(found, crop["height_mm"])}
                print({k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()}, flush=True)
                rows.append(row)
    (HERE / "chain.json").write_text(json.dumps(rows, indent=1, default=float) + "\n")
    return 0


def load(way: str) -> Any:
    """The package's networks, or None where there are none or their runtime is missing."""
    if way == "colour":
        return None
    try:
        from splitknit.presets import PRESETS
        from splitknit.skin.images import shipped_networks

        return shipped_networks(PRESETS["metric"].metric)
    except (ImportError, ValueError, FileNotFoundError) as error:
        print("no networks:", error)
        return None


def reconstructed(images: Any, way: str, networks: Any) -> Any:
    """Height in mm of a crop (3, 7, h, w) that skin fills."""
    rows, columns = images.shape[-2:]
    x = (np.arange(columns) - (columns - 1) / 2) * PIXEL_MM
    y = ((rows - 1) / 2 - np.arange(rows)) * PIXEL_MM
    grid = Grid(np.ones((rows, columns), dtype=np.bool_), x, y, PIXEL_MM, (True, True, True, True))
    stack = (images * (0.7 / np.percentile(images, 99.9))).astype(np.float32)
    rig = default_rig()
    white = BandImages(CHANNELS, stack, rig.select([(k,) for k in range(7)]))
    settings = MetricSettings(relief=way, plane_mm=0.0)
    skin = metric_skin((white,), grid, AssumedSkin(), settings, networks=networks)
    return np.asarray(skin.shape_mm + skin.relief_mm, dtype=np.float64)


def low_pass(image: Any) -> Any:
    """Without what varies faster than CUT_PER_MM; the image is mirrored at its borders."""
    rows, columns = image.shape
    fy = scipy.fft.fftfreq(2 * rows, PIXEL_MM)[:, None]
    fx = scipy.fft.rfftfreq(2 * columns, PIXEL_MM)[None, :]
    kept = 1.0 / (1.0 + (np.hypot(fx, fy) / CUT_PER_MM) ** 12)
    mirrored = np.block([[image, image[:, ::-1]], [image[::-1], image[::-1, ::-1]]])
    return scipy.fft.irfft2(scipy.fft.rfft2(mirrored) * kept, mirrored.shape)[:rows, :columns]


def drifted(volume: Any, drift: float) -> Any:
    """Move the volume light of each LED away from it."""
    if drift == 0.0:
        return volume
    _, around = lights("red")
    result = np.empty_like(volume)
    for c, name in enumerate(CHANNELS):
        way = drift * drift_mm(SkinOptics().channel(name)) / PIXEL_MM
        for k, (x, y) in enumerate(around):
            result[c, k] = ndimage.shift(volume[c, k], (y * way, -x * way), order=3, mode="nearest")
    return result


if __name__ == "__main__":
    sys.exit(main())
