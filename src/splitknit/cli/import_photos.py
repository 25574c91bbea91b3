"""``splitknit import``: photographs and light directions in, a capture folder out; a view of several fingers, a capture
folder of each; point clouds and meshes, a result folder out; or prints of other systems.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.cli.verb import Outcome, Progress, add_input_ppi, add_overwrite, new_verb, refuse_given
from splitknit.errors import naming, require

if TYPE_CHECKING:
    from splitknit.model import Capture

_UNITS = ("um", "mm", "cm", "in", "m")
_UP = ("x", "y", "z", "-x", "-y", "-z")
_CLOUDS = (".ply", ".pcd", ".xyz", ".asc", ".obj", ".stl", ".x3p", ".tmd")
_OF_PHOTOGRAPHS = ("lights", "mask", "material", "encoding", "background", "max_size", "crossed", "mosaic", "flat")
_CIRCLE = ("led_height_cm", "led_radius_cm", "led_centre_px", "keep")


def add_import(verbs: Any) -> None:
    """Add ``splitknit import``."""
    what = (
        "turn photographs and light directions into a capture folder (--images), a point cloud into a result folder, "
        "or prints of other systems into PNG"
    )
    verb = new_verb(verbs, "import", what, _run)
    add_photo_options(verb, required=False)
    _add_rig_captures(verb)
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    verb.add_argument(
        "--fingers",
        metavar="WHICH",
        help="--images, or the capture folder FILE, show several fingers side by side: each becomes a capture in DIR; "
        "left, right: index to little finger of that hand; auto: the hand follows from their tips; else names from "
        "left to right, such as right_middle,right_index",
    )
    add_overwrite(verb)
    group = verb.add_argument_group("prints of other systems")
    group.add_argument(
        "files",
        type=Path,
        nargs="*",
        metavar="FILE",
        help="WSQ, ISO 19794-4, ANSI/NIST-ITL, PNG, TIFF, JPEG, BMP: each print becomes a PNG with its resolution; "
        "ISO 19794-2, ANSI 378: the minutiae of each finger become an ISO 19794-2 file; match, enroll, identify take "
        "all of them as they are; PLY, PCD, XYZ, OBJ, STL, X3P, TMD: see point clouds",
    )
    add_input_ppi(group)
    clouds = verb.add_argument_group(
        "point clouds, meshes and height maps",
        "one FILE (.ply, .pcd, .xyz, .obj, .stl, .x3p, .tmd) becomes a result folder; --material is skin, a finger, "
        "unless given, and --tip-direction counts from the top of the view",
    )
    clouds.add_argument(
        "--unit", choices=tuple(_UNITS), help="of the coordinates (default: mm; X3P and TMD state theirs)"
    )
    clouds.add_argument(
        "--up",
        choices=_UP,
        metavar="AXIS",
        help="axis that points to the viewer: x, y, z, or -x as --up=-x (default: found by normals or by the shape)",
    )
    clouds.add_argument(
        "--pitch", type=float, metavar="MM", help="of the grid (default: the cloud's own, or as its points carry it)"
    )


def _add_rig_captures(verb: argparse.ArgumentParser) -> None:
    """Add what captures of a rig like the thesis's are imported by."""
    group = verb.add_argument_group("white and near-infrared photographs of a rig, of one finger or of many people")
    for option, kind, metavar, words in (
        ("--nir", Path, "DIR", "near-infrared photographs: a folder, or a pattern as for --images; their lights are "
         "the NIR LEDs of --table or a rig file, else lights.txt in that folder"),
        ("--table", Path, "CSV", "lights by nail and shadow tips, as 'calibrate lights --table' reads it"),
        ("--led-height-cm", float, "N", "of --table: LEDs above the finger plane"),
        ("--led-radius-cm", float, "N", "of --table: radius of the LEDs' circle"),
        ("--led-centre-px", str, "X,Y", "of --table: pixel of the circle's centre (default: the middle)"),
        ("--people", Path, "TREE", "folder of many people's photographs: --images and --nir are patterns of paths "
         "below it, such as '{subject}/{session}/{finger}/white_{light}.jpg', --out a population for 'batch'"),
    ):  # fmt: skip
        group.add_argument(option, type=kind, metavar=metavar, help=words)
    group.add_argument("--keep", action="store_true", help="of --table: keep LEDs that its check refuses")
    group.add_argument("--dry-run", action="store_true", help="of --people: say what goes where, write nothing")


