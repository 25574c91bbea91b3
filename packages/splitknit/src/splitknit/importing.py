"""Photographs in, a capture folder out. Prints are read by what is registered for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from splitknit.arguments import AnyPath, Progress, Report, ResolutionPpi, Ridges, silent
from splitknit.errors import require
from splitknit.folders import capture_of
from splitknit.io.photographs import NO_PHOTOGRAPHS, AllPhotographs, GivenPhotographs
from splitknit.registry import IMPORTS, MATCH, extension


def import_files(
    files: Sequence[AnyPath] = (),
    *,
    out: AnyPath,
    nir: AnyPath | None = None,
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
    if images is None:
        require(nir is None, "`nir` goes with `images`.")
        require(not overwrite, "`overwrite` goes with `images`.")
        photographs.refuse_without_images()
        import_prints = extension(IMPORTS, "prints", "the import of prints", MATCH)
        return import_prints(files, out, resolution_ppi, ridges, progress)  # type: ignore[no-any-return]
    known = replace(photographs, nir=nir)
    return _import_photographs(known, Path(out), overwrite=overwrite, progress=progress)


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
    sentences = [str(note) for note in notes]
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
        "notes": sentences,
    }
    kind = "colour" if channels == 3 else "grey"
    if facts["polarised"]:
        kind = f"parallel and {images} crossed"
    kind += f" and {nir} near-infrared" if nir else ""
    covered = (
        "no mask" if capture.mask is None else f"the mask covers {100 * capture.mask.mean():.0f} %"
    )
    how = f"{capture.encoding}, {capture.material}, {camera.scale}, {covered}"
    lines = (
        f"{images} {kind} photographs of {columns} x {rows} pixels ({how}) written to {out}.",
        *(f"Please note: {sentence}" for sentence in sentences),
        f"Next: splitknit reconstruct {out} --out RESULT",
    )
    return Report(facts, lines)
