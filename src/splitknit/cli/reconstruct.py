"""``splitknit reconstruct``: a capture folder, or photographs and light directions, in; a folder of results out."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.cli.import_photos import add_photo_options, capture_of_photographs, check_photo_options
from splitknit.cli.verb import PRESETS, Outcome, Progress, add_device, add_settings, new_verb
from splitknit.errors import BadInput, naming, require

if TYPE_CHECKING:
    from splitknit.model import Capture


def add_reconstruct(verbs: Any) -> None:
    """Add ``splitknit reconstruct``."""
    verb = new_verb(verbs, "reconstruct", "turn a capture folder, or photographs, into a 3D fingerprint", _run)
    verb.add_argument(
        "capture", type=Path, nargs="?", metavar="CAPTURE", help="capture folder (with capture.json), or see --images"
    )
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write the results into")
    verb.add_argument(
        "--preset",
        choices=PRESETS,
        default="metric",
        help="metric (the default), or the thesis's snk (all of it), pr (direct light, no split), ea (plain), these "
        "two split by shapelets (pr-split, ea-split), or another published case: kumar, zheng, lin, xie",
    )
    verb.add_argument(
        "--rig",
        type=Path,
        metavar="RIG",
        help="rig file instead of the capture's, such as a calibration; with --images its white LEDs and camera",
    )
    verb.add_argument(
        "--shape",
        choices=("nir", "white", "mirror"),
        help="where the finger's shape comes from: near-infrared (nir, the default), white light, or its outlines in "
        "mirrors beside it (mirror)",
    )
    add_device(verb)
    add_settings(verb)
    add_photo_options(verb, required=False)


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.cli.options import read_changes  # verbs import what they need

    changes = read_changes(options.settings, options.assignments)
    if options.shape is not None:
        changes = {**changes, "shape.source": options.shape}
    require(
        (options.capture is None) != (options.images is None),
        "name a capture folder, or photographs with --images DIR --lights FILE"
        + ("; both were given." if options.capture is not None else "."),
    )
    check_photo_options(options)
    with Progress(options) as progress:
        facts = _reconstruct_to_folder(options, changes, progress.update)
    area = facts["result"]["area_px"]
    measured = f"{facts['area_mm2']:.0f} mm²" if facts["result"]["scale_known"] else f"{area} px (scale unknown)"
    lines = [
        f"{measured} reconstructed with preset {facts['preset']} in {facts['total_s']:.1f} s.",
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
    options: argparse.Namespace, changes: Mapping[str, Any], progress: Callable[[str, float], None]
) -> dict[str, Any]:
    """Read a capture or photographs, reconstruct, write all results; return the facts of ``report.json`` and more."""
    from splitknit.io.atomic import atomic_folder
    from splitknit.io.capture import read_capture, with_rig
    from splitknit.io.targets import check_target
    from splitknit.networks.unet import use_device
    from splitknit.pad import is_judged, pad_images, with_probability
    from splitknit.photometric.frames import rig_of_frame
    from splitknit.pipeline import reconstruct, with_scale
    from splitknit.presets import preset_settings
    from splitknit.report.result import write_files
    from splitknit.settings import override
    from splitknit.steps import one_heap

    started = time.perf_counter()
    one_heap()
    source, out, preset = options.capture or options.images, options.out, options.preset
    override(preset_settings(preset), changes)  # a wrong setting is refused before the images are read
    check_target(out, "height.npz", "an earlier result", keep=source)
    device = use_device(options.device)
    with atomic_folder(out) as target:
        progress("reading", 0.0)
        if options.images is not None:
            capture, notes = capture_of_photographs(options)
        else:
            capture = read_capture(source)
            if options.rig is not None:
                capture = with_rig(capture, options.rig)
            if options.shading is not None:
                capture = replace(capture, shading=options.shading)
            if options.tip_direction is not None:
                capture = replace(capture, tip_direction_deg=options.tip_direction)
            if options.light_frame is not None:
                capture = replace(capture, rig=rig_of_frame(capture.rig, options.light_frame))
            capture, note = naming(source, partial(with_scale, capture, options.px_per_mm, options.ridge_period))
            notes = [note] if note else []
        read_s = time.perf_counter() - started
        seen = pad_images(capture) if is_judged(capture) else None
        shown, held = _shown_of(capture), [capture]
        del capture  # so that its images go once they are read: 0.3 GB less at a full frame's peak
        try:
            result = reconstruct(
                held.pop(), preset, changes, lambda stage, fraction: progress(stage, 0.15 + 0.65 * fraction)
            )
            result = with_probability(result, seen)
            if device != "cpu":  # its last digits are others'
                result = replace(result, facts={**result.facts, "device": device})
            said = [note for note in notes if not any(note in warning for warning in result.warnings)]
            result = replace(
                result, timings_s={"reading": read_s, **result.timings_s}, warnings=(*said, *result.warnings)
            )
            progress("writing", 0.8)
            facts = write_files(result, shown, target, _truth_of(shown))
        except BadInput as error:  # stages know arrays only
            raise BadInput(f"{source}: {error}") from error
    progress("done", 1.0)
    return {**facts, "out": str(out), "area_mm2": facts["result"]["area_mm2"], "total_s": time.perf_counter() - started}


def _truth_of(capture: Capture) -> dict[str, Any] | None:
    if capture.truth is None or not capture.rig.camera.scale_known:
        return None
    from splitknit.evaluation.accuracy import read_truth  # only what was simulated has one

    return read_truth(capture)


def _shown_of(capture: Capture) -> Capture:
    """The capture with small white images for a report, so that the others can be let go, for the sake of memory."""
    from splitknit.report.photos import small_images

    bands = {
        name: replace(band, pixels=small_images(band) if name == "white" else band.pixels[:0].copy(), ambient=None)
        for name, band in capture.bands.items()
    }
    return replace(capture, bands=bands)
