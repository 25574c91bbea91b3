"""What is matched, as it comes: captures, results, templates, prints, and minutiae of other
systems."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from splitknit import BadInput, Capture, Reconstruction
from splitknit.errors import naming, require
from splitknit.files import open_file
from splitknit.findings import Finding, Severity
from splitknit.io.fields import converted, read_json
from splitknit.model import Progress, no_progress
from splitknit.reconstruction import Surface, surface_of
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.ridge_band import print_band
from splitknit_match.matching.surface import surface_template
from splitknit_match.matching.template import (
    LEAST_MM2,
    VERSION,
    Template,
    failed_template,
    inverted,
    make_template,
    pack,
    unpack,
    with_minutiae,
)
from splitknit_match.prints.minutiae import at_500_ppi
from splitknit_match.prints.photo_finger import PhotoFinger
from splitknit_match.records.minutiae_record import (
    PPI,
    Minutiae,
    holds_minutiae,
    no_minutiae,
    pack_minutiae,
    unpack_minutiae,
)
from splitknit_match.records.templates import HEADER_BYTES, MAGIC, decode_template, read_template

if TYPE_CHECKING:
    from splitknit_match.prints.pressed import PressedRidges
    from splitknit_match.records.pictures import PrintFile

_LEAST_OF_PRINTS_MM2 = LEAST_MM2 / 3
"""Of a print a third of the area suffices that surfaces need: small sensors show little, and show
it sharply. Source: derived; a third is judgement."""


class _PrintReport(Struct):
    """What counts of the report of a print's folder."""

    method: str = "file"
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of the two that are compared."""

    path: Path
    kind: str
    """``capture``, ``result``, ``template``, ``print``, ``photo`` (of a finger) or ``minutiae``."""
    surface: Surface | None = field(default=None, repr=False)
    template: Template | None = field(default=None, repr=False)
    """Template of its ridges; None where only minutiae are known."""
    picture: NDArray[np.uint8] | None = field(default=None, repr=False)
    """(H, W) of a print, at 500 ppi; of a photograph, unrolled."""
    minutiae: Minutiae | None = field(default=None, repr=False)
    """Minutiae of a record, a template, or a folder that ``splitknit print`` wrote."""
    findings: tuple[Finding, ...] = ()
    """What a photograph was taken for, what was changed of a print on reading, and a doubt where
    its resolution cannot be right; each names the path."""
    quality: float | None = None
    """Of a photograph, 0 to 100."""
    prepared: Prepared | None = field(default=None, repr=False)
    """The template, where the caller prepared it."""

    @property
    def doubt(self) -> Finding | None:
        """Why the resolution of a print cannot be right."""
        return next((each for each in self.findings if each.severity == Severity.DOUBT), None)

    @property
    def either(self) -> bool:
        """Whether its ridges may be light: then both readings of it are compared."""
        return any(each.code == "unknown-polarity" for each in self.findings)

    def reading(self, *, light: bool) -> Side:
        """The side whose ridges are taken for dark, or for light, which is no more in doubt."""
        from splitknit_match.prints.from_file import WHITE_RIDGES  # a template needs none of it

        findings = tuple(each for each in self.findings if each.code != "unknown-polarity")
        if not light or self.template is None or self.picture is None:
            return replace(self, findings=findings)
        return replace(
            self,
            template=inverted(self.template),
            picture=255 - self.picture,
            findings=(*findings, WHITE_RIDGES.of_file(self.path)),
        )

    @property
    def payload(self) -> bytes:
        """Bytes of its template file."""
        if self.template is not None:
            return pack(with_print(self).template or self.template)
        assert self.minutiae is not None
        return pack_minutiae(self.minutiae)


@dataclass(frozen=True, slots=True, eq=False)
class Pixels:
    """A print without a file."""

    image: NDArray[np.uint8] = field(repr=False)
    """(H, W)."""
    resolution_ppi: float
    ridges: str | None = "dark"
    """Or ``light``; None where it is not known."""
    impression: str = "unknown"

    @property
    def sha256(self) -> str:
        """Hash of size, resolution and pixels."""
        head = f"{self.image.shape} {self.resolution_ppi}\n".encode("ascii")
        return hashlib.sha256(head + self.image.tobytes()).hexdigest()


Held = Reconstruction | Capture | Pixels | bytes | Prepared
"""A finger without a file: `bytes` are the payload of a template."""


def held(finger: Any, resolution_ppi: Any = None, ridges: str | None = None) -> Path | Held:
    """A finger as a caller has it: a path, other objects, or the pixels (H, W) of a print, of a
    known resolution, whose ridges are dark unless `ridges` is ``light``.

    Raises BadInput if it is nothing of these, or pixels come without their resolution.
    """
    if isinstance(finger, str | os.PathLike):
        return Path(finger)
    if not isinstance(finger, np.ndarray):
        require(
            isinstance(finger, Held),
            "a finger is a path, a Reconstruction, a Capture, an array (H, W) uint8 with"
            f" `resolution_ppi`, or bytes of a template, not {type(finger).__name__}.",
        )
        if isinstance(finger, bytes) and finger.startswith(MAGIC):
            return decode_template(finger, VERSION)
        return finger  # type: ignore[no-any-return]
    require(
        finger.ndim == 2 and finger.dtype == np.uint8,
        f"the array of a print must be (H, W) uint8, ridges dark, but it is {finger.shape}"
        f" {finger.dtype}.",
    )
    if resolution_ppi is None:
        raise BadInput(
            "an array of pixels does not state its resolution; give it: `resolution_ppi` 500."
        )
    from splitknit_match.prints.from_file import MAX_PPI, MIN_PPI  # a template needs none of it

    require(
        isinstance(resolution_ppi, int | float) and MIN_PPI <= resolution_ppi <= MAX_PPI,
        f"`resolution_ppi` must lie in {MIN_PPI:g} to {MAX_PPI:g}, but it is {resolution_ppi!r}.",
    )
    return Pixels(np.ascontiguousarray(finger), float(resolution_ppi), ridges or "dark")


def read_side(  # noqa: PLR0911 - one for each kind
    finger: Path | Held,
    preset: str,
    progress: Progress = no_progress,
    resolution_ppi: float | None = None,
    *,
    ridges: str | None = None,
    where: PhotoFinger | None = None,
) -> Side:
    """Read one side, whatever it is, and make its template; `resolution_ppi` and `ridges` as for
    prints in ``prints.from_file``.

    `where`: which finger of a photograph. Raises BadInput if it is none of these, or cannot be
    read, or no photograph though `where` chooses.
    """
    if where is not None and where.chosen:
        name = f"'{finger}'" if isinstance(finger, Path) else "what is not a file"
        require(
            is_photo(finger),
            f"`mask` and `box` choose the finger of a photograph in colour; {name} is none.",
        )
    if isinstance(finger, bytes):
        return _template_side(Path("template"), finger)
    if isinstance(finger, Prepared):
        return Side(Path("template"), "template", template=finger.template, prepared=finger)
    if isinstance(finger, Pixels):
        from splitknit_match.prints.from_file import prepared  # a template needs none of it
        from splitknit_match.records.pictures import PrintFile

        item = PrintFile(finger.image, finger.resolution_ppi, {}, impression=finger.impression)
        return _print_side(Path("array"), prepared(item, finger.ridges))
    if isinstance(finger, Capture):
        finger = _reconstructed(finger, preset, progress)
    if isinstance(finger, Reconstruction):
        return _surface_side(Path("reconstruction"), "result", surface_of(finger))
    progress(f"reading {finger.name}", 0.1)
    require(
        os.path.exists(finger),  # noqa: PTH110 - false for a name that no file can have
        f"there is no '{finger}'; name a capture folder, a result folder, a template (.skt), a"
        " print or a record of minutiae.",
    )
    if finger.is_dir():
        return _folder_side(finger, preset, progress)
    if finger.suffix.lower() == ".npz":
        return _surface_side(finger, "result", read_surface(finger))
    if finger.suffix.lower() == ".skt":
        payload = read_template(finger, VERSION)
        return naming(finger, lambda: _template_side(finger, payload))
    from splitknit_match.prints.fingerphoto import fingerphoto, read_fingerphoto
    from splitknit_match.prints.from_file import minutiae_of, read_one_finger
    from splitknit_match.records.minutiae_record import FingerView  # a template needs none of it

    photo = fingerphoto(finger)
    if photo is not None:
        source = read_fingerphoto(
            finger, None if resolution_ppi is None else resolution_ppi / 25.4, where, photo
        )
        template = print_template(
            source.flat,
            pressed=source.pressed,
            kind="photo" if resolution_ppi is None else "scaled photo",
        )
        findings = tuple(each.of_file(finger) for each in source.findings)
        return Side(
            finger, "photo", None, template, source.flat, findings=findings, quality=source.quality
        )
    record = read_one_finger(finger, resolution_ppi, ridges)
    if isinstance(record, FingerView):
        return naming(finger, lambda: Side(finger, "minutiae", minutiae=minutiae_of(record)))
    return _print_side(finger, record)


def side_reader(
    finger: Any, preset: str, resolution_ppi: float | None, ridges: str | None
) -> Callable[[Progress], Side]:
    """What reads a finger as a caller has it, once its progress can be reported."""
    return lambda progress: read_side(
        held(finger, resolution_ppi, ridges), preset, progress, resolution_ppi, ridges=ridges
    )


def _folder_side(folder: Path, preset: str, progress: Progress) -> Side:
    """What ``splitknit print`` or ``reconstruct`` wrote, or a capture."""
    if (folder / "map.npz").is_file() and (folder / "print.png").is_file():
        from splitknit_match.prints.fingerphoto import PHOTOGRAPH
        from splitknit_match.prints.from_file import (
            minutiae_of,
            read_print_folder,
            resolution_doubt,
        )
        from splitknit_match.prints.sources import SCALE_OF_RIDGES

        picture, view = read_print_folder(folder)
        report = folder / "report.json"
        about = (
            converted(read_json(report)[0], _PrintReport, str(report))
            if report.is_file()
            else _PrintReport()
        )
        assumed = {finding.code for finding in about.findings} & {PHOTOGRAPH, SCALE_OF_RIDGES}
        kind = "photo" if assumed else "print" if about.method == "file" else "contactless"
        # else it is measured by a calibrated camera
        doubt = None if kind == "contactless" else resolution_doubt(picture)
        if doubt is not None:
            picture = replace(picture, findings=(*picture.findings, doubt))
        return _print_side(folder, picture, None if view is None else minutiae_of(view), kind)
    if (folder / "height.npz").is_file():
        return _surface_side(folder, "result", read_surface(folder / "height.npz"))
    from splitknit import read_capture
    from splitknit.io.capture import photographs_hint  # a template needs none of it

    require(
        (folder / "capture.json").is_file(),
        f"'{folder}' is neither a result (height.npz), a capture (capture.json) nor a print"
        f" (print.png); name one {photographs_hint(folder)}.",
    )
    capture = read_capture(folder)
    result = naming(folder, lambda: _reconstructed(capture, preset, progress))
    return _surface_side(folder, "capture", surface_of(result))


def _surface_side(path: Path, kind: str, surface: Surface) -> Side:
    return naming(path, lambda: Side(path, kind, surface, surface_template(surface)))


def with_print(side: Side) -> Side:
    """The side, and of a surface also its print, which others than surfaces are compared with."""
    template, surface = side.template, side.surface
    if template is None or surface is None or template.flat is not None:
        return side
    flat = replace(failed_template(), minutiae=no_minutiae())
    with contextlib.suppress(BadInput):  # no ridges, or too small to be laid flat
        flat = print_template(print_of_surface(surface), kind="contactless")
    return replace(side, template=replace(template, flat=flat))


def print_of_surface(surface: Surface) -> NDArray[np.uint8]:
    """Print (h, w) of a surface at 500 ppi, unrolled as ``splitknit print`` does.

    Raises BadInput as :func:`splitknit_match.prints.make.make_print`.
    """
    from splitknit_match.prints.make import make_print
    from splitknit_match.prints.sources import Source  # a template needs none of these

    source = Source(
        "result",
        surface.mask,
        surface.pitch_mm,
        surface.input_from_upright,
        surface.upright_size,
        ridge_mm=surface.ridge_mm,
        shape_mm=surface.shape_mm,
        x_mm=surface.x_mm,
        y_mm=surface.y_mm,
    )
    return make_print(source, "unroll").image


def _template_side(path: Path, payload: bytes) -> Side:
    if holds_minutiae(payload):
        return Side(path, "template", minutiae=unpack_minutiae(payload))
    return Side(path, "template", template=unpack(payload))


def _print_side(
    path: Path, item: PrintFile, minutiae: Minutiae | None = None, kind: str = ""
) -> Side:
    from splitknit_match.prints.from_file import print_at_500_ppi  # a template needs none of it

    kind = kind or ("contactless" if item.impression == "contactless" else "print")
    image = naming(path, lambda: print_at_500_ppi(item)).image
    findings = tuple(finding.of_file(path) for finding in item.findings)
    side = Side(path, "print", picture=image, minutiae=minutiae, findings=findings)
    try:
        template = naming(path, lambda: print_template(image, kind=kind))
    except BadInput:
        if side.doubt is None:
            raise
        template = replace(failed_template(), minutiae=no_minutiae())  # of a wrong resolution
    return replace(side, template=template)


def undoubted(side: Side) -> Side:
    """The side, whose template is to be kept. Raises BadInput if its resolution cannot be right."""
    require(side.doubt is None, f"{side.doubt} Nothing is kept of it; give the true resolution.")
    return side


def is_photo(finger: Path | Held) -> bool:
    """Whether a source is a photograph of a finger."""
    if not isinstance(finger, Path) or finger.suffix.lower() in (".skt", ".npz"):
        return False
    from splitknit_match.prints.fingerphoto import fingerphoto  # a template needs none of it

    return fingerphoto(finger) is not None


def is_of_minutiae(path: Path | Held) -> bool:
    """Whether a source is a record of minutiae, or a template that holds minutiae."""
    if not isinstance(path, Path):
        return isinstance(path, bytes) and holds_minutiae(path)
    if not path.is_file():
        return False
    with open_file(path, 1 << 50) as (stream, _):
        first = stream.read(HEADER_BYTES + 4)
    return first[:4] == b"FMR\0" or (
        first.startswith(MAGIC) and holds_minutiae(first[HEADER_BYTES:])
    )


MINUTIAE_PER_MM2 = (0.015, 1.0)
"""Density of minutiae on a finger, lowest and highest: 280 real prints have 0.06 to 0.41, squares
of 9 mm of them 0.025 to 0.72. Chosen on: real prints (280 prints of seven sensors)."""


def print_template(
    image: NDArray[np.uint8],
    ppi: float = PPI,
    *,
    pressed: PressedRidges | None = None,
    kind: str = "print",
) -> Template:
    """Template of a print (H, W), ridges dark, with its minutiae, as ``splitknit print`` finds
    them.

    `pressed`: ridges of a photograph, which are taken in place of the picture: its noise is as
    strong as they are; `kind`: as of a template. Raises BadInput if it shows
    several fingers, or as
    :func:`splitknit_match.matching.ridge_band.print_band`.
    """
    from splitknit_match.prints.from_file import SEVERAL, pressed_print
    from splitknit_match.prints.make import enhance, minutiae_by_phase
    from splitknit_match.prints.pressed import pressed_ridges
    from splitknit_match.records.pictures import PrintFile  # templates of others need none of these

    image = at_500_ppi(image, ppi)
    inside, minutiae, lacks, several = (
        np.zeros(image.shape, dtype=bool),
        no_minutiae((image.shape[0], image.shape[1])),
        "",
        False,
    )
    with contextlib.suppress(BadInput):  # no ridges: a failure to acquire
        ridges = pressed or pressed_ridges(image)
        lacks = ridges.lacks
        several = ridges.several
        finger = pressed_print(PrintFile(image, PPI, {}), pressed=ridges)
        inside = finger.weight > 0
        minutiae = minutiae_by_phase(finger, enhance(finger))
        area_mm2 = float(inside.sum()) * (25.4 / PPI) ** 2
        low, high = (rate * area_mm2 for rate in MINUTIAE_PER_MM2)
        # area of a print from which on the density of its minutiae is judged
        if area_mm2 >= 100.0 and not low < minutiae.count < high:
            lacks = (
                f"no print of a finger: {minutiae.count} lines end or fork on {area_mm2:.0f} mm²"
            )
        image = image if pressed is None else pressed.image
    require(not several, SEVERAL)
    if lacks:
        nothing = no_minutiae(minutiae.size)
        return replace(failed_template(), minutiae=nothing, kind=kind, lacks=lacks)
    band = print_band(image, PPI, inside)
    template = replace(make_template(band, _LEAST_OF_PRINTS_MM2), kind=kind)
    return with_minutiae(template, band.valid, minutiae)


def read_surface(path: Path) -> Surface:
    """Read a result's ``height.npz``. Raises BadInput if it is damaged, or an array is missing or
    of another shape."""
    from splitknit.io.results import read_fields  # a template needs none of it

    optional = ("whole", "x_mm", "y_mm")
    return Surface(**read_fields(path, ("ridge_mm", "shape_mm", "normals"), optional))


def _reconstructed(capture: Capture, preset: str, progress: Progress) -> Reconstruction:
    from splitknit import reconstruct  # a template needs none of it

    return reconstruct(
        capture, preset, progress=lambda stage, fraction: progress(stage, 0.1 + 0.7 * fraction)
    )
