"""Verbs of prints: ``splitknit print``, ``export``, and the prints of ``import``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import (
    AnyPath,
    Preset,
    Progress,
    Report,
    ResolutionPpi,
    Ridges,
    checked,
    count,
    refuse_given,
    silent,
)
from splitknit.errors import BadInput, naming, require
from splitknit.settings import Limits

if TYPE_CHECKING:
    from splitknit import Capture, Reconstruction
    from splitknit_match.prints.make import Print

    Finger = Reconstruction | Capture | AnyPath
else:
    Finger = AnyPath
    Print = Any

Method = Literal["relief", "unroll", "curvature", "photo", "specular", "rolled"]
PrintFormat = Literal[
    "iso-19794-2",
    "ansi-378",
    "ansi-378-2009",
    "iso-19794-4",
    "iso-39794-4",
    "wsq",
    "png",
    "tiff",
    "stl",
    "obj",
    "glb",
    "lp",
]


@checked
def make_print(finger: Finger, method: Method = "unroll", ppi: float = 500.0) -> Print:
    """Make the 2D print of a finger.

    Parameters
    ----------
    finger : Reconstruction, Capture or path
        What is printed; a capture is reconstructed first, by the preset ``metric``.
    method : {"relief", "unroll", "curvature", "photo", "specular", "rolled"}, optional
        ``photo`` needs a capture; ``rolled`` one with mirrors, as a path.
    ppi : float, optional
        Resolution in pixels per inch.

    Returns
    -------
    Print
        ``image`` (h, w) uint8, ridges dark, mirrored as ink on paper is.

    Raises
    ------
    BadInput
        If the input lacks what the method needs, or shows no ridges.

    Examples
    --------
    >>> import splitknit_match
    >>> splitknit_match.make_print("result").image.dtype  # doctest: +SKIP
    dtype('uint8')
    """
    from splitknit import Capture, Reconstruction
    from splitknit_match.prints import make
    from splitknit_match.prints.sources import read_source, source_of, source_of_capture

    photo = method == "photo"
    if method == "rolled":
        from splitknit_match.prints.rolled import print_around

        if isinstance(finger, Capture | Reconstruction):
            raise BadInput("a rolled print needs the path of a capture folder.")
        return print_around(Path(finger), "metric", "free", ppi, silent)[1]
    if isinstance(finger, Reconstruction):
        source = source_of(finger)
    elif isinstance(finger, Capture):
        source = source_of_capture(finger, photo=photo, surface=not photo)
    else:
        source = read_source(Path(finger), photo=photo, surface=not photo)
    return make.make_print(source, method, ppi=ppi)


@checked
def print_finger(
    finger: AnyPath,
    *,
    out: AnyPath,
    method: Method | None = None,
    surface: Literal["plane", "free", "arc"] | None = None,
    ppi: Literal[500, 1000] = 500,
    px_per_mm: Annotated[float, Limits(1e-3, 1e5)] | None = None,
    ridge_period_mm: Annotated[float | None, Parameter("--ridge-period")] = None,
    resolution_ppi: ResolutionPpi = None,
    ridges: Ridges = None,
    mask: AnyPath | None = None,
    box: str | None = None,
    preset: Preset = "metric",
    progress: Progress = silent,
) -> Report:
    """Turn a finger in space into a flat print of 500 pixels per inch.

    Parameters
    ----------
    finger
        Result folder, or capture folder (reconstructed first); or a print (PNG, TIFF, JPEG, BMP,
        WSQ, ISO 19794-4, ANSI/NIST-ITL), which is brought to 500 ppi, enhanced and searched for
        minutiae; or a photograph of a finger in colour, which is unrolled by a mean shape.
    out
        Folder to write the print into.
    method
        unroll: the relief on the skin laid flat (the default); relief: seen straight from above
        (the thesis's); curvature: the shape index; photo: the photograph (needs a capture);
        specular: what the surface reflects (needs polarising films); rolled: around the finger, by
        front and its mirrors (needs a capture with mirrors).
    surface
        Where it is printed: the finger plane (default, except for unroll), or the skin laid flat:
        free (least distortion, default for unroll) or arc (row by row, as photographs of fingers
        are).
    ppi
        Pixels per inch.
    px_per_mm
        Scale on the object, where the input has none.
    ridge_period_mm
        Take the scale from a finger's ridges, which lie so many mm apart: 0.45 is usual, people
        differ by 8 %.
    mask
        The finger of a photograph: an image of its size, white on the finger.
    box
        The part X,Y,W,H of a photograph in which the finger lies, pixels from its upper left.
    preset
        How captures are reconstructed.

    Returns
    -------
    Report
        The facts of ``report.json``, and ``out``.

    Raises
    ------
    BadInput
        Naming the input at fault; nothing is written.

    Examples
    --------
    >>> print_finger("result", out="print").facts["minutiae"]["count"]  # doctest: +SKIP
    53
    """
    from splitknit.io.targets import check_target
    from splitknit_match.prints import folder, make
    from splitknit_match.prints.fingerphoto import fingerphoto, read_fingerphoto
    from splitknit_match.prints.photo_finger import PhotoFinger
    from splitknit_match.prints.sources import read_source

    require(
        px_per_mm is None or ridge_period_mm is None,
        "`px_per_mm` and `ridge_period_mm` both give the scale.",
    )
    path, target, fine = Path(finger), Path(out), None if ppi == 500 else ppi
    is_file = path.is_file() and path.suffix.lower() != ".npz"
    photo = fingerphoto(path) if is_file else None
    scales = {"px_per_mm": px_per_mm, "ridge_period_mm": ridge_period_mm}
    if photo is None:
        refuse_given(
            f"chooses the finger of a photograph in colour, and '{path}' is none.",
            mask=mask,
            box=box,
        )
    if is_file and photo is None:
        refuse_given(
            f"is for a finger in space: '{path}' is a print already, to be made one of 500 ppi; "
            "leave out `method`, `surface`, `ppi` and scales.",
            method=method,
            surface=surface,
            ppi=fine,
            **scales,
        )
    if photo is not None:
        refuse_given(
            f"is not for '{path}', a photograph of a finger: its `method` is photo, "
            "its `surface` arc, its `ppi` 500, its scale `px_per_mm`.",
            method=None if method == "photo" else method,
            surface=None if surface == "arc" else surface,
            ppi=fine,
            ridge_period_mm=ridge_period_mm,
            resolution_ppi=resolution_ppi,
            ridges=ridges,
        )
        method, surface = "photo", "arc"
    method = method or "unroll"
    place = "paper" if is_file and photo is None else make.checked_surface(method, surface)
    check_target(target, "map.npz", "an earlier print", keep=path)
    around = None
    if place == "paper":
        source, printed = folder.print_of_file(path, resolution_ppi, ridges)
    elif method == "rolled":
        from splitknit_match.prints.rolled import print_around  # slow to import

        refuse_given("is measured in a rig with mirrors; leave it out.", **scales)
        source, printed, around = print_around(path, preset, place, ppi, progress)
    elif photo is not None:
        source, printed = folder.print_of_photo(
            read_fingerphoto(path, px_per_mm, PhotoFinger(mask, box), photo)
        )
    else:
        of_photo = method == "photo"
        source = read_source(
            path,
            photo=of_photo,
            surface=not of_photo or place != "plane",
            preset=preset,
            progress=progress,
            px_per_mm=px_per_mm,
            ridge_period_mm=ridge_period_mm,
        )
        progress("printing", 0.75)
        printed = naming(path, lambda: make.make_print(source, method, place, ppi))
    named = "file" if place == "paper" else method
    facts = folder.write_print(
        target, path, source, printed, method=named, around=around, progress=progress
    )
    facts["out"] = str(target)
    return Report(facts, tuple(_print_lines(facts)))


def _owner(kind: Any, tokens: Sequence[Any]) -> int:
    try:
        return int(tokens[0].value, 0)
    except ValueError as error:
        raise BadInput(f"'{tokens[0].value}' must be a number such as 0x0103") from error


@checked
def export(
    sources: Sequence[AnyPath],
    *,
    to: PrintFormat,
    out: AnyPath,
    finger: str | None = None,
    impression: str | None = None,
    compression: Literal["none", "png", "wsq", "jp2"] = "none",
    owner: Annotated[int, Limits(1, 65535), Parameter(converter=_owner, n_tokens=1)] = 0x0103,
    resolution_ppi: ResolutionPpi = None,
    ridges: Ridges = None,
    preset: Preset = "metric",
    base_mm: Annotated[float | None, Limits(0, 1000, above=True), Parameter("--base")] = None,
    progress: Progress = silent,
) -> Report:
    """Write fingers as records, images and meshes that other systems read.

    Parameters
    ----------
    sources
        Prints (PNG, TIFF, JPEG, BMP, WSQ, ISO 19794-4, ANSI/NIST-ITL), records of minutiae (ISO
        19794-2, ANSI 378), captures, results and folders of 'splitknit print'.
    to
        Minutiae: iso-19794-2 (of 2005), ansi-378 (of 2004), ansi-378-2009; pictures: iso-19794-4
        (of 2005), iso-39794-4 (of 2019, with the print's quality), wsq, png, tiff; surfaces of
        captures and results (which need the extra mesh): stl, obj (mm), glb (metres; colours in a
        texture); the lights of captures, for RTI: lp.
    out
        Folder to write, one file a finger.
    finger
        Such as right_index, for all sources (default: as they state).
    impression
        Such as live_rolled or nonlive_plain (default: as they state, else contactless for surfaces,
        live_plain for prints).
    compression
        Of iso-19794-4 and iso-39794-4 (jp2: JPEG 2000 without loss; wsq loses a little).
    owner
        IBIA's number of who makes the records (default: 0x0103, not registered).
    preset
        How captures are reconstructed.
    base_mm
        Of stl: a closed solid for a printer, whose flat base lies so many mm below the lowest
        point.

    Returns
    -------
    Report
        The facts of ``export.json``, and ``out``.

    Raises
    ------
    BadInput
        Naming the source at fault; nothing is written.

    Examples
    --------
    >>> export(["result"], to="stl", out="meshes").facts["files"]  # doctest: +SKIP
    """
    from splitknit_match.prints.export import export_records, export_surfaces

    places = [Path(source) for source in sources]
    require(base_mm is None or to == "stl", "`base_mm` is of `to` stl.")
    if to in ("stl", "obj", "glb", "lp"):
        facts = export_surfaces(
            places, Path(out), to, preset=preset, base_mm=base_mm, progress=progress
        )
    else:
        facts = export_records(
            places,
            Path(out),
            to=to,
            finger=finger,
            impression=impression,
            compression=compression,
            owner=owner,
            resolution_ppi=resolution_ppi,
            ridges=ridges,
            preset=preset,
            progress=progress,
        )
    return Report(facts, tuple(_export_lines(facts)))


def import_prints(
    files: Sequence[AnyPath],
    out: AnyPath,
    resolution_ppi: float | None,
    ridges: str | None,
    progress: Progress,
) -> Report:
    """Write prints of other systems as PNG, their minutiae as ISO/IEC 19794-2: a part of
    ``splitknit import``.

    Raises BadInput, naming the file at fault.
    """
    from splitknit_match.prints.export import export_records

    places = [Path(file) for file in files]
    for file in places:
        require(
            not file.is_dir(),
            f"'{file}' is a folder; photographs of a folder are imported by `images` {file}"
            " `lights` FILE.",
        )
    facts = export_records(
        places, Path(out), resolution_ppi=resolution_ppi, ridges=ridges, progress=progress
    )
    return Report(facts, tuple(_export_lines(facts)))


def _print_lines(facts: Mapping[str, Any]) -> list[str]:
    rows, columns = facts["size"]
    where = {
        "plane": "on the finger plane, seen straight from above",
        "free": "on the skin laid flat with the least distortion",
        "arc": "on the skin laid flat row by row",
        "paper": "as it was pressed",
    }[facts["surface"]]
    period = facts["ridge_period_mm"]["median"]
    size = f"{columns} x {rows} pixels at {facts['ppi']:g} ppi"
    ridges = f"{facts['ridge_area_mm2']:.0f} mm² of ridges, {period:.2f} mm apart"
    lines = [f"Print ({facts['method']}) of {size}, {where}: {ridges}."]
    if "rolled" in facts:
        rolled = facts["rolled"]
        reach = rolled["coverage_deg"]["median"]
        lines.append(
            f"It reaches {reach:.0f} deg around the finger, from {len(rolled['views'])} views."
        )
    if facts.get("distortion"):
        median, p95 = facts["distortion"].values()
        off = f"{median:.1f} % (median) and {p95:.1f} % (95th percentile)"
        lines.append(f"Lengths are off by {off}, whichever way is worse.")
    lines.append(f"{facts['minutiae']['count']} minutiae.")
    quality = facts["quality"]
    if "photo" not in quality:  # a photograph's finding states it
        scores = f"Quality: {quality['ours']:.0f} of 100"
        if quality["nfiq2"] is not None:
            of_print, of_enhanced = (
                "none" if value is None else value for value in quality["nfiq2"].values()
            )
            scores += f"; NFIQ 2 is {of_print} (print) and {of_enhanced} (enhanced)"
        lines.append(f"{scores}.")
    lines += [f"Please note: {finding['message']}" for finding in facts["findings"]]
    lines.append(f"Written to {facts['out']}: {', '.join(facts['files'])}.")
    return lines


def _export_lines(facts: Mapping[str, Any]) -> list[str]:
    """For people, of an export or an import."""
    files = facts["files"]
    minutiae = [file["minutiae"] for file in files if "minutiae" in file]
    mean = f", {sum(minutiae) / len(minutiae):.0f} minutiae in the mean" if minutiae else ""
    first = f" ({files[0]['file']}{' ...' if len(files) > 1 else ''})"
    lines = [f"Wrote {count(len(files), 'file')} and export.json to {facts['out']}{first}{mean}."]
    if "vertices" in files[0]:
        lines.append(f"{files[0]['vertices']:,} vertices, {files[0]['faces']:,} triangles, in mm.")
    return lines + [f"Please note: {finding['message']}" for finding in facts["findings"]]
