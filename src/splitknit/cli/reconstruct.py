"""``splitknit reconstruct CAPTURE``: a capture folder in, a folder of results out."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.cli.verb import PRESETS, Outcome, Progress, add_settings, new_verb
from splitknit.errors import BadInput, require

if TYPE_CHECKING:
    from splitknit.model import Capture


def add_reconstruct(verbs: Any) -> None:
    """Add ``splitknit reconstruct``."""
    verb = new_verb(verbs, "reconstruct", "turn a capture folder into a 3D fingerprint in millimetres", _run)
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help="capture folder (with capture.json)")
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write the results into")
    verb.add_argument(
        "--preset",
        choices=PRESETS,
        default="metric",
        help="metric (the default), or the thesis's snk (all of it), pr (direct light, no split), ea (plain), or "
        "another published case: kumar, zheng, lin, xie",
    )
    verb.add_argument(
        "--rig", type=Path, default=None, metavar="RIG", help="rig file instead of the capture's, such as a calibration"
    )
    verb.add_argument(
        "--shape",
        choices=("nir", "white", "mirror"),
        default=None,
        help="where the finger's shape comes from: near-infrared (nir, the default), white light, or its outlines in "
        "mirrors beside it (mirror)",
    )
    verb.add_argument(
        "--tip-direction",
        type=float,
        default=None,
        metavar="DEG",
        help="where the tip points, within 75 degrees: 0 = up, counter-clockwise; left out, it is found",
    )
    verb.add_argument(
        "--light-frame",
        default=None,
        metavar="FRAME",
        help="where x and y of the lights' directions point in the image, where not right-up: right-down (y down), "
        "left-up (mirrored), left-down, up-left, up-right, down-left, down-right",
    )
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    """Write a reconstruction."""
    from splitknit.cli.options import read_changes  # noqa: PLC0415 - verbs import what they need

    changes = read_changes(options.settings, options.assignments)
    if options.shape is not None:
        changes = {**changes, "shape.source": options.shape}
    with Progress(options) as progress:
        facts = _reconstruct_to_folder(
            options.capture,
            options.out,
            preset=options.preset,
            rig=options.rig,
            tip_direction_deg=options.tip_direction,
            light_frame=options.light_frame,
            changes=changes,
            progress=progress.update,
        )
    lines = [
        f"{facts['area_mm2']:.0f} mm² reconstructed with preset {facts['preset']} in {facts['total_s']:.1f} s.",
        f"Written to {options.out}: {', '.join(facts['files'])}.",
    ]
    lines += [f"Please note: {warning}" for warning in facts["warnings"]]
    for preset, figure in facts["comparison"].items():
        lines.append(
            f"Against the truth ({preset}): surface rms {figure['surface_rms_mm']:.3f} mm, "
            f"ridge correlation {figure['ridge_correlation']:.2f}, ridge gain {figure['ridge_gain']:.2f}."
        )
    lines.append(f"Open {options.out / 'report.html'} in a browser.")
    return facts, lines


def _reconstruct_to_folder(
    capture_folder: Path,
    out: Path,
    *,
    preset: str,
    rig: Path | None,
    tip_direction_deg: float | None,
    light_frame: str | None,
    changes: Mapping[str, Any],
    progress: Callable[[str, float], None],
) -> dict[str, Any]:
    """Read a capture, reconstruct it, write all results; return the facts of ``report.json`` and more.

    `rig` names a rig file that replaces the capture's own, such as a later calibration; `tip_direction_deg` replaces
    what the capture states; `light_frame` is the one in which the lights were measured.
    """
    from splitknit.io.atomic import atomic_folder  # noqa: PLC0415
    from splitknit.io.capture import read_capture, with_rig  # noqa: PLC0415
    from splitknit.io.targets import check_target  # noqa: PLC0415
    from splitknit.photometric.frames import rig_of_frame  # noqa: PLC0415
    from splitknit.pipeline import reconstruct  # noqa: PLC0415
    from splitknit.presets import preset_settings  # noqa: PLC0415
    from splitknit.report.result import FILES, write_files  # noqa: PLC0415
    from splitknit.settings import override  # noqa: PLC0415

    started = time.perf_counter()
    require(
        tip_direction_deg is None or abs(tip_direction_deg) <= 360.0,
        "--tip-direction must be an angle from -360 to 360 degrees, 0 = up, counter-clockwise.",
    )
    override(preset_settings(preset), changes)  # a wrong setting is refused before the images are read
    check_target(out, "height.npz", "an earlier result", keep=capture_folder)
    with atomic_folder(out) as target:
        progress("reading", 0.0)
        capture = read_capture(capture_folder)
        if rig is not None:
            capture = with_rig(capture, rig)
        if tip_direction_deg is not None:
            capture = replace(capture, tip_direction_deg=tip_direction_deg)
        if light_frame is not None:
            capture = replace(capture, rig=rig_of_frame(capture.rig, light_frame))
        read_s = time.perf_counter() - started
        try:
            result = reconstruct(
                capture, preset, changes, lambda stage, fraction: progress(stage, 0.15 + 0.65 * fraction)
            )
            result = replace(result, timings_s={"reading": read_s, **result.timings_s})
            progress("writing", 0.8)
            capture = _shown_of(capture)
            facts = write_files(result, capture, target, _truth_of(capture))
        except BadInput as error:  # stages know arrays only
            raise BadInput(f"{capture_folder}: {error}") from error
    progress("done", 1.0)
    return {
        **facts,
        "out": str(out),
        "files": list(FILES),
        "area_mm2": facts["result"]["area_mm2"],
        "total_s": time.perf_counter() - started,
    }


def _truth_of(capture: Capture) -> dict[str, Any] | None:
    if capture.truth is None:
        return None
    from splitknit.evaluation.accuracy import read_truth  # noqa: PLC0415 - only what was simulated has one

    return read_truth(capture)


def _shown_of(capture: Capture) -> Capture:
    """The capture with the images that a report shows; the others are let go, for the sake of memory."""
    bands = {
        name: band if name == "white" else replace(band, pixels=band.pixels[:0].copy(), ambient=None)
        for name, band in capture.bands.items()
    }
    return replace(capture, bands=bands)
