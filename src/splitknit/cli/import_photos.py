"""``splitknit import``: photographs and light directions in, a capture folder out; or prints of other systems.

``splitknit reconstruct`` takes the same options of photographs.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.cli.verb import Outcome, Progress, add_input_ppi, add_overwrite, new_verb
from splitknit.errors import naming, require

if TYPE_CHECKING:
    from splitknit.model import Capture

_OF_PHOTOGRAPHS = ("lights", "mask", "material", "encoding", "background", "max_size", "crossed", "mosaic")


def add_import(verbs: Any) -> None:
    """Add ``splitknit import``."""
    what = "turn photographs and light directions into a capture folder (--images), or prints of other systems into PNG"
    verb = new_verb(verbs, "import", what, _run)
    add_photo_options(verb, required=False)
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    add_overwrite(verb)
    group = verb.add_argument_group("prints of other systems")
    group.add_argument(
        "files",
        type=Path,
        nargs="*",
        metavar="FILE",
        help="WSQ, ISO 19794-4, ANSI/NIST-ITL, PNG, TIFF, JPEG, BMP: each print becomes a PNG with its resolution; "
        "ISO 19794-2, ANSI 378: the minutiae of each finger become an ISO 19794-2 file; match, enroll, identify take "
        "all of them as they are",
    )
    add_input_ppi(group)


def add_photo_options(verb: argparse.ArgumentParser, *, required: bool) -> None:
    """Add what photographs need to become a capture."""
    group = verb.add_argument_group("photographs")
    group.add_argument(
        "--images",
        type=Path,
        required=required,
        metavar="DIR",
        help="folder of photographs, one for each light, in the order of their names: JPEG, PNG, TIFF, WEBP, BMP; with "
        "the extra 'photos' HEIC and camera RAW",
    )
    group.add_argument(
        "--lights",
        type=Path,
        metavar="FILE",
        help="directions towards the lights, a line 'x y z' or 'NAME x y z' for each photograph: x right, y up, z to "
        "the camera; places in mm where the first line is 'x_mm y_mm z_mm'; also .lp files of RTI and rig files "
        "(default: lights.txt beside the images)",
    )
    group.add_argument(
        "--mask", type=Path, metavar="FILE", help="image, white = object (default: mask.png beside the images, if any)"
    )
    group.add_argument(
        "--material",
        choices=("skin", "opaque"),
        help="skin: a finger, whose blur of light is undone; opaque (default): any other thing, left as it lies",
    )
    group.add_argument(
        "--tip-direction",
        type=float,
        metavar="DEG",
        help="where a finger's tip points, within 75 degrees: 0 = up, counter-clockwise; left out, it is found",
    )
    group.add_argument(
        "--encoding",
        choices=("linear", "srgb"),
        help="of the photographs (default: srgb for JPEG, WEBP, HEIC and PNG that states it; linear for RAW and 16 "
        "bits; else by their shading)",
    )
    group.add_argument(
        "--max-size",
        type=float,
        metavar="MEGAPIXELS",
        help="reduce larger photographs to so many megapixels, by means over areas (default: they stay as they are)",
    )
    group.add_argument(
        "--background",
        metavar="VALUE|FILE",
        help="stored value that every pixel has without light, or a photograph with all lights off",
    )
    group.add_argument(
        "--crossed",
        type=Path,
        metavar="DIR",
        help="folder of the same photographs in the same order through crossed polarising films; those of --images "
        "are then the ones through parallel films; one exposure for all",
    )
    group.add_argument(
        "--mosaic",
        choices=("mono", "colour"),
        help="the photographs are raw frames of a camera with films on its pixels (90, 45 / 135, 0 degrees; mono: "
        "Sony IMX250MZR, colour: IMX250MYR); each holds the parallel and the crossed image",
    )
    group.add_argument(
        "--film-angle",
        type=float,
        default=90.0,
        metavar="DEG",
        help="of --mosaic: direction of the film before the LEDs, 0 along the rows (default: 90)",
    )
    group.add_argument(
        "--light-frame",
        metavar="FRAME",
        help="where x and y of the lights' directions point in the image, where not right-up: right-down (y down), "
        "left-up (mirrored), left-down, up-left, up-right, down-left, down-right",
    )
    add_scale_options(group)


def add_scale_options(verb: Any) -> None:
    """Add the two ways to give a scale that nobody has measured yet."""
    verb.add_argument(
        "--px-per-mm",
        type=float,
        metavar="X",
        help="scale on the object, where the input has none; without it heights are in pixels",
    )
    verb.add_argument(
        "--ridge-period",
        type=float,
        metavar="MM",
        help="take the scale from a finger's ridges, which lie MM apart: 0.45 is usual, people differ by 8 %%",
    )


def check_photo_options(options: argparse.Namespace) -> None:
    """Refuse options of photographs where a capture is named, and two scales. Raises BadInput."""
    require(
        options.tip_direction is None or abs(options.tip_direction) <= 360.0,
        "--tip-direction must be an angle from -360 to 360 degrees, 0 = up, counter-clockwise.",
    )
    if options.images is None:
        unused = [name for name in _OF_PHOTOGRAPHS if getattr(options, name) is not None]
        require(not unused, f"--{unused[0].replace('_', '-') if unused else ''} goes with --images.")
    require(
        options.max_size is None or 0.01 <= options.max_size <= 1000,
        f"--max-size must be megapixels from 0.01 to 1000, not {options.max_size}.",
    )
    require(abs(options.film_angle) <= 360, "--film-angle must be an angle from -360 to 360 degrees, 0 along the rows.")
    check_scale_options(options)


def check_scale_options(options: argparse.Namespace) -> None:
    """Refuse two scales, and numbers that are none. Raises BadInput."""
    both = options.px_per_mm is not None and options.ridge_period is not None
    require(not both, "--px-per-mm and --ridge-period both give the scale; choose one.")
    require(
        options.px_per_mm is None or 1e-3 <= options.px_per_mm <= 1e5,
        f"--px-per-mm must be a number from 0.001 to 100000, not {options.px_per_mm}.",
    )


def capture_of_photographs(options: argparse.Namespace) -> tuple[Capture, list[str]]:
    """The capture of the photographs that the options name, and notes on it."""
    from splitknit.io.plain import PhotographOptions, capture_from_photographs  # verbs import what they need
    from splitknit.model import UNKNOWN_SCALE
    from splitknit.photometric.frames import rig_of_frame
    from splitknit.pipeline import with_scale

    background: float | str | None = options.background
    with contextlib.suppress(ValueError):
        background = None if background is None else float(background)
    rig_file = getattr(options, "rig", None)
    both = rig_file is not None and options.lights is not None
    require(not both, "--rig and --lights both give the lights; choose one.")
    lights = options.lights or rig_file
    require(
        rig_file is None or rig_file.suffix.lower() == ".json",
        f"--rig must name a rig file (.json), not '{rig_file}'; name a list of lights with --lights.",
    )
    found = capture_from_photographs(
        options.images,
        lights,
        options.px_per_mm,
        PhotographOptions(
            options.mask,
            options.material or "opaque",
            options.encoding,
            background,
            options.tip_direction,
            options.max_size,
            options.crossed,
            options.mosaic,
            options.film_angle,
        ),
        announce=lambda words: print(f"splitknit: note: {words}", file=sys.stderr),
    )
    taken = found.capture
    if options.light_frame is not None:
        taken = replace(taken, rig=rig_of_frame(taken.rig, options.light_frame))
    capture, note = naming(options.images, lambda: with_scale(taken, None, options.ridge_period))
    kept = [one for one in found.notes if one != UNKNOWN_SCALE or not capture.rig.camera.scale_known]
    return capture, [*kept, *([note] if note else [])]


def _run(options: argparse.Namespace) -> Outcome:
    """Write a capture folder, or prints."""
    both = options.images is not None and options.files
    require(not both, "photographs (--images DIR) and prints (FILE ...) are imported one after the other.")
    require(
        options.images is not None or bool(options.files),
        "name photographs (--images DIR --lights FILE) or files of prints to import.",
    )
    return _import_photos(options) if options.images is not None else _import_prints(options)


def _import_prints(options: argparse.Namespace) -> Outcome:
    """Write the prints of other systems."""
    from splitknit.cli.export import export_words  # verbs import what they need
    from splitknit.gallery.records import Exporting, import_records

    check_photo_options(options)
    of_photographs = ("tip_direction", "light_frame", "px_per_mm", "ridge_period", "overwrite")
    needless = [name for name in of_photographs if getattr(options, name)]
    require(not needless, f"--{needless[0].replace('_', '-') if needless else ''} goes with --images.")
    settings = Exporting(input_ppi=options.input_ppi)
    with Progress(options) as progress:
        facts = import_records(options.files, options.out, settings, progress=progress.update)
    return facts, export_words(facts)


def _import_photos(options: argparse.Namespace) -> Outcome:
    """Write a capture folder."""
    from splitknit.io.capture import write_capture
    from splitknit.io.targets import check_capture

    check_photo_options(options)
    for folder in (options.images, *([options.crossed] if options.crossed else [])):
        check_capture(options.out, overwrite=options.overwrite, keep=folder)
    with Progress(options) as progress:
        progress.update("reading", 0.1)
        capture, notes = capture_of_photographs(options)
        progress.update("writing", 0.7)
        write_capture(capture, options.out, overwrite=options.overwrite)
    band, camera = capture.bands["white"], capture.rig.camera
    count, rows, columns, channels = band.pixels.shape
    facts: dict[str, Any] = {
        "out": str(options.out),
        "images": count,
        "polarised": "white_crossed" in capture.bands,
        "image_size": [rows, columns],
        "channels": channels,
        "encoding": capture.encoding,
        "material": capture.material,
        "px_per_mm": camera.px_per_mm if camera.scale_known else None,
        "mask": capture.mask is not None,
        "notes": notes,
    }
    kind = "colour" if channels == 3 else "grey"
    if facts["polarised"]:
        kind = f"parallel and {count} crossed {kind}"
    scale = f"{camera.px_per_mm:g} px/mm" if camera.scale_known else "scale unknown"
    covered = "no mask" if capture.mask is None else f"the mask covers {100 * capture.mask.mean():.0f} %"
    lines = [
        f"{count} {kind} photographs of {columns} x {rows} pixels ({capture.encoding}, {capture.material}, {scale}, "
        f"{covered}) written to {options.out}.",
        *(f"Please note: {note}" for note in notes),
        f"Next: splitknit reconstruct {options.out} --out RESULT",
    ]
    return facts, lines
