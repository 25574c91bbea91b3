"""A finger in, a flat print out: as an object, or as a folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import AnyPath, Limits, Preset, Progress, checked, refuse_given, silent, text_of
from splitknit.errors import BadInput, naming, require

if TYPE_CHECKING:
    from splitknit import Capture, Reconstruction
    from splitknit_match.prints.make import Print

    Finger = Reconstruction | Capture | AnyPath

Method = Literal["relief", "unroll", "curvature", "photo", "specular", "rolled"]
Surface = Literal["plane", "free", "arc"]
PxPerMm = Annotated[float, Limits(1e-3, 1e5)]
_WHERE = {
    "plane": "on the finger plane, seen straight from above",
    "free": "on the skin laid flat with the least distortion",
    "arc": "on the skin laid flat row by row",
    "paper": "as it was pressed",
}


@dataclass(frozen=True, slots=True)
class Printed:
    """What :func:`print_finger` wrote."""

    facts: dict[str, Any]
    """Those of ``report.json``, and ``out``."""

    def __str__(self) -> str:
        facts = self.facts
        rows, columns = facts["size"]
        size = f"{columns} x {rows} pixels at {facts['ppi']:g} ppi"
        ridges = f"{facts['ridge_area_mm2']:.0f} mm² of ridges, {facts['ridge_period_mm']['median']:.2f} mm apart"
        lines = [f"Print ({facts['method']}) of {size}, {_WHERE[facts['surface']]}: {ridges}."]
        if "scale" in facts:
            lines.append(f"Please note: {facts['scale']}")
        if "rolled" in facts:
            reach, views = facts["rolled"]["coverage_deg"]["median"], facts["rolled"]["views"]
            lines.append(f"It reaches {reach:.0f} deg around the finger, from {len(views)} views.")
            lines += [f"Please note: {warning}" for warning in facts["rolled"]["warnings"]]
        if facts.get("distortion"):
            figures = facts["distortion"]
            median, most = figures["length_median_percent"], figures["length_p95_percent"]
            off = f"{median:.1f} % (median) and {most:.1f} % (95th percentile)"
            lines.append(f"Lengths are off by {off}, whichever way is worse.")
        lines.append(f"{facts['minutiae']['count']} minutiae.")
        quality = facts["quality"]
        if "photo" not in quality:  # a photograph's note says it
            words = f"Quality: {quality['ours']:.0f} of 100"
            if quality["nfiq2"] is not None:
                of_print, of_enhanced = ("none" if value is None else value for value in quality["nfiq2"].values())
                words += f"; NFIQ 2 is {of_print} (print) and {of_enhanced} (enhanced)"
            lines += [f"{words}.", *quality["advice"]]
        lines.append(f"Written to {facts['out']}: {', '.join(facts['files'])}.")
        return text_of(lines)


@checked
def print_finger(
    finger: AnyPath,
    *,
    out: AnyPath,
    method: Method | None = None,
    surface: Surface | None = None,
    ppi: Literal[500, 1000] = 500,
    px_per_mm: PxPerMm | None = None,
    ridge_period_mm: Annotated[float | None, Parameter("--ridge-period")] = None,
    input_ppi: float | None = None,
    mask: AnyPath | None = None,
    box: str | None = None,
    preset: Preset = "metric",
    progress: Progress = silent,
) -> Printed:
    """Turn a finger in space into a flat print of 500 pixels per inch.

    Parameters
    ----------
    finger
        Result folder, or capture folder (reconstructed first); or a print (PNG, TIFF, JPEG, BMP, WSQ, ISO 19794-4,
        ANSI/NIST-ITL), which is brought to 500 ppi, enhanced and searched for minutiae; or a photograph of a finger in
        colour, which is unrolled by a mean shape.
    out
        Folder to write the print into.
    method
        unroll: the relief on the skin laid flat (the default); relief: seen straight from above (the thesis's);
        curvature: the shape index; photo: the photograph (needs a capture); specular: what the surface reflects (needs
        polarising films); rolled: around the finger, by front and its mirrors (needs a capture with mirrors).
    surface
        Where it is printed: the finger plane (default, except for unroll), or the skin laid flat: free (least
        distortion, default for unroll) or arc (row by row, as photographs of fingers are).
    ppi
        Pixels per inch.
    px_per_mm
        Scale on the object, where the input has none; without it heights are in pixels.
    ridge_period_mm
        Take the scale from a finger's ridges, which lie so many mm apart: 0.45 is usual, people differ by 8 %.
    input_ppi
        Pixels per inch of prints whose files do not state it; where they do, it is taken all the same.
    mask
        The finger of a photograph: an image of its size, white on the finger.
    box
        The part of a photograph in which the finger lies, X,Y,W,H in pixels from its upper left.
    preset
        How captures are reconstructed.

    Returns
    -------
    Printed

    Raises
    ------
    BadInput
        Naming the input at fault; nothing is written.

    Examples
    --------
    >>> print_finger("result", out="print").facts["minutiae"]["count"]  # doctest: +SKIP
    48
    """
    from splitknit.io.targets import check_target
    from splitknit_match.prints import folder, make
    from splitknit_match.prints.fingerphoto import fingerphoto, read_fingerphoto
    from splitknit_match.prints.photo_finger import PhotoFinger
    from splitknit_match.prints.sources import read_source

    require(px_per_mm is None or ridge_period_mm is None, "`px_per_mm` and `ridge_period_mm` both give the scale.")
    path, target, fine = Path(finger), Path(out), None if ppi == 500 else ppi
    is_file = path.is_file() and path.suffix.lower() != ".npz"
    photo = fingerphoto(path) if is_file else None
    scales = {"px_per_mm": px_per_mm, "ridge_period_mm": ridge_period_mm}
    if photo is None:
        refuse_given(f"chooses the finger of a photograph in colour, and '{path}' is none.", mask=mask, box=box)
    if is_file and photo is None:
        refuse_given(
            f"is for a finger in space: '{path}' is a print already, to be made one of 500 ppi; leave out `method`, "
            "`surface`, `ppi` and scales.",
            method=method, surface=surface, ppi=fine, **scales,
        )  # fmt: skip
    if photo is not None:
        refuse_given(
            f"is not for '{path}', a photograph of a finger: its `method` is photo, its `surface` arc, its `ppi` 500, "
            "its scale `px_per_mm`.",
            method=None if method == "photo" else method, surface=None if surface == "arc" else surface, ppi=fine,
            ridge_period_mm=ridge_period_mm, input_ppi=input_ppi,
        )  # fmt: skip
        method, surface = "photo", "arc"
    method = method or "unroll"
    place = "paper" if is_file and photo is None else make.checked_surface(method, surface)
    check_target(target, "map.npz", "an earlier print", keep=path)
    around = None
    if place == "paper":
        source, made = folder.print_of_file(path, input_ppi)
    elif method == "rolled":
        from splitknit_match.prints.rolled import print_around  # slow to import

        refuse_given("is measured in a rig with mirrors; leave it out.", **scales)
        source, made, around = print_around(path, preset, place, ppi, progress)
    elif photo is not None:
        source, made = folder.print_of_photo(read_fingerphoto(path, px_per_mm, PhotoFinger(mask, box), photo))
    else:
        of_photo = method == "photo"
        source = read_source(
            path, photo=of_photo, surface=not of_photo or place != "plane", preset=preset, progress=progress,
            px_per_mm=px_per_mm, ridge_period_mm=ridge_period_mm,
        )  # fmt: skip
        progress("printing", 0.75)
        made = naming(path, lambda: make.make_print(source, method, place, ppi))
    named = "file" if place == "paper" else method
    facts = folder.write_print(target, path, source, made, method=named, ppi=ppi, around=around, progress=progress)
    return Printed({**facts, "out": str(target)})


def make_print(finger: Finger, method: Method = "unroll", *, ppi: float = 500.0) -> Print:
    """Make the 2D print of a finger.

    Parameters
    ----------
    finger : Reconstruction, Capture or path
        A capture is reconstructed first, by the preset ``metric``.
    method : str
        As of :func:`print_finger`; ``photo`` needs a capture, ``rolled`` one with mirrors, as a path.
    ppi : float
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
