"""The network for direct light on palms and fingers that it was not trained on, against doing nothing and a projector.

    python validation/separation/unet.py [--smoke] [--network NAME]
    python validation/separation/unet.py --fingers 30     # equalised grey of so many fingers only: unet_fingers.json

takes about three minutes on one free core (``--smoke`` seconds), writes ``unet.md`` beside this file and
prints it. Truth: direct light through 25 shifted checkerboards of 0.42 mm and the separation code, without
noise; the network was trained on the twin's own direct light, so the two came about differently. Palms, fingers, light,
optics of the skin, pixel size and noise are drawn anew.

A value of one is the photograph's exposure level: the 99.9th percentile of its white image. Judged are the pixels on
the skin. Red, green, blue: the linear photograph. Enhanced: the grey image after CLAHE, as the presets ``pr`` and
``snk`` have it; *network on the colours, their fraction* multiplies it by the direct fraction found in the linear
colours.
Intervals: 95 %, bootstrap over photographs (one of each palm or finger).

*Single image* is Nayar's separation from one photograph under the checkerboard, by the same camera, in blocks of two
checks. It needs a projector. It is judged in a box that is all skin, and the network there too.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from nayar import by_one_image as separated

from splitknit.model import Led
from splitknit.networks.unet import Network, load_network
from splitknit.separation.direct import direct_light, direct_of_enhanced
from splitknit_simulator.camera.sensor import SensorSettings, record
from splitknit_simulator.light.separation import Checkerboard, checkerboard_images, separate_truth

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parents[1] / "training"))

from scenes import HELD_OUT_FROM  # noqa: E402
from separation import CHECK_MM, Photograph, drawn_surface, photographs  # noqa: E402

FIRST = HELD_OUT_FROM + 1000
"""Not those of the learning curve either."""
FRACTION_FROM = 100
"""Photographs of palms and fingers from this number on (not judged) give the constant fraction."""
CHANNELS = ("red", "green", "blue", "enhanced")
SEED = 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smoke", action="store_true", help="one palm and one finger: does everything run?")
    parser.add_argument("--network", default="direct", help="shipped network, or path of an .onnx file")
    parser.add_argument("--count", type=int, default=6, help="palms, and as many fingers (default: 6)")
    parser.add_argument("--card", type=Path, default=None, help="card to write the network's figures into")
    parser.add_argument("--fingers", type=int, default=0, help="judge only so many fingers' equalised images")
    options = parser.parse_args()
    if options.fingers:
        return many_fingers(options.fingers, load_network(options.network))
    count = 1 if options.smoke else options.count
    network = load_network(options.network)
    fractions = constant_fractions(1 if options.smoke else 4)
    rows: list[dict[str, Any]] = []
    for kind in ("palm", "finger"):
        for index in range(FIRST, FIRST + count):
            rows += judge(photographs(kind, index, "stack")[0], (kind, index), network, fractions)
            print(f"{kind} {index - FIRST + 1} of {count}", file=sys.stderr, flush=True)
    result = {
        "network": {"name": network.card.name, "sha256": network.card.sha256},
        "photographs_of_each_kind": count,
        "check_mm": CHECK_MM,
        "fractions": dict(zip(CHANNELS, fractions.tolist(), strict=True)),
        "summary": summarised(rows),
        "photographs": rows,
    }
    table = markdown(result)
    print(table)
    if not options.smoke:
        (HERE / "unet.md").write_text(table, encoding="utf-8")
    if options.card is not None:
        note(options.card, result)
    return 0


def many_fingers(count: int, network: Network) -> int:
    """The network on equalised images of fingers, and the constant fraction: PSNR and paired difference."""
    fraction = np.float32(constant_fractions(4)[3])
    rows = []
    for index in range(FIRST, FIRST + count):
        photograph = photographs("finger", index, "stack")[0]
        image, truth = (part[3:] for part in channels(photograph))
        mask = truth[0] > 0
        ways = {
            "network": direct_light(image, network),
            "network on the colours, their fraction": direct_of_enhanced(
                image, channels(photograph)[0][None, :3], network
            ),
            "constant fraction": image * fraction,
        }
        made = [figures(("finger", index), way, one, truth, mask, names=CHANNELS[3:])[0] for way, one in ways.items()]
        rows.append({row["method"]: row["psnr_db"] for row in made})
        print(f"finger {index - FIRST + 1} of {count}", file=sys.stderr, flush=True)
    drawn = np.random.default_rng(1).integers(0, count, (2000, count))

    def mean(values: np.ndarray) -> list[float]:
        return [round(float(v), 2) for v in (values.mean(), *np.percentile(values[drawn].mean(axis=1), [2.5, 97.5]))]

    columns = {way: np.array([row[way] for row in rows]) for way in rows[0]}
    result = {"fingers": count, "psnr_db": {way: mean(column) for way, column in columns.items()}}
    result["above_the_constant_db"] = {
        way: mean(columns[way] - columns["constant fraction"]) for way in list(columns)[:2]
    }
    (HERE / "unet_fingers.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))
    return 0


def note(card: Path, result: dict[str, Any]) -> None:
    """Write the network's own rows into its card."""
    document = json.loads(card.read_text(encoding="utf-8"))
    if document["sha256"] != result["network"]["sha256"]:
        raise SystemExit(f"{card} is the card of another network")
    rows = [entry for entry in result["summary"] if entry["method"] == "network"]
    document["metrics"]["validation"] = {
        "command": "python validation/separation/unet.py",
        "what": "palms and fingers not trained on, mean over photographs; peak 1 is the photograph's exposure level",
        "psnr_db": {f"{entry['kind']} {entry['channel']}": round(entry["psnr_db"]["mean"], 2) for entry in rows},
        "ssim": {f"{entry['kind']} {entry['channel']}": round(entry["ssim"]["mean"], 4) for entry in rows},
    }
    card.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def constant_fractions(count: int) -> np.ndarray:
    """(4,) fraction of the image, per channel, that is nearest to the direct light over other photographs."""
    up, down = np.zeros(4), np.zeros(4)
    for kind in ("palm", "finger"):
        for index in range(HELD_OUT_FROM + FRACTION_FROM, HELD_OUT_FROM + FRACTION_FROM + count):
            image, direct = channels(photographs(kind, index, "truth")[0])
            up += (image * direct).mean(axis=(1, 2))
            down += (image * image).mean(axis=(1, 2))
    return up / down


