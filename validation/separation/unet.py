"""The network for direct light on equalised images of palms and fingers that it was not trained on.

    python validation/separation/unet.py [--fingers 30] [--network NAME]

takes some minutes on one core. Truth: direct light through 25 shifted checkerboards of 0.42 mm and
the separation code, without noise; the network was trained on the twin's own direct light, so the
two came about differently. Palms, fingers, light, optics of the skin, pixel size and noise are
drawn anew. Images are grey after CLAHE, as the presets ``pr`` and ``snk`` have them. *Network on
the colours, their fraction* multiplies them by the direct fraction found in the linear colours,
*constant fraction* by that of other photographs. PSNR is for a peak of one, the photograph's
exposure level, on the skin. Figures of fingers are stored in ``unet_fingers.json``.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from from_colours import direct_of_enhanced

from splitknit.networks.unet import Network, load_network
from splitknit.separation.direct import direct_light

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parents[1] / "training"))

from scenes import HELD_OUT_FROM  # noqa: E402
from separation import photographs  # noqa: E402

FIRST_NUMBER = HELD_OUT_FROM + 1000
"""Not those of the learning curve either."""
FRACTION_FROM = 100
"""Photographs of palms and fingers from this number on (not judged) give the constant fraction."""
FRACTION_COUNT = 4
"""Number of these photographs."""
PALMS = 6


def main() -> None:
    """Judge, print and store."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--network", default="direct", help="shipped network, or path of an .onnx file"
    )
    parser.add_argument("--fingers", type=int, default=30)
    options = parser.parse_args()
    network = load_network(options.network)
    fraction = constant_fraction()
    print("palms:", json.dumps(compared("palm", PALMS, network, fraction)), flush=True)
    result = {"fingers": options.fingers, **compared("finger", options.fingers, network, fraction)}
    (HERE / "unet_fingers.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print("fingers:", json.dumps(result))


def compared(
    kind: str, count: int, network: Network, fraction: np.float32
) -> dict[str, dict[str, list[float]]]:
    """PSNR of each way and the paired difference from the constant, with 95 % intervals that draw
    photographs."""
    rows = []
    for index in range(FIRST_NUMBER, FIRST_NUMBER + count):
        colours, image, truth = channels(kind, index, "stack")
        ways = {
            "network": direct_light(image[None], network)[0],
            "network on the colours, their fraction": direct_of_enhanced(
                image[None], colours[None], network
            )[0],
            "constant fraction": image * fraction,
        }
        rows.append([psnr_db(direct, truth) for direct in ways.values()])
    drawn = np.random.default_rng(1).integers(0, count, (2000, count))

    def mean(values: np.ndarray) -> list[float]:
        return [
            round(float(v), 2)
            for v in (values.mean(), *np.percentile(values[drawn].mean(axis=1), [2.5, 97.5]))
        ]

    columns = dict(zip(ways, np.array(rows).T, strict=True))
    return {
        "psnr_db": {way: mean(column) for way, column in columns.items()},
        "above_the_constant_db": {
            way: mean(column - columns["constant fraction"])
            for way, column in columns.items()
            if way != "constant fraction"
        },
    }


def constant_fraction() -> np.float32:
    """Fraction of the equalised image that is nearest to the direct light over other
    photographs."""
    up = down = 0.0
    for kind in ("palm", "finger"):
        first = HELD_OUT_FROM + FRACTION_FROM
        for index in range(first, first + FRACTION_COUNT):
            _, image, direct = channels(kind, index, "truth")
            up += float((image * direct).mean())
            down += float((image * image).mean())
    return np.float32(up / down)


def channels(kind: str, index: int, truth: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Linear colours (3, h, w), equalised image (h, w), and its direct light (h, w), zero beside
    the skin."""
    pixels = photographs(kind, index, truth)[0].pixels.astype(np.float32).transpose(2, 0, 1)
    return pixels[:3], pixels[6], pixels[7]


def psnr_db(direct: np.ndarray, truth: np.ndarray) -> float:
    """For a peak of one, on the skin."""
    skin = truth > 0
    return -10.0 * float(np.log10(np.mean(np.square((direct - truth)[skin], dtype=np.float64))))


if __name__ == "__main__":
    main()
