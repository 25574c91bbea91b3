"""Leave one light out, reconstruct from the others, predict its image: relative error without any
truth.

    python validation/real_skin/run.py CAPTURE [CAPTURE ...] [--all] [--out FILE.json]
    python validation/real_skin/run.py CROSSED --surface CAPTURE

CROSSED is the same still finger behind crossed polarisers. ``--set STAGE.FIELD=VALUE`` changes a
setting of the reconstruction.

Three white lights of each capture, or with ``--all`` every light of every band. Beside the
reconstruction stand two predictions that use no model of skin: the mean of the two lights next to
it, and plain photometric stereo. Each is fitted to the image by one factor a channel. What the
figures mean: docs/experiments/real-skin.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from predict import SLANTS_DEG, WAYS, left_out

from splitknit import read_capture, reconstruct
from splitknit.capture import Capture
from splitknit.errors import BadInput, require
from splitknit.io.csv_table import csv_text
from splitknit.presets import PipelineSettings, preset_settings
from splitknit.settings import override

FEW_LIGHTS = 3
"""White lights that are left out unless all are."""
CLASSES = [f"rms_{low}_{high}" for low, high in pairwise(SLANTS_DEG)]
PERCENT = ["rms", *CLASSES, "ridges", "change"]
HEADS = ["error", *(f"error_{low}_{high}_deg" for low, high in pairwise(SLANTS_DEG))]


def chosen_settings(assignments: Sequence[str]) -> PipelineSettings:
    """The `metric` preset with the changes of ``--set``."""
    changes: dict[str, Any] = {}
    for text in assignments:
        name, separated, value = text.partition("=")
        require(bool(separated), f"--set needs STAGE.FIELD=VALUE, but it is '{text}'.")
        try:
            changes[name] = json.loads(value)
        except ValueError:
            changes[name] = value
    return override(preset_settings("metric"), changes)


def images_of(capture: Capture, everything: bool) -> list[tuple[str, int]]:
    """Band and number of the images that are left out, one after another."""
    if everything:
        return [(name, k) for name, band in capture.bands.items() for k in range(len(band.leds))]
    require(
        "white" in capture.bands, "the capture has no band 'white'; every reconstruction needs it."
    )
    count = len(capture.bands["white"].leds)
    return [("white", k) for k in sorted({k * count // FEW_LIGHTS for k in range(FEW_LIGHTS)})]


def table(captures: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[list[str]]:
    """Means over the left-out images, and but for the gain over the channels."""
    lines = [["capture", "band", "prediction_by", *HEADS, "ridges", "change", "gain"]]
    for name, rows in captures.items():
        for band in dict.fromkeys(row["band"] for row in rows):
            of_images = [row["channels"] for row in rows if row["band"] == band]
            for way in WAYS:
                parts = [part[way] for channels in of_images for part in channels.values()]
                cells = [
                    _percent([part[figure] for part in parts if figure in part])
                    for figure in PERCENT
                ]
                gains = [
                    np.mean([channels[channel][way]["gain"] for channels in of_images])
                    for channel in of_images[0]
                ]
                cells.append(", ".join(f"{gain:.2f}" for gain in gains))
                lines.append([name, band, way, *cells])
    return lines


def _percent(values: Sequence[float]) -> str:
    return f"{100 * float(np.mean(values)):.1f} %" if values else "-"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the table, write the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    parser.add_argument(
        "--all", action="store_true", help="every light of every band, not three white ones"
    )
    parser.add_argument(
        "--surface",
        type=Path,
        metavar="CAPTURE",
        help=(
            "the images were taken through crossed polarisers: take the surface from CAPTURE, the"
            " same still finger without them"
        ),
    )
    parser.add_argument("--out", type=Path, metavar="FILE.json")
    parser.add_argument(
        "--table", type=Path, metavar="FILE.csv", help="means, as in tables/predictions.csv"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="STAGE.FIELD=VALUE", dest="assignments"
    )
    options = parser.parse_args(arguments)
    captures: dict[str, list[dict[str, Any]]] = {}
    try:
        settings = chosen_settings(options.assignments)
        surface = (
            None
            if options.surface is None
            else reconstruct(read_capture(options.surface), settings=settings)
        )
        for folder in options.captures:
            capture = read_capture(folder)
            name = folder.resolve().name
            rows = captures.setdefault(str(folder) if name in captures else name, [])
            for band, image in images_of(capture, options.all):
                rows.append(rounded(left_out(capture, band, image, settings, surface)))
                print(
                    f"{folder}: {band} {image}, relief by {rows[-1]['relief_by']}",
                    file=sys.stderr,
                    flush=True,
                )
                if options.out is not None:
                    options.out.write_text(json.dumps(captures, indent=1) + "\n")
    except (BadInput, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join("  ".join(line) for line in table(captures)))
    if options.table is not None:
        options.table.write_text(csv_text(table(captures)), encoding="utf-8")
    return 0


def rounded(value: Any) -> Any:
    """Numbers with four digits behind the point."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    return round(value, 4) if isinstance(value, float) else value


if __name__ == "__main__":
    sys.exit(main())