def channels(photograph: Photograph) -> tuple[np.ndarray, np.ndarray]:
    """Image and direct light, (4, h, w): red, green, blue, enhanced."""
    pixels = photograph.pixels.astype(np.float32).transpose(2, 0, 1)
    return pixels[[0, 1, 2, 6]], pixels[[3, 4, 5, 7]]


def judge(
    photograph: Photograph, name: tuple[str, int], network: Network, fractions: np.ndarray
) -> list[dict[str, Any]]:
    """Every method on one photograph."""
    image, truth = channels(photograph)
    mask = truth[0] > 0
    found = {
        "network": np.concatenate([direct_light(image[None, :3], network)[0], direct_light(image[3:], network)]),
        "input as it is": image,
        "constant fraction": image * fractions[:, None, None].astype(np.float32),
        "best fraction of this image": image * best_fraction(image, truth, mask)[:, None, None],
    }
    rows = [row for method, made in found.items() for row in figures(name, method, made, truth, mask)]
    by_fraction = direct_of_enhanced(image[3:], image[None, :3], network)
    rows += figures(name, "network on the colours, their fraction", by_fraction, truth[3:], mask, names=CHANNELS[3:])
    box = largest_box(mask)
    inside = np.ones_like(mask[box])
    projected = by_one_image(photograph, name, image, box)
    for method, made in {**projected, "network, there": found["network"][:3][:, *box]}.items():
        rows += figures(name, method, made, truth[: len(made)][:, *box], inside)
    return rows