def add_photo_options(verb: argparse.ArgumentParser, *, required: bool) -> None:
    """Add what photographs need to become a capture."""
    group = verb.add_argument_group("photographs")
    group.add_argument(
        "--images",
        type=Path,
        required=required,
        metavar="DIR",
        help="folder of photographs, one for each light, in the order of their names (or a pattern of names, such as "
        "'photos/white_{light}.jpg'): JPEG, PNG, TIFF, WEBP, BMP; with the extra 'photos' HEIC and camera RAW",
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
        "--flat",
        type=Path,
        metavar="DIR",
        help="photographs of a flat matt surface, one for each light in the same order and exposure: those of "
        "the object are divided by them",
    )
    group.add_argument(
        "--shading",
        type=Path,
        metavar="FILE",
        help="calibration of 'calibrate shading': slopes and scale follow from it; no --lights are needed",
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
        refuse_given(options, _OF_PHOTOGRAPHS, "goes with --images.")
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
    px_per_mm = options.px_per_mm
    if options.shading is not None:
        from splitknit.photometric.shading import read_shading

        scale = (options.px_per_mm, options.ridge_period, options.max_size) == (None, None, None)
        require(scale and lights is None, "--shading gives lights and scale: leave out the options that give others.")
        shading = read_shading(options.shading)
        lights, px_per_mm = shading.direction, 1.0 / shading.pitch_mm
    require(
        rig_file is None or rig_file.suffix.lower() == ".json",
        f"--rig must name a rig file (.json), not '{rig_file}'; name a list of lights with --lights.",
    )
    found = capture_from_photographs(
        options.images,
        lights,
        px_per_mm,
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
            options.flat,
            options.shading,
            getattr(options, "nir", None),
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
    clouds = [file for file in options.files if file.suffix.lower() in _CLOUDS]
    if options.fingers is not None:
        require(options.people is None and len(options.files) < 2, "--fingers takes one capture, or --images of one.")
        _check_rig_captures(options)
        return _import_fingers(options)
    if clouds:
        require(len(options.files) == 1, "point clouds are imported one at a time: each makes a result folder.")
        return _import_cloud(options, clouds[0])
    refuse_given(options, ("unit", "up", "pitch"), f"goes with a point cloud ({', '.join(_CLOUDS)}).")
    if options.images is None:
        return _import_prints(options)
    _check_rig_captures(options)
    return _import_people(options) if options.people is not None else _import_photos(options)


def _check_rig_captures(options: argparse.Namespace) -> None:
    """Refuse options that lack their partner; a finger is skin."""
    refuse_given(options, () if options.table else _CIRCLE, "goes with --table.")
    require(options.table is None or options.lights is None, "--table and --lights both give the lights; choose one.")
    require(options.table is None or options.px_per_mm is not None, "--table needs the scale; give --px-per-mm.")
    require(options.people is not None or not options.dry_run, "--dry-run goes with --people.")
    if options.images is not None and (options.nir, options.people, options.fingers) != (None, None, None):
        options.material = options.material or "skin"


def _with_table(options: argparse.Namespace, images: Path) -> argparse.Namespace:
    """The options, with the rig that the table of tips gives to photographs of this size in place of the scale."""
    if options.table is None:
        return options
    from splitknit.calibration.lights_found import LightsJob
    from splitknit.calibration.lights_job import lights_to_rig
    from splitknit.io.photos import read_photo
    from splitknit.io.plain import photographs_in

    found, _, _ = photographs_in(images, options.table)
    require(len(found) > 0, f"{images} holds no photographs.")
    rows, columns = read_photo(found[0]).pixels.shape[:2]
    circle = {name: getattr(options, name) for name in _CIRCLE}
    scale = 10.0 * options.px_per_mm
    job = LightsJob(table=options.table, px_per_cm=scale, image_size=f"{rows},{columns}", **circle)
    return argparse.Namespace(**{**vars(options), "lights": lights_to_rig(job).rig, "px_per_mm": None})


def _import_people(options: argparse.Namespace) -> Outcome:
    from splitknit.capture.enrolment import PLAN_FILE, open_enrolment, plan_enrolment
    from splitknit.capture.tree import read_tree
    from splitknit.errors import BadInput
    from splitknit.io.capture import write_capture

    check_photo_options(options)
    require(options.crossed is None and options.mosaic is None, "--people takes neither --crossed nor --mosaic.")
    tree = read_tree(options.people, [str(one) for one in (options.images, options.nir) if one is not None])
    enrolment = plan_enrolment(options.out, **tree.plan)
    require(
        not (options.out / PLAN_FILE).is_file() or plan_enrolment(options.out).plan == enrolment.plan,
        f"'{options.out}' is a population of other people, sessions or fingers than this tree; name another folder.",
    )
    waiting = [one for one in tree.captures if options.overwrite or not enrolment.finished(one[0])]
    faults, written = list(tree.faults), 0
    notes: dict[str, None] = {}
    if waiting and not options.dry_run:
        options = _with_table(options, waiting[0][1][0])
        with Progress(options) as progress:
            for k, (place, (images, *nir)) in enumerate(waiting):
                progress.update(place.words, k / len(waiting))
                own = argparse.Namespace(**{**vars(options), "images": images, "nir": nir[0] if nir else None})
                about = {"id": place.subject, "finger": place.finger, "session": place.session}
                try:
                    capture, told = capture_of_photographs(own)
                except BadInput as error:
                    faults.append(f"{place.words}: {error}")
                    continue
                open_enrolment(options.out, **tree.plan)
                notes |= dict.fromkeys(told)
                write_capture(replace(capture, subject=about), enrolment.path(place), overwrite=options.overwrite)
                written += 1
    why = " ".join(faults[len(tree.faults) :][:1] or faults[:1])
    require(bool(written or options.dry_run or enrolment.folder.exists()), f"nothing was written: {why}")
    there, planned = len(tree.captures) - len(waiting), enrolment.plan.total
    facts: dict[str, Any] = {"out": str(options.out), "dry_run": options.dry_run, **tree.plan, "faults": faults}
    facts |= {"notes": list(notes), "planned": planned, "written": written, "there_already": there}
    facts["captures"] = {place.folder: [str(path) for path in paths] for place, paths in tree.captures}
    lines = [f"{place.folder}: {', '.join(map(str, paths))}" for place, paths in waiting if options.dry_run]
    did = f"{len(waiting)} would be written" if options.dry_run else f"{written} written to {options.out}"
    lines += [f"{planned} captures planned, {len(tree.captures)} complete: {did}, {there} there already."]
    lines += [f"Please note: {one}" for one in (*faults, *notes)]
    return facts, [*lines, f"Next: splitknit batch {options.out} --out STORE"]


def _import_cloud(options: argparse.Namespace, file: Path) -> Outcome:
    from splitknit.io.clouds import read_cloud
    from splitknit.io.provenance import file_hash
    from splitknit.io.targets import check_target
    from splitknit.report.result import write_results
    from splitknit.scanners.cloud import CloudView, result_of_cloud

    taken = ("tip_direction", "material", "overwrite", "film_angle", "unit", "up", "pitch")
    of_others = (*_OF_PHOTOGRAPHS, "light_frame", "px_per_mm", "ridge_period", "input_ppi")
    refuse_given(options, [name for name in of_others if name not in taken], "does not go with a point cloud.")
    tip, pitch = options.tip_direction, options.pitch
    require(tip is None or abs(tip) <= 360.0, "--tip-direction must be an angle from -360 to 360 degrees, 0 = up.")
    require(pitch is None or 1e-4 <= pitch <= 10.0, f"--pitch must be millimetres from 0.0001 to 10, not {pitch}.")
    require(
        options.overwrite or not options.out.exists(), f"'{options.out}' exists; give --overwrite, or another --out."
    )
    check_target(options.out, "height.npz", "an earlier result", keep=file)
    view = CloudView(options.up, pitch, tip, options.material or "skin")
    with Progress(options) as progress:
        progress.update("reading", 0.1)
        cloud = read_cloud(file, options.unit)
        progress.update("surface", 0.4)
        result = naming(file, lambda: result_of_cloud(cloud, view))
        progress.update("writing", 0.7)
        result = replace(result, hashes={file.name: file_hash(file)})
        facts = write_results(result, None, options.out)
    about, (rows, columns) = result.facts["cloud"], result.mask.shape
    return {**facts, "out": str(options.out)}, [
        f"{about['points']:,} points ({about['format']}, {about['grid']}) are {columns} x {rows} pixels of "
        f"{1000 * result.pitch_mm:.1f} um, {result.mask.sum() * result.pitch_mm**2:.0f} mm2, seen against "
        f"{' '.join(f'{one:g}' for one in about['towards_viewer'])} ({about['found_by']}); written to {options.out}.",
        *(f"Please note: {note}" for note in result.warnings),
        f"Next: splitknit print {options.out} --out PRINT, splitknit view {options.out}",
    ]


def _import_fingers(options: argparse.Namespace) -> Outcome:
    """Cut a view of several fingers into a capture folder of each."""
    from splitknit.finger.hand import fingers_apart  # verbs import what they need
    from splitknit.io.capture import read_capture, write_capture
    from splitknit.io.targets import check_capture

    check_photo_options(options)
    names = options.fingers if options.fingers in ("auto", "left", "right") else options.fingers.split(",")
    with Progress(options) as progress:
        progress.update("reading", 0.1)
        if options.images is None:
            capture, notes = read_capture(options.files[0]), list[str]()
        else:
            capture, notes = capture_of_photographs(_with_table(options, options.images))
        progress.update("fingers", 0.5)
        found = {options.out / name: one for name, one in fingers_apart(capture, names).items()}
        for place in found:
            check_capture(place, overwrite=options.overwrite, keep=options.images or options.files[0])
        for place, one in found.items():
            write_capture(one, place, overwrite=options.overwrite)
    facts = {"out": str(options.out), "fingers": {place.name: list(one.shape) for place, one in found.items()}}
    lines = [f"{one.shape[1]} x {one.shape[0]} pixels written to {place}." for place, one in found.items()]
    lines += [f"Please note: {note}" for note in notes]
    return {**facts, "notes": notes}, [*lines, f"Next: splitknit reconstruct {next(iter(found))} --out RESULT"]


def _import_prints(options: argparse.Namespace) -> Outcome:
    """Write the prints of other systems."""
    from splitknit.cli.export import export_words  # verbs import what they need
    from splitknit.gallery.records import Exporting, import_records

    check_photo_options(options)
    of_rigs = ("nir", "table", "people", "dry_run", "keep", "overwrite")
    refuse_given(
        options, (*of_rigs, "tip_direction", "light_frame", "px_per_mm", "ridge_period"), "goes with --images."
    )
    settings = Exporting(input_ppi=options.input_ppi)
    with Progress(options) as progress:
        facts = import_records(options.files, options.out, settings, progress=progress.update)
    return facts, export_words(facts)


def _import_photos(options: argparse.Namespace) -> Outcome:
    from splitknit.io.capture import write_capture
    from splitknit.io.targets import check_capture

    check_photo_options(options)
    for folder in (options.images, *([options.crossed] if options.crossed else [])):
        keep = folder.parent if "{light}" in folder.name else folder
        check_capture(options.out, overwrite=options.overwrite, keep=keep)
    with Progress(options) as progress:
        progress.update("reading", 0.1)
        capture, notes = capture_of_photographs(_with_table(options, options.images))
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
    facts["nir"] = len(capture.bands["nir"].leds) if "nir" in capture.bands else 0
    kind = "colour" if channels == 3 else "grey"
    if facts["polarised"]:
        kind = f"parallel and {count} crossed {kind}"
    scale = f"{camera.px_per_mm:g} px/mm" if camera.scale_known else "scale unknown"
    covered = "no mask" if capture.mask is None else f"the mask covers {100 * capture.mask.mean():.0f} %"
    kind += f" and {facts['nir']} near-infrared" if facts["nir"] else ""
    lines = [
        f"{count} {kind} photographs of {columns} x {rows} pixels ({capture.encoding}, {capture.material}, {scale}, "
        f"{covered}) written to {options.out}.",
        *(f"Please note: {note}" for note in notes),
        f"Next: splitknit reconstruct {options.out} --out RESULT",
    ]
    return facts, lines
