"""Photographs in, a capture folder out; a view of several fingers, a capture folder of each. Prints
are read by what is registered for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from splitknit.arguments import AnyPath, Progress, Report, ResolutionPpi, Ridges, silent
from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.folders import capture_of
from splitknit.io.photographs import NO_PHOTOGRAPHS, OF_CAPTURES, AllPhotographs, GivenPhotographs
from splitknit.registry import IMPORTS, MATCH, extension


def import_files(
    files: Sequence[AnyPath] = (),
    *,
    out: AnyPath,
    nir: AnyPath | None = None,
    fingers: str | None = None,
    keep: bool = False,
    overwrite: bool = False,
    resolution_ppi: ResolutionPpi = None,
    ridges: Ridges = None,
    photographs: AllPhotographs = NO_PHOTOGRAPHS,
    progress: Progress = silent,
) -> Report:
    """Turn photographs and light directions into a capture folder (`images`), or prints of other
    systems into PNG.

    Parameters
    ----------
    files
        WSQ, ISO 19794-4, ANSI/NIST-ITL, PNG, TIFF, JPEG, BMP: each print becomes a PNG with its
        resolution; ISO 19794-2, ANSI 378: the minutiae of each finger become an ISO 19794-2 file;
        match, enroll, identify take all of them as they are.
    out
        Folder to write.
    nir
        Near-infrared photographs: a folder, or a pattern as for `images`; their lights are the NIR
        LEDs of a rig file, else lights.txt in that folder.
    fingers
        `images`, or the capture folder FILES, show several fingers side by side: each becomes a
        capture in `out`; left, right: index to little finger of that hand; auto: the hand follows
        from their tips; else names from left to right, such as right_middle,right_index.
    keep
        Keep a hand of `fingers` that the tips contradict.
    overwrite
        Replace an earlier capture in `out`.
    photographs
        What is known of photographs.

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        Naming the argument or the file at fault; nothing is written.

    Examples
    --------
    >>> photographs = GivenPhotographs("photos", "lights.txt", px_per_mm=20.0)
    >>> import_files(out="capture", photographs=photographs).facts["images"]  # doctest: +SKIP
    7
    """
    images = photographs.images
    require(
        images is None or not files,
        "photographs (`images` DIR) and prints (FILES ...) are imported one after the other.",
    )
    require(
        images is not None or files,
        "name photographs (`images` DIR `lights` FILE) or files of prints to import.",
    )
    skin = (nir, fingers) != (None, None)  # a finger is
    material = photographs.material or ("skin" if skin else None)
    known = replace(photographs, nir=nir, material=material)
    if fingers is not None:
        require(len(files) < 2, "`fingers` takes one capture, or `images` of one.")
        photographs.refuse_without_images(*OF_CAPTURES)
        folder = Path(files[0] if images is None else images)
        return _import_fingers(
            folder, known, Path(out), fingers, keep=keep, overwrite=overwrite, progress=progress
        )
    require(not keep, "`keep` goes with `fingers`.")
    if images is None:
        require(nir is None, "`nir` goes with `images`.")
        require(not overwrite, "`overwrite` goes with `images`.")
        photographs.refuse_without_images()
        import_prints = extension(IMPORTS, "prints", "the import of prints", MATCH)
        return import_prints(files, out, resolution_ppi, ridges, progress)  # type: ignore[no-any-return]
    return _import_photographs(known, Path(out), overwrite=overwrite, progress=progress)


def _import_fingers(
    folder: Path,
    photographs: GivenPhotographs,
    out: Path,
    fingers: str,
    *,
    keep: bool,
    overwrite: bool,
    progress: Progress,
) -> Report:
    """Cut a view of several fingers into a capture folder of each."""
    from splitknit.finger.hand import fingers_apart
    from splitknit.io.capture import read_capture, write_capture
    from splitknit.io.targets import check_capture

    names = fingers if fingers in ("auto", "left", "right") else fingers.split(",")
    progress("reading", 0.1)
    notes: list[Finding] = []
    if photographs.images is None:
        capture = read_capture(folder)
    else:
        capture, notes = capture_of(photographs)
    progress("fingers", 0.5)
    captures = {out / name: part for name, part in fingers_apart(capture, names, keep=keep).items()}
    for place in captures:
        check_capture(place, overwrite=overwrite, keep=folder)
    for place, part in captures.items():
        write_capture(part, place, overwrite=overwrite)
    written = [
        f"{part.shape[1]} x {part.shape[0]} pixels written to {place}."
        for place, part in captures.items()
    ]
    facts = {
        "out": str(out),
        "fingers": {place.name: list(part.shape) for place, part in captures.items()},
    }
    return _report(facts, written, notes, next(iter(captures)))


def _import_photographs(
    photographs: GivenPhotographs, out: Path, *, overwrite: bool, progress: Progress
) -> Report:
    from splitknit.io.capture import write_capture
    from splitknit.io.photograph_files import home_of
    from splitknit.io.targets import check_capture

    for folder in (photographs.images, photographs.crossed):
        if folder is not None:
            check_capture(out, overwrite=overwrite, keep=home_of(Path(folder)))
    progress("reading", 0.1)
    capture, notes = capture_of(photographs)
    progress("writing", 0.7)
    write_capture(capture, out, overwrite=overwrite)
    camera = capture.rig.camera
    images, rows, columns, channels = capture.bands["white"].pixels.shape
    nir = len(capture.bands["nir"].leds) if "nir" in capture.bands else 0
    facts: dict[str, Any] = {
        "out": str(out),
        "images": images,
        "polarised": "white_crossed" in capture.bands,
        "image_size": [rows, columns],
        "channels": channels,
        "encoding": capture.encoding,
        "material": capture.material,
        "px_per_mm": camera.measured_px_per_mm,
        "mask": capture.mask is not None,
        "nir": nir,
    }
    kind = (
        f"parallel and {images} crossed"
        if facts["polarised"]
        else "colour"
        if channels == 3
        else "grey"
    )
    kind += f" and {nir} near-infrared" if nir else ""
    covered = (
        "no mask" if capture.mask is None else f"the mask covers {100 * capture.mask.mean():.0f} %"
    )
    how = f"{capture.encoding}, {capture.material}, {camera.scale}, {covered}"
    written = f"{images} {kind} photographs of {columns} x {rows} pixels ({how}) written to {out}."
    return _report(facts, [written], notes, out)


def _report(
    facts: dict[str, Any], written: Sequence[str], notes: Sequence[Finding], following: Path
) -> Report:
    sentences = [str(note) for note in notes]
    lines = [*written, *(f"Please note: {note}" for note in sentences)]
    return Report(
        {**facts, "notes": sentences},
        (*lines, f"Next: splitknit reconstruct {following} --out RESULT"),
    )
