"""What is matched, as it comes: captures, results, templates, prints, and minutiae of other systems."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, naming, open_file, require
from splitknit.io.templates import HEADER_BYTES, MAGIC, read_template
from splitknit.matching.minutiae import at_500_ppi
from splitknit.matching.minutiae_record import (
    PPI,
    Minutiae,
    holds_minutiae,
    no_minutiae,
    pack_minutiae,
    unpack_minutiae,
)
from splitknit.matching.ridge_band import print_band
from splitknit.matching.surface import MatchingSettings, surface_template
from splitknit.matching.template import VERSION, Template, make_template, pack, unpack, with_minutiae
from splitknit.model import Capture, Progress, Reconstruction, Surface, no_progress, surface_of


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of the two that are compared."""

    path: Path
    kind: str
    """``capture``, ``result``, ``template``, ``print``, ``photo`` (of a finger) or ``minutiae``."""
    surface: Surface | None = None
    template: Template | None = None
    """Of its ridges; None where only minutiae are known."""
    picture: NDArray[np.uint8] | None = None
    """(H, W) of a print, at 500 ppi; of a photograph, unrolled."""
    minutiae: Minutiae | None = None
    """Of a record, of a template that holds minutiae, or of a folder that ``splitknit print`` wrote."""
    note: str | None = None
    """What a photograph was taken for."""

    @property
    def payload(self) -> bytes:
        """Of its template file."""
        if self.template is not None:
            return pack(self.template)
        assert self.minutiae is not None
        return pack_minutiae(self.minutiae)


def read_side(  # noqa: PLR0911 - one for each kind
    given: Path | Reconstruction | Capture,
    preset: str,
    settings: MatchingSettings,
    progress: Progress = no_progress,
    input_ppi: float | None = None,
) -> Side:
    """Read one side, whatever it is, and make its template; `input_ppi` as for prints in ``prints.from_file``.

    Raises BadInput if it is none of these, or cannot be read.
    """
    if isinstance(given, Reconstruction | Capture):
        result = given if isinstance(given, Reconstruction) else _reconstructed(given, preset, progress)
        surface = surface_of(result)
        return Side(Path("reconstruction"), "result", surface, surface_template(surface, settings))
    path = given
    progress(f"reading {path.name}", 0.1)
    try:
        found = path.exists()
    except (OSError, ValueError):
        found = False
    require(
        found,
        f"there is no '{path}'; name a capture folder, a result folder, a template (.skt), a print "
        "or a record of minutiae.",
    )
    if path.is_dir():
        from splitknit.io.capture import photographs_hint, read_capture  # a template needs none of it

        if (path / "map.npz").is_file() and (path / "print.png").is_file():
            return _print_folder(path, settings)
        kind = "result" if (path / "height.npz").is_file() else "capture"
        known = kind == "result" or (path / "capture.json").is_file()
        require(
            known,
            f"'{path}' is neither a result (height.npz), a capture (capture.json) nor a print (print.png); name one "
            f"{photographs_hint(path)}.",
        )
        if kind == "result":
            surface = _read_surface(path / "height.npz")
        else:
            capture = read_capture(path)
            surface = surface_of(naming(path, lambda: _reconstructed(capture, preset, progress)))
        return naming(path, lambda: Side(path, kind, surface, surface_template(surface, settings)))
    if path.suffix.lower() == ".npz":
        surface = _read_surface(path)
        return naming(path, lambda: Side(path, "result", surface, surface_template(surface, settings)))
    if path.suffix.lower() == ".skt":
        payload = read_template(path, VERSION)
        if holds_minutiae(payload):
            return naming(path, lambda: Side(path, "template", minutiae=unpack_minutiae(payload)))
        return naming(path, lambda: Side(path, "template", None, unpack(payload)))
    from splitknit.io.minutiae_record import FingerView  # a template needs none of it
    from splitknit.prints.fingerphoto import is_fingerphoto
    from splitknit.prints.from_file import minutiae_of, print_at_500_ppi, read_one_finger

    if is_fingerphoto(path):
        return _photo(path, settings, input_ppi)
    finger = read_one_finger(path, input_ppi)
    if isinstance(finger, FingerView):
        return naming(path, lambda: Side(path, "minutiae", minutiae=minutiae_of(finger)))
    printed = naming(path, lambda: print_at_500_ppi(finger))
    template = naming(path, lambda: print_template(printed.image, printed.resolution_ppi or PPI, settings))
    return naming(path, lambda: Side(path, "print", None, template, printed.image))


def _photo(path: Path, settings: MatchingSettings, input_ppi: float | None) -> Side:
    """A photograph of a finger: its print, unrolled by the mean shape."""
    from splitknit.prints.fingerphoto import read_fingerphoto
    from splitknit.prints.make import make_print

    source = read_fingerphoto(path, None if input_ppi is None else input_ppi / 25.4)
    image = naming(path, lambda: make_print(source, "photo", "free").image)
    return Side(path, "photo", None, print_template(image, settings=settings), image, note=source.scale)


def _print_folder(folder: Path, settings: MatchingSettings) -> Side:
    """What ``splitknit print`` wrote: the picture, and the minutiae that were found as it was made."""
    from splitknit.prints.from_file import minutiae_of, print_at_500_ppi, read_print_folder

    picture, view = read_print_folder(folder)
    printed = naming(folder, lambda: print_at_500_ppi(picture))
    template = naming(folder, lambda: print_template(printed.image, settings=settings))
    return Side(folder, "print", None, template, printed.image, None if view is None else minutiae_of(view))


def is_of_minutiae(path: Path) -> bool:
    """Whether a source is a record of minutiae, or a template that holds minutiae."""
    if not path.is_file():
        return False
    with open_file(path, 1 << 50) as (stream, _):
        first = stream.read(HEADER_BYTES + 4)
    return first[:4] == b"FMR\0" or (first.startswith(MAGIC) and holds_minutiae(first[HEADER_BYTES:]))


def print_template(image: NDArray[np.uint8], ppi: float = PPI, settings: MatchingSettings | None = None) -> Template:
    """Template of a print (H, W), ridges dark, with its minutiae, as ``splitknit print`` finds them.

    Raises BadInput as :func:`splitknit.matching.ridge_band.print_band`.
    """
    from splitknit.io.prints import PrintFile  # templates of others need none of these
    from splitknit.prints.from_file import pressed_print
    from splitknit.prints.make import enhance, minutiae_by_phase

    settings, image = settings or MatchingSettings(), at_500_ppi(image, ppi)
    inside, minutiae = None, no_minutiae((image.shape[0], image.shape[1]))
    with contextlib.suppress(BadInput):  # no ridges: a failure to acquire
        made = pressed_print(PrintFile(image, PPI, {}))
        inside = made.weight > 0
        minutiae = minutiae_by_phase(made, enhance(made, PPI), PPI)
    band = print_band(image, PPI, settings.band, inside)
    return with_minutiae(make_template(band, settings.template), band.valid, minutiae)


def _read_surface(path: Path) -> Surface:
    """Read a result's ``height.npz``. Raises BadInput if it is damaged, or an array is missing or of another shape."""
    from splitknit.io.results import read_fields  # a template needs none of it

    arrays = read_fields(path, ("ridge_mm", "shape_mm", "normals"), ("whole",))
    return Surface(**arrays)


def _reconstructed(capture: Capture, preset: str, progress: Progress) -> Reconstruction:
    from splitknit.pipeline import reconstruct  # a template needs none of it

    return reconstruct(capture, preset, progress=lambda stage, fraction: progress(stage, 0.1 + 0.7 * fraction))