def best_fraction(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    x, y = image[:, mask], truth[:, mask]
    return np.asarray((x * y).sum(axis=1) / (x * x).sum(axis=1), dtype=np.float32)


def largest_box(mask: np.ndarray) -> tuple[slice, slice]:
    """A box about the middle of the skin, all of it skin: nine tenths of the largest of the image's shape."""
    rows, columns = (round(float(index.mean())) for index in np.nonzero(mask))
    low, high = 0.0, 0.5
    for _ in range(20):
        half = 0.5 * (low + high)
        fits = mask[_box(mask.shape, (rows, columns), half)]
        low, high = (half, high) if fits.all() else (low, half)
    return _box(mask.shape, (rows, columns), 0.9 * low)


def _box(shape: tuple[int, ...], middle: tuple[int, int], half: float) -> tuple[slice, slice]:
    sides = (int(half * length) for length in shape)
    rows, columns = (slice(max(m - h, 0), m + h) for m, h in zip(middle, sides, strict=True))
    return rows, columns


def by_one_image(
    photograph: Photograph, name: tuple[str, int], image: np.ndarray, box: tuple[slice, slice]
) -> dict[str, np.ndarray]:
    """Nayar's separation from a single image under a checkerboard, brought to full size."""
    facts = photograph.facts
    surface = drawn_surface(*name)
    skin, led = facts["skin"], Led("white", position_mm=tuple(facts["led_mm"]))
    pattern = Checkerboard(CHECK_MM, steps=5)
    white = separate_truth(surface, led, skin, check_mm=CHECK_MM, phases="centred")
    # the camera as it took the white photograph: radiance to full scale, and full scale to the exposure level
    mask = surface.mask[white.window]
    brightest = np.percentile((white.white - white.glare)[:, mask].max(axis=0), 99.9)
    exposure = np.float32(facts["exposure"] / brightest)
    sensor = SensorSettings(exposure=facts["exposure"], bits=facts["bits"])
    lit = next(checkerboard_images(surface, led, skin, pattern))[:, *box].transpose(1, 2, 0) * exposure
    stored = record(lit, "white", np.random.SeedSequence([SEED, *name[1:]]), sensor, surface.camera.px_per_mm / 75.7)
    lit = stored.astype(np.float32) / np.float32(2**sensor.bits - 1)
    level = np.median(white.white[1][box] * exposure) / np.median(image[1][box])
    lit /= np.float32(level)
    check_px = 1000.0 * CHECK_MM / facts["pitch_um"]
    block = int(np.ceil(2.0 * check_px))
    direct = separated(lit, block, check_px)
    size, covered = lit.shape[1::-1], (direct.shape[1] * block, direct.shape[0] * block)
    large = cv2.resize(np.asarray(direct, dtype=np.float32), covered, interpolation=cv2.INTER_CUBIC)
    full = cv2.copyMakeBorder(large, 0, size[1] - covered[1], 0, size[0] - covered[0], cv2.BORDER_REPLICATE)
    return {"single image": full.transpose(2, 0, 1)}


def figures(
    name: tuple[str, int],
    method: str,
    made: np.ndarray,
    truth: np.ndarray,
    mask: np.ndarray,
    *,
    names: tuple[str, ...] = CHANNELS,
) -> list[dict[str, Any]]:
    """PSNR and SSIM of each channel, for a peak of one and for the direct light's own peak."""
    rows = []
    for channel, one, real in zip(names, made, truth, strict=False):
        mean_square = float(np.mean(np.square((one - real)[mask], dtype=np.float64)))
        own = float(np.percentile(real[mask], 99.9))
        rows.append(
            {
                "kind": name[0],
                "index": name[1],
                "method": method,
                "channel": channel,
                "psnr_db": -10.0 * float(np.log10(mean_square)),
                "psnr_own_peak_db": 10.0 * float(np.log10(own * own / mean_square)),
                "ssim": similarity(one, real, mask, 1.0),
                "ssim_own_peak": similarity(one, real, mask, own),
            }
        )
    return rows


def similarity(one: np.ndarray, two: np.ndarray, mask: np.ndarray, peak: float) -> float:
    """Mean structural similarity over `mask` (Wang et al. 2004: Gaussian of 1.5 pixels, K = 0.01 and 0.03)."""

    def blur(values: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.GaussianBlur(values.astype(np.float64), (11, 11), 1.5))

    first, second = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    a, b = blur(one), blur(two)
    aa, bb, ab = blur(one * one) - a * a, blur(two * two) - b * b, blur(one * two) - a * b
    index = (2 * a * b + first) * (2 * ab + second) / ((a * a + b * b + first) * (aa + bb + second))
    return float(index[mask].mean())


def summarised(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean and interval of every figure, by kind, method and channel."""
    rng = np.random.default_rng(1)
    keys = list(dict.fromkeys((row["kind"], row["method"], row["channel"]) for row in rows))
    result = []
    for key in keys:
        mine = [row for row in rows if (row["kind"], row["method"], row["channel"]) == key]
        entry: dict[str, Any] = dict(zip(("kind", "method", "channel"), key, strict=True))
        for figure in ("psnr_db", "psnr_own_peak_db", "ssim", "ssim_own_peak"):
            values = np.array([row[figure] for row in mine])
            means = values[rng.integers(0, len(values), (2000, len(values)))].mean(axis=1)
            low, high = np.percentile(means, [2.5, 97.5])
            entry[figure] = {"mean": float(values.mean()), "low": float(low), "high": float(high)}
            entry[figure]["least"] = float(values.min())
        result.append(entry)
    return result


def markdown(result: dict[str, Any]) -> str:
    lines = [
        f"Direct light of {result['photographs_of_each_kind']} palms and as many fingers not trained on, "
        f"checks of {result['check_mm']} mm, network `{result['network']['name']}`. "
        "PSNR in dB for a peak of 1 (the photograph's exposure level), and SSIM; mean [95 %] over photographs.",
    ]
    for kind in ("palm", "finger"):
        entries = [entry for entry in result["summary"] if entry["kind"] == kind]
        lines += ["", f"| {kind}s | {' | '.join(CHANNELS)} |", "| --- " * (1 + len(CHANNELS)) + "|"]
        for method in dict.fromkeys(entry["method"] for entry in entries):
            cells = {entry["channel"]: _cell(entry) for entry in entries if entry["method"] == method}
            lines.append(f"| {method} | " + " | ".join(cells.get(channel, "") for channel in CHANNELS) + " |")
        mine = [entry for entry in entries if entry["method"] == "network"]
        cells = [f"{entry['psnr_own_peak_db']['mean']:.1f}, {entry['ssim_own_peak']['mean']:.3f}" for entry in mine]
        lines.append("| network, for the direct light's own peak | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _cell(entry: dict[str, Any]) -> str:
    psnr, ssim = entry["psnr_db"], entry["ssim"]
    return f"{psnr['mean']:.1f} [{psnr['low']:.1f}, {psnr['high']:.1f}], {ssim['mean']:.3f}"


if __name__ == "__main__":
    sys.exit(main())
