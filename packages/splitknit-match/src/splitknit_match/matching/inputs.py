"""What is matched, as it comes: captures, results, templates, prints, and minutiae of other
systems."""

from __future__ import annotations

import contextlib
import hashlib
import os
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
from splitknit.model import Progress, Surface, no_progress, surface_of
from splitknit_match.matching.parameters import JUDGED_MM2, LEAST_MM2, MINUTIAE_PER_MM2
from splitknit_match.matching.ridge_band import print_band
from splitknit_match.matching.surface import surface_template
from splitknit_match.matching.template import (
    VERSION,
    Template,
    failed_template,
    make_template,
    pack,
    unpack,
    with_minutiae,
)
from splitknit_match.prints.minutiae import at_500_ppi
from splitknit_match.prints.minutiae_record import (
    PPI,
    Minutiae,
    holds_minutiae,
    no_minutiae,
    pack_minutiae,
    unpack_minutiae,
)
from splitknit_match.prints.photo_finger import PhotoFinger
from splitknit_match.records.templates import HEADER_BYTES, MAGIC, decode_template, read_template

if TYPE_CHECKING:
    from splitknit.io.prints import PrintFile
    from splitknit_match.prints.pressed import PressedRidges

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

    @property
    def doubt(self) -> Finding | None:
        """Why the resolution of a print cannot be right."""
        return next((each for each in self.findings if each.severity == Severity.DOUBT), None)

    @property
    def payload(self) -> bytes:
        """Bytes of its template file."""
        if self.template is not None:
            return pack(self.template)
        assert self.minutiae is not None
        return pack_minutiae(self.minutiae)


@dataclass(frozen=True, slots=True, eq=False)
class Pixels:
    """A print without a file."""

    image: NDArray[np.uint8] = field(repr=False)
    """(H, W), ridges dark."""
    resolution_ppi: float

    @property
    def sha256(self) -> str:
        """Hash of size, resolution and pixels."""
        head = f"{self.image.shape} {self.resolution_ppi}\n".encode("ascii")
        return hashlib.sha256(head + self.image.tobytes()).hexdigest()


Held = Reconstruction | Capture | Pixels | bytes
"""A finger without a file: `bytes` are the payload of a template."""


def held(finger: Any, resolution_ppi: Any = None) -> Path | Held:
    """A finger as a caller has it: a path, other objects, or the pixels (H, W) of a print, of a
    known resolution.

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
    require(
        isinstance(resolution_ppi, int | float) and 200 <= resolution_ppi <= 5080,
        f"`resolution_ppi` must lie in 200 to 5080, but it is {resolution_ppi!r}.",
    )
    return Pixels(np.ascontiguousarray(finger), float(resolution_ppi))


def read_side(  # noqa: PLR0911 - one for each kind
    finger: Path | Held,
    preset: str,
    progress: Progress = no_progress,
    resolution_ppi: float | None = None,
    *,
    where: PhotoFinger | None = None,
) -> Side:
    """Read one side, whatever it is, and make its template; `resolution_ppi` as for prints in
    ``prints.from_file``.

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
    if isinstance(finger, Pixels):
        from splitknit.io.prints import PrintFile
        from splitknit_match.prints.from_file import prepared  # a template needs none of it

        item = PrintFile(finger.image, finger.resolution_ppi, {})
        return _print_side(Path("array"), prepared(item))
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
        template = print_template(source.flat, pressed=source.pressed)
        findings = tuple(each.of_file(finger) for each in source.findings)
        return Side(
            finger, "photo", None, template, source.flat, findings=findings, quality=source.quality
        )
    record = read_one_finger(finger, resolution_ppi)
    if isinstance(record, FingerView):
        return naming(finger, lambda: Side(finger, "minutiae", minutiae=minutiae_of(record)))
    return _print_side(finger, record)


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
        # else it is measured by a calibrated camera
        doubt = resolution_doubt(picture) if assumed or about.method == "file" else None
        if doubt is not None:
            picture = replace(picture, findings=(*picture.findings, doubt))
        return _print_side(folder, picture, None if view is None else minutiae_of(view))
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


def _template_side(path: Path, payload: bytes) -> Side:
    if holds_minutiae(payload):
        return Side(path, "template", minutiae=unpack_minutiae(payload))
    return Side(path, "template", template=unpack(payload))


def _print_side(path: Path, item: PrintFile, minutiae: Minutiae | None = None) -> Side:
    from splitknit_match.prints.from_file import print_at_500_ppi  # a template needs none of it

    image = naming(path, lambda: print_at_500_ppi(item)).image
    template = naming(path, lambda: print_template(image))
    findings = tuple(finding.of_file(path) for finding in item.findings)
    return Side(path, "print", None, template, image, minutiae, findings)


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


def print_template(
    image: NDArray[np.uint8], ppi: float = PPI, *, pressed: PressedRidges | None = None
) -> Template:
    """Template of a print (H, W), ridges dark, with its minutiae, as ``splitknit print`` finds
    them.

    `pressed`: ridges of a photograph, which are taken in place of the picture: its noise is as
    strong as they are. Raises BadInput as :func:`splitknit_match.matching.ridge_band.print_band`.
    """
    from splitknit.io.prints import PrintFile  # templates of others need none of these
    from splitknit_match.prints.from_file import pressed_print
    from splitknit_match.prints.make import enhance, minutiae_by_phase
    from splitknit_match.prints.pressed import pressed_ridges

    image = at_500_ppi(image, ppi)
    inside, minutiae, lacks = (
        np.zeros(image.shape, dtype=bool),
        no_minutiae((image.shape[0], image.shape[1])),
        "",
    )
    with contextlib.suppress(BadInput):  # no ridges: a failure to acquire
        ridges = pressed or pressed_ridges(image)
        lacks = ridges.lacks
        finger = pressed_print(PrintFile(image, PPI, {}), pressed=ridges)
        inside = finger.weight > 0
        minutiae = minutiae_by_phase(finger, enhance(finger))
        area_mm2 = float(inside.sum()) * (25.4 / PPI) ** 2
        low, high = (rate * area_mm2 for rate in MINUTIAE_PER_MM2)
        if area_mm2 >= JUDGED_MM2 and not low < minutiae.count < high:
            lacks = (
                f"no print of a finger: {minutiae.count} lines end or fork on {area_mm2:.0f} mm²"
            )
        image = image if pressed is None else pressed.image
    if lacks:
        return replace(failed_template(), minutiae=no_minutiae(minutiae.size), lacks=lacks)
    band = print_band(image, PPI, inside)
    return with_minutiae(make_template(band, _LEAST_OF_PRINTS_MM2), band.valid, minutiae)


def read_surface(path: Path) -> Surface:
    """Read a result's ``height.npz``. Raises BadInput if it is damaged, or an array is missing or
    of another shape."""
    from splitknit.io.results import read_fields  # a template needs none of it

    return Surface(**read_fields(path, ("ridge_mm", "shape_mm", "normals"), ("whole",)))


def _reconstructed(capture: Capture, preset: str, progress: Progress) -> Reconstruction:
    from splitknit import reconstruct  # a template needs none of it

    return reconstruct(
        capture, preset, progress=lambda stage, fraction: progress(stage, 0.1 + 0.7 * fraction)
    )
