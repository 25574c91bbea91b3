"""Fingers in, records, images and meshes for other systems out; and prints of other systems in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import AnyPath, Limits, Preset, Progress, Report, checked, count, silent
from splitknit.errors import BadInput, require

PrintFormat = Literal[
    "iso-19794-2", "ansi-378", "ansi-378-2009", "iso-19794-4", "iso-39794-4", "wsq", "png", "tiff", "stl", "obj", "glb",
    "lp",
]  # fmt: skip


def _number(kind: Any, tokens: Sequence[Any]) -> int:
    try:
        return int(tokens[0].value, 0)
    except ValueError as error:
        raise BadInput(f"'{tokens[0].value}' must be a number such as 0x0103") from error


Owner = Annotated[int, Limits(1, 65535), Parameter(converter=_number, n_tokens=1)]


@checked
def export_fingers(
    sources: Sequence[AnyPath],
    *,
    to: PrintFormat,
    out: AnyPath,
    finger: str | None = None,
    impression: str | None = None,
    compression: Literal["none", "png", "wsq", "jp2"] = "none",
    owner: Owner = 0x0103,
    minutiae: Literal["phase", "mindtct"] = "phase",
    input_ppi: float | None = None,
    preset: Preset = "metric",
    progress: Progress = silent,
) -> Report:
    """Write fingers as records, images and meshes that other systems read.

    Parameters
    ----------
    sources
        Prints (PNG, TIFF, JPEG, BMP, WSQ, ISO 19794-4, ANSI/NIST-ITL), records of minutiae (ISO 19794-2, ANSI 378),
        captures, results and folders of 'splitknit print'.
    to
        Minutiae: iso-19794-2 (of 2005), ansi-378 (of 2004), ansi-378-2009; pictures: iso-19794-4 (of 2005),
        iso-39794-4 (of 2019, with the print's quality), wsq, png, tiff; surfaces of captures and results: stl, obj (mm;
        obj and glb need the extra mesh), glb (metres); the lights of captures, for RTI: lp.
    out
        Folder to write, one file a finger.
    finger
        Such as right_index, for all sources (default: as they state).
    impression
        Such as live_rolled or nonlive_plain (default: as they state, else contactless for surfaces, live_plain for
        prints).
    compression
        Of iso-19794-4 and iso-39794-4 (jp2: JPEG 2000 without loss; wsq loses a little).
    owner
        IBIA's number of who makes the records (0x0103 is not registered).
    minutiae
        How they are found: by the phase of the ridges, or by NIST's mindtct (extra minutiae).
    input_ppi
        Pixels per inch of prints whose files do not state it; where they do, it is taken all the same.
    preset
        How captures are reconstructed.

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
    >>> export_fingers(["result"], to="iso-19794-2", out="records").facts["files"][0]["minutiae"]  # doctest: +SKIP
    48
    """
    from splitknit_match.prints.export import export_meshes, export_records

    places = [Path(source) for source in sources]
    if to in ("stl", "obj", "glb", "lp"):
        facts = export_meshes(places, Path(out), to, preset, progress)
    else:
        facts = export_records(
            places, Path(out), to=to, finger=finger, impression=impression, compression=compression, owner=owner,
            minutiae=minutiae, input_ppi=input_ppi, preset=preset, progress=progress,
        )  # fmt: skip
    return Report(facts, _lines(facts))


def import_prints(files: Sequence[AnyPath], out: AnyPath, input_ppi: float | None, progress: Progress) -> Report:
    """Write prints of other systems as PNG, their minutiae as ISO/IEC 19794-2: a part of ``splitknit import``.

    Raises BadInput, naming the file at fault.
    """
    from splitknit_match.prints.export import export_records

    places = [Path(file) for file in files]
    for file in places:
        cure = f"photographs of a folder are imported by `images` {file} `lights` FILE"
        require(not file.is_dir(), f"'{file}' is a folder; {cure}.")
    facts = export_records(places, Path(out), input_ppi=input_ppi, progress=progress)
    return Report(facts, _lines(facts))


def _lines(facts: dict[str, Any]) -> tuple[str, ...]:
    """For people, of an export or an import."""
    files = facts["files"]
    minutiae = [file["minutiae"] for file in files if "minutiae" in file]
    mean = f", {sum(minutiae) / len(minutiae):.0f} minutiae in the mean" if minutiae else ""
    first = f" ({files[0]['file']}{' ...' if len(files) > 1 else ''})"
    lines = [f"Wrote {count(len(files), 'file')} and export.json to {facts['out']}{first}{mean}."]
    if "vertices" in files[0]:
        lines.append(f"{files[0]['vertices']:,} vertices, {files[0]['faces']:,} triangles, in mm.")
    if "relief_roughness" in files[0]:
        rough = files[0]["relief_roughness"]
        heights = f"Sa {rough['Sa_um']:.1f} um, Sq {rough['Sq_um']:.1f} um, Sz {rough['Sz_um']:.0f} um"
        lines.append(f"Relief: {heights}, Sdr {rough['Sdr_percent']:.1f} %.")
    lines += [f"Please note: {file['file']}: {file['note']}" for file in files if "note" in file]
    failed = facts["failures_to_acquire"]
    if failed:
        failures = f"{count(len(failed), 'file')} without minutiae (failure to acquire)"
        lines.append(f"Please note: {failures}: {failed[0]} ...")
    return tuple(lines)
